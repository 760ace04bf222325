"""Modified differential evolution, the paper's Table 1, with all independent runs advanced as one array.

For every target vector F and CR are drawn anew; for every component that crosses over (rand < CR, or j = jrand) the
mutation is, by chance, ``rand/1``: x_r1 + F (x_r2 - x_r3), or ``best/1``: x_best + F (x_r1 - x_r2). A trial replaces
its target where it is at least as good.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.errors import ParameterError
from pendubot_identification.model.parameters import Bounds

from .mde_kernel import Compiled, leap
from .optimizer import IndependentRuns, Objective, random_points

Array = NDArray[np.float64]
Steps = NDArray[np.integer]

#: What chances and rates are whole multiples of: a uniform number of 15 bits is below `rate` with probability
#: rate / UNIT, exactly, from never (0) to always (UNIT).
UNIT = 1 << 15
#: Generations whose random numbers are drawn at once, and of how many components at most: what a cache holds.
BLOCK, COMPONENTS = 32, 1 << 17
#: Ordered triples of partners that are tabulated (those of 52 vectors); of more they are computed, to the same.
LARGEST_TABLE = 1 << 17


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
        for name, (low, high), most in (('weight F', self.weight, 2), ('crossover rate CR', self.crossover, 1)):
            if not 0 <= low <= high <= most:
                raise ParameterError(
                    f'the range of the {name} is {low:g} to {high:g}; 0 <= low <= high <= {most} is expected'
                )

    @property
    def threshold_units(self) -> int:
        """The threshold in units of 1 / :data:`UNIT`, to the nearest."""
        return round(self.threshold * UNIT)

    @property
    def crossover_units(self) -> tuple[int, int]:
        """The least CR in units of 1 / :data:`UNIT`, and how many values it may take from there on."""
        low, high = (round(rate * UNIT) for rate in self.crossover)
        return low, high - low + 1

    @property
    def weight_steps(self) -> tuple[float, float]:
        """The least F, and the 2^31st part of its interval."""
        low, high = self.weight
        return low, (high - low) / 2**31


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
        # Component by component, shape (D, active runs, NP): what all vectors share is then a scalar of a row, and
        # what all components share a row.
        self._trials: Array | None = np.ascontiguousarray(
            random_points(self._streams, population, bounds).transpose(2, 0, 1)
        )
        # A row is the population, the same once more, and its best vector NP times, so that whatever a mutation takes
        # stands a number of places behind the target, which does not depend on which target it is.
        self._rows: Array = np.zeros((dimension, runs, 3 * population))
        self._values = np.full((runs, population), np.inf)
        # What is drawn for the generations to come, and how many these are.
        self._steps: Steps = np.empty(0, dtype=np.uint16)
        self._weight, self._left = np.empty(0), 0
        self._lay_out()

    def ask(self) -> Array:
        """Return the points to evaluate, shape (active runs, NP, D): at first the initial population, then trials."""
        trials: Array = self._pending().transpose(1, 2, 0)
        return trials

    def tell(self, values: Array) -> None:
        """Take the values of the points asked for, shape (active runs, NP): select, stop, and mutate anew."""
        better = values <= self._values
        np.copyto(self._values, values, where=better)
        np.copyto(self._targets, self._pending(), where=better)
        self._trials = None
        lowest = self._settle()
        self._found.record(self._active, self.generation, lowest)
        self._stop_where_due(lowest)
        self.generation += not self.done

    def leap(self, objective: Objective) -> bool:
        """Advance by many generations at once in the compiled kernel, to the same numbers.

        Returns:
            False where there is none, it does not know the objective, or random numbers are drawn already.
        """
        waiting = self._trials is not None or self._left > 0
        if waiting or not isinstance(objective, Compiled):
            return False
        ended, population = self.generation - 1, self.settings.population
        vectors = np.ascontiguousarray(self._rows[:, :, population : 2 * population + 1].transpose(1, 0, 2))
        done = leap(objective.problem, self.settings, self.bounds, ended, self._streams, vectors, self._values)
        if done is None:
            return False
        np.copyto(self._targets, vectors[:, :, :population].transpose(1, 0, 2))
        self._settle()
        self._found.record_many(self._active, done.generations, done.history)
        self._stop(done.reasons)
        self.generation = ended + len(done.history) + (not self.done)
        return True

    def _leaders(self) -> Array:
        """Return the best vector of every active run, shape (active runs, D)."""
        return np.asarray(self._rows[:, :, -1].T)

    @property
    def _targets(self) -> Array:
        """The population, shape (D, active runs, NP)."""
        return self._rows[:, :, : self.settings.population]

    def _lay_out(self) -> None:
        """Say where in the flattened rows the targets stand, shape (D, active runs, NP), and make room."""
        dimension, runs, width = self._rows.shape
        population = self.settings.population
        first = np.arange(dimension * runs).reshape(dimension, runs) * width
        self._first_values = np.arange(runs) * population
        self._first, self._places = first, first[..., None] + np.arange(population)
        self._where = np.empty((3, *self._places.shape), dtype=np.intp)
        # Repeated, because numpy is slow where it has to repeat.
        self._lower, self._upper = (
            np.ascontiguousarray(np.broadcast_to(bound[:, None, None], self._places.shape))
            for bound in (self.bounds.lower, self.bounds.upper)
        )

    def _settle(self) -> Array:
        """Bring the rest of the rows in line with the population, and return the best values, shape (active runs,)."""
        population = self.settings.population
        best = self._values.argmin(axis=1)
        self._rows[:, :, population : 2 * population] = self._targets
        self._rows[:, :, 2 * population :] = self._rows.ravel().take(self._first + best)[..., None]
        lowest: Array = self._values.ravel().take(best + self._first_values)
        return lowest

    def _stop_where_due(self, lowest: Array) -> None:
        settings = self.settings
        over = self.generation >= settings.generations
        if not over and settings.spread is None and settings.target is None:
            return
        reasons = np.full(len(lowest), 'generations' if over else '', dtype=object)
        if settings.spread is not None:
            reasons[self._values.max(axis=1) - lowest <= settings.spread * np.abs(lowest)] = 'spread'
        if settings.target is not None:
            reasons[lowest <= settings.target] = 'target'
        self._stop(reasons)

    def _keep(self, going: NDArray[np.bool_]) -> None:
        self._values = self._values[going]
        self._rows = self._rows.compress(going, axis=1)
        if self._left:
            self._steps, self._weight = self._steps.compress(going, axis=2), self._weight.compress(going, axis=1)
        self._lay_out()

    def _pending(self) -> Array:
        """Return the trials of this generation, shape (D, active runs, NP), made when they are first asked for."""
        if self._trials is None:
            self._trials = self._mutated()
        return self._trials

    def _mutated(self) -> Array:
        if not self._left:
            self._steps, self._weight = _draw(self._streams, self.settings, len(self._rows))
            self._left = len(self._steps)
        weight = self._weight[-self._left]
        np.copyto(self._where, self._steps[-self._left, ..., :3].transpose(3, 0, 1, 2))
        self._where += self._places
        self._left -= 1
        trials, minus, base = self._rows.ravel().take(self._where, mode='clip')
        trials -= minus
        trials *= weight
        trials += base
        below, above = trials < self._lower, trials > self._upper
        if np.count_nonzero(below) or np.count_nonzero(above):
            for out, bound in ((below, self._lower), (above, self._upper)):
                np.copyto(trials, (self._targets + bound) * 0.5, where=out)
        return np.asarray(trials)


def _draw(streams: list[np.random.Generator], settings: MDESettings, dimension: int) -> tuple[Steps, Array]:
    """Draw some generations: :func:`_steps`, shape (generations, D, runs, NP, 3 or more), and F.

    In a generation a run takes whole fours of SFC64's 64-bit words. As little-endian numbers of 32 and 16 bits they
    are, in this order: for every target F (32), CR (16) and jrand (16); for every component of every target its
    partners (32), or once for all components; for every component of every target whether it crosses over, and how
    (16); and where partners are drawn once, so is the operator, for every target (16). The lowest bit is not used of F
    and of what decides crossing and operator: chances of 15 bits, so that a rate of 1 is a number of 16.

    A component crosses over where its chance is below CR, and is best/1 where it is below threshold times CR: given the
    first, the second is as likely as the threshold says, to 1 / UNIT. The component j = jrand crosses anyway, as if its
    CR were 1.
    """
    population, per_component = settings.population, settings.per_component
    choices = dimension if per_component else 1
    bits = 64 * population + 32 * choices * population + 16 * (dimension + (not per_component)) * population
    words = -(-bits // 256) * 4
    block = max(1, min(BLOCK, COMPONENTS // (len(streams) * population * dimension)))
    drawn = np.stack([stream.bit_generator.random_raw((block, words)) for stream in streams]).astype('<u8', copy=False)
    rest = {2: drawn.view('<u2'), 4: drawn.view('<u4')}
    at = 0

    def numbers(size: int, rows: int) -> NDArray[np.unsignedinteger]:
        """Return the next numbers of so many bytes, shape (generations, rows, runs, NP)."""
        nonlocal at
        part = rest[size][..., at // size : at // size + rows * population]
        at += size * rows * population
        return np.asarray(part.reshape(len(streams), block, rows, population).transpose(1, 2, 0, 3))

    F, CR, jrand = numbers(4, 1)[:, 0], numbers(2, 1), numbers(2, 1)
    partners, chance = numbers(4, choices), numbers(2, dimension) >> 1
    threshold, (rate, rates), (low, step) = settings.threshold_units, settings.crossover_units, settings.weight_steps
    crossing = (np.multiply(CR, rates, dtype=np.uint32) >> 16) + rate
    best = (crossing * threshold >> 15).astype(np.uint16)
    component = (np.multiply(jrand, dimension, dtype=np.uint32) >> 16).astype(np.uint16)
    forced = component == np.arange(dimension, dtype=np.uint16)[:, None, None]
    crosses = (chance < crossing.astype(np.uint16)) | forced
    if per_component:
        is_best = (chance < best) | (forced & (chance < threshold))
    else:
        is_best = crosses & (numbers(2, 1) >> 1 < threshold)
    how = crosses.view(np.uint8) + is_best.view(np.uint8)
    return _looked_up(partners, how, population), np.asarray(low + (F >> 1) * step)


def _steps(u: NDArray[np.unsignedinteger], how: NDArray[np.uint8], population: int) -> NDArray[np.int64]:
    """Return how many places behind its target stand x[plus], x[minus] and x[base], shape (..., 3).

    The partners are three others, drawn one after the other from those that are left, in their order round the ring of
    the population: the digits of u / 2^32 in a numeral system of mixed radix, NP - 1, NP - 2 and NP - 3. (Beyond 1600
    vectors not all their combinations have a number of 32 bits.) Which of them the paper calls r1 makes no difference,
    so the base is the one that best/1 does not need.

    Args:
        u: numbers of 32 bits.
        how: 0 where the target is kept, 1 for rand/1, 2 for best/1.
        population: NP.
    """
    digits, rest = [], u.astype(np.uint64)
    for left in (population - 1, population - 2, population - 3):
        rest = rest * np.uint64(left)
        digits.append((rest >> np.uint64(32)).astype(np.int64))
        rest &= np.uint64(2**32 - 1)
    plus, minus, base = digits
    minus += minus >= plus
    base += base >= np.minimum(plus, minus)
    base += base >= np.maximum(plus, minus)
    plus, minus, base = 1 + plus, 1 + minus, 1 + base
    minus = np.where(how > 0, minus, plus)  # a difference of 0
    base = np.choose(how, (0, base, 2 * population))
    return np.stack(np.broadcast_arrays(plus, minus, base), axis=-1)


def _looked_up(u: NDArray[np.unsignedinteger], how: NDArray[np.uint8], population: int) -> Steps:
    """Return :func:`_steps` from a table if it is not too large."""
    triples = _triples(population)
    if triples > LARGEST_TABLE:
        return _steps(u, how, population)
    number = np.multiply(how, triples, dtype=np.int64)
    number += (np.multiply(u, triples, dtype=np.uint64) >> np.uint64(32)).view(np.int64)
    return _table(population).take(number, mode='clip').view(np.uint16).reshape(*number.shape, 4)


def _triples(population: int) -> int:
    return (population - 1) * (population - 2) * (population - 3)


@cache
def _table(population: int) -> NDArray[np.uint64]:
    """Return the steps for every triple of partners, for each of the three values of ``how``, packed into words."""
    triples = _triples(population)
    u = ((np.arange(triples, dtype=np.uint64) << np.uint64(32)) + np.uint64(triples - 1)) // np.uint64(triples)
    packed = np.zeros((3, triples, 4), dtype=np.uint16)
    packed[..., :3] = _steps(u, np.arange(3, dtype=np.uint8)[:, None], population)
    return packed.view(np.uint64).ravel()
