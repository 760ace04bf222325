"""Modified differential evolution, the paper's Table 1, with all independent runs advanced as one array.

For every target vector F and CR are drawn anew; for every component that crosses over (rand < CR, or j = jrand) the
mutation is, by chance, ``rand/1``: x_r1 + F (x_r2 - x_r3), or ``best/1``: x_best + F (x_r1 - x_r2). A trial replaces
its target where it is at least as good.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .errors import ParameterError
from .mde_kernel import Compiled, leap
from .optimizer import IndependentRuns, Objective, random_points
from .parameters import Bounds

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

#: Generations whose random numbers are drawn at once. Part of what a seed means, so not a setting.
BLOCK = 16


@dataclass(frozen=True, slots=True)
class MDESettings:
    """The paper's Table 6 and its defaults.

    Attributes:
        population: NP, the vectors of one run.
        generations: the most that a run may take.
        threshold: a mutation is rand/1 where rand > threshold, best/1 otherwise.
        weight: the interval from which F is drawn.
        crossover: the interval from which CR is drawn.
        per_component: whether operator and indices are drawn anew for every component (the pseudocode) or once for a
            target vector (the paper's text; converges faster here).
        target: stop a run at a value not above this.
        spread: stop a run once (worst - best) of its population is not above this fraction of its best value.

    Raises:
        ParameterError: a setting that makes no sense.
    """

    population: int = 30
    generations: int = 4000
    threshold: float = 0.3
    weight: tuple[float, float] = (0.4, 1.0)
    crossover: tuple[float, float] = (0.7, 1.0)
    per_component: bool = True
    target: float | None = None
    spread: float | None = None

    def __post_init__(self) -> None:
        if self.population < 5:
            raise ParameterError(
                f'the population NP is {self.population}; at least 5 is needed, for a target and three others to differ'
            )
        if self.generations < 1:
            raise ParameterError(f'{self.generations} generations were asked for; at least 1 is needed')
        if self.spread is not None and not self.spread > 0:
            raise ParameterError(f'the spread at which a run stops is {self.spread:g}; a number above 0 is expected')
        if not 0 <= self.threshold <= 1:
            raise ParameterError(f'the threshold is {self.threshold:g}; a probability from 0 to 1 is expected')
        for name, (low, high) in (('weight F', self.weight), ('crossover rate CR', self.crossover)):
            if not 0 <= low <= high <= 2:
                raise ParameterError(f'the range of the {name} is {low:g} to {high:g}; 0 <= low <= high is expected')
        if self.crossover[1] > 1:
            raise ParameterError(f'the crossover rate CR reaches {self.crossover[1]:g}; at most 1 is expected')


class MDE(IndependentRuns):
    """Ask/tell optimiser (see :class:`.optimizer.Optimizer`) of several independent runs.

    Each run has a random stream of its own, spawned from the seed, so that its result does not depend on how many
    runs stand beside it. A component that leaves the bounds is set halfway between its target's and the bound: set on
    the bound, all would soon be equal there and their differences, the source of every mutation, zero for good.

    Args:
        bounds: the search box, of dimension D.
        settings: see :class:`MDESettings`.
        runs: number of independent runs.
        seed: same seed, same result.
    """

    def __init__(self, bounds: Bounds, settings: MDESettings | None = None, *, runs: int = 10, seed: int = 1) -> None:
        self.settings = settings or MDESettings()
        population, dimension = self.settings.population, len(bounds.lower)
        super().__init__(bounds, runs, seed, population)
        self._trials: Array | None = random_points(self._streams, population, bounds)
        # Behind the NP vectors of each run stands its best one once more, so that best/1 is an index like any other.
        self._vectors: Array = np.empty((runs, population + 1, dimension))
        self._values = np.full((runs, population), np.inf)
        self._mutations: _Mutations | None = None

    def ask(self) -> Array:
        """Return the points to evaluate, shape (active runs, NP, D): at first the initial population, then trials."""
        return self._pending()

    def tell(self, values: Array) -> None:
        """Take the values of the points asked for, shape (active runs, NP): select, stop, and mutate anew."""
        better = values <= self._values
        np.copyto(self._values, values, where=better)
        np.copyto(self._vectors[:, :-1], self._pending(), where=better[..., None])
        self._trials = None
        best = self._values.argmin(axis=1)
        rows = np.arange(len(best))
        self._vectors[:, -1] = self._vectors[rows, best]
        lowest = self._values[rows, best]
        self._found.record(self._active, self.generation, lowest, self._vectors[:, -1])
        self._stop(self._reasons(lowest))
        self.generation += not self.done

    def leap(self, objective: Objective) -> bool:
        """Advance by many generations at once in the compiled kernel, to the same numbers.

        Returns:
            False where there is none, it does not know the objective, or it is not at the start of a block's draw.
        """
        begun = self.generation == 0 or (self.generation - 1) % BLOCK or self._trials is not None
        if begun or not isinstance(objective, Compiled):
            return False
        ended = self.generation - 1
        how = self.settings, self.bounds, ended, BLOCK
        done = leap(objective.problem, *how, self._streams, self._vectors, self._values)
        if done is None:
            return False
        self._found.record_many(self._active, done.generations, done.history, self._vectors[:, -1])
        self._stop(done.reasons)
        self.generation = ended + len(done.history) + (not self.done)
        return True

    def _reasons(self, lowest: Array) -> NDArray[np.object_]:
        """Say of every active run why it stops; empty where it goes on."""
        settings = self.settings
        reasons = np.full(len(lowest), '', dtype=object)
        if self.generation >= settings.generations:
            reasons[:] = 'generations'
        if settings.spread is not None:
            reasons[self._values.max(axis=1) - lowest <= settings.spread * np.abs(lowest)] = 'spread'
        if settings.target is not None:
            reasons[lowest <= settings.target] = 'target'
        return reasons

    def _stop(self, reasons: NDArray[np.object_]) -> None:
        stopping = reasons != ''
        if stopping.any():
            self._found.stop(self._active[stopping], reasons[stopping])
            going = ~stopping
            self._active, self._vectors, self._values = self._active[going], self._vectors[going], self._values[going]
            self._streams = [stream for stream, goes in zip(self._streams, going, strict=True) if goes]
            if self._mutations is not None:
                self._mutations = self._mutations.of(going)

    def _pending(self) -> Array:
        """Return the trials of this generation, made when they are first asked for."""
        if self._trials is None:
            self._trials = self._mutated()
        return self._trials

    def _mutated(self) -> Array:
        k = (self.generation - 1) % BLOCK
        if k == 0:
            self._mutations = _Mutations.draw(self._streams, self.settings, self._vectors.shape[2])
        mutations = self._mutations
        assert mutations is not None  # for the type checker; drawn at the first generation
        offset = np.arange(len(self._vectors)).reshape(-1, 1, 1) * self._vectors[0].size
        flat = self._vectors.ravel()
        trials: Array = flat.take(mutations.plus[k] + offset)
        trials -= flat.take(mutations.minus[k] + offset)
        trials *= mutations.weight[k]
        trials += flat.take(mutations.base[k] + offset)
        targets = self._vectors[:, :-1]
        for bound, outside in ((self.bounds.lower, np.less), (self.bounds.upper, np.greater)):
            out = outside(trials, bound)
            if out.any():
                np.copyto(trials, (targets + bound) / 2, where=out)
        return trials


@dataclass(slots=True)
class _Mutations:
    """What chance decides in a block of generations: trial = vectors[base] + weight (vectors[plus] - vectors[minus]).

    Arrays of shape (BLOCK, runs, NP, D): flat positions within a run's (NP + 1, D) vectors, and weights, which are 0
    where a component does not cross over and so keeps its target's value.
    """

    base: Indices
    plus: Indices
    minus: Indices
    weight: Array

    @classmethod
    def draw(cls, streams: list[np.random.Generator], settings: MDESettings, dimension: int) -> _Mutations:
        np_, choices = settings.population, dimension if settings.per_component else 1
        shapes = [(np_, 1), (np_, 1), (np_, 1), (np_, dimension), (np_, choices), *[(np_, choices)] * 3]
        ends = np.cumsum([a * b for a, b in shapes])
        drawn = np.stack([s.random((BLOCK, int(ends[-1])), dtype=np.float32) for s in streams], axis=1)
        F, CR, jrand, cross, operator, u1, u2, u3 = (
            part.reshape(*drawn.shape[:2], *shape)
            for part, shape in zip(np.split(drawn, ends[:-1], axis=2), shapes, strict=True)
        )
        component = np.arange(dimension)
        crosses = cross < _between(settings.crossover, CR)
        crosses |= component == _whole(jrand, dimension)
        # Three partners that differ from each other and from the target, as steps round the ring of the population.
        # Which of the three is called r1 makes no difference, so the base is the one that best/1 does not need.
        plus, minus, base = 1 + _whole(u1, np_ - 1), 1 + _whole(u2, np_ - 2), 1 + _whole(u3, np_ - 3)
        minus += minus >= plus
        base += base >= np.minimum(plus, minus)
        base += base >= np.maximum(plus, minus)
        # Where a target's ring position leads in the run's flattened vectors; the best one stands behind them.
        ring = np.tile(np.arange(np_), 2) * dimension
        target = np.arange(np_, dtype=np.int32)[:, None]
        best = (operator <= settings.threshold) & (settings.threshold > 0)  # of 2^24 numbers one is 0
        partner = np.where(best, np_ * dimension, ring.take(target + base))
        return cls(
            np.where(crosses, partner, target * dimension) + component,
            ring.take(target + plus) + component,
            ring.take(target + minus) + component,
            crosses * _between(settings.weight, F),
        )

    def of(self, going: NDArray[np.bool_]) -> _Mutations:
        return _Mutations(self.base[:, going], self.plus[:, going], self.minus[:, going], self.weight[:, going])


def _between(interval: tuple[float, float], u: NDArray[np.float32]) -> Array:
    low, high = interval
    return low + u.astype(np.float64) * (high - low)


def _whole(u: NDArray[np.float32], count: int) -> NDArray[np.int32]:
    scaled: NDArray[np.float32] = u * np.float32(count)
    return scaled.astype(np.int32)
