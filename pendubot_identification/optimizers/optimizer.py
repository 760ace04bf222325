"""What every optimiser shares: ask and tell over independent runs, their random streams, and what they have found."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.errors import ParameterError
from pendubot_identification.model.parameters import Bounds

Array = NDArray[np.float64]
#: Values of a function at points: (..., D) in, (...) out.
Objective = Callable[[Array], Array]
#: Called now and then with the generations done and the best value so far.
Progress = Callable[[int, float], None]

#: Generations between two calls of the progress function.
PROGRESS_EVERY = 50
#: Of all runs together.
MOST_VECTORS = 100_000


@dataclass(frozen=True, slots=True)
class OptimizationResult:
    """What the runs found; every array has one entry (or row, or column) per run.

    Attributes:
        x: each run's best point, shape (runs, D).
        value: its value, shape (runs,).
        generations: how many generations each run took, shape (runs,).
        evaluations: how many function values each run asked for, shape (runs,).
        history: the best value after each generation, shape (generations + 1, runs); a run that stopped keeps its last.
        cost: how many function values a run had asked for after each generation, shape (generations + 1,).
        stopped_by: per run ``generations`` (of PSO ``evaluations``), ``target`` or ``spread``.
    """

    x: Array
    value: Array
    generations: NDArray[np.int64]
    evaluations: NDArray[np.int64]
    history: Array
    cost: NDArray[np.int64]
    stopped_by: tuple[str, ...]

    @property
    def best(self) -> int:
        """The number of the run that found the lowest value."""
        return int(np.argmin(self.value))


class Optimizer(Protocol):
    """Independent runs advanced together: ask for points, tell their values, until done."""

    @property
    def done(self) -> bool:
        """Whether every run has stopped."""

    @property
    def generation(self) -> int:
        """The number of generations done."""

    @property
    def best_value(self) -> float:
        """The lowest value of any run so far."""

    def ask(self) -> Array:
        """Return the points to evaluate, shape (active runs, population, D)."""

    def tell(self, values: Array) -> None:
        """Take their values, shape (active runs, population)."""

    def result(self) -> OptimizationResult:
        """Return what the runs have found so far."""


def minimize(optimizer: Optimizer, objective: Objective, progress: Progress | None = None) -> OptimizationResult:
    """Drive an optimiser until every run has stopped; one that has a way to leap many generations takes it."""
    leap: Callable[[Objective], bool] = getattr(optimizer, 'leap', lambda _: False)
    told = 0
    while not optimizer.done:
        if not leap(objective):
            optimizer.tell(objective(optimizer.ask()))
        if progress is not None and optimizer.generation >= told + PROGRESS_EVERY:
            told = optimizer.generation
            progress(told, optimizer.best_value)
    if progress is not None:
        progress(optimizer.generation, optimizer.best_value)
    return optimizer.result()


def require_runs(runs: int, population: int, seed: int) -> None:
    """Refuse what no set of runs can be made of.

    Raises:
        ParameterError: no runs, too many vectors in all, or a negative seed.
    """
    if runs < 1:
        raise ParameterError(f'{runs} runs were asked for; at least 1 is needed')
    if runs * population > MOST_VECTORS:
        raise ParameterError(
            f'{runs * population} vectors in all runs were asked for; at most {MOST_VECTORS} fit into a usual memory'
        )
    if seed < 0:
        raise ParameterError(f'the seed is {seed}; a whole number of at least 0 is expected')


def random_streams(seed: int, runs: int) -> list[np.random.Generator]:
    """Return a stream for every run, which does not depend on how many there are."""
    return [np.random.Generator(np.random.SFC64([seed, run])) for run in range(runs)]


def random_points(streams: Sequence[np.random.Generator], count: int, bounds: Bounds) -> Array:
    """Return points spread evenly over the box, shape (runs, count, D)."""
    unit = np.stack([stream.random((count, len(bounds.lower))) for stream in streams])
    return np.asarray(bounds.lower + unit * (bounds.upper - bounds.lower))


class Found:
    """The best of every run, kept when the run itself is no longer advanced.

    Args:
        runs: how many.
        dimension: D.
        first: function values that a run asks for at the start.
        each: function values that it asks for in every generation.
    """

    def __init__(self, runs: int, dimension: int, first: int, each: int) -> None:
        self.x = np.zeros((runs, dimension))
        self.value = np.full(runs, np.inf)
        self.generations = np.zeros(runs, dtype=np.int64)
        self.history: list[Array] = []
        self.stopped_by = ['running'] * runs
        self._first, self._each = first, each

    def record(self, active: NDArray[np.intp], generation: int, value: Array) -> None:
        """Take the best values of the runs that are still going."""
        self.value[active] = value
        self.generations[active] = generation
        self.history.append(self.value.copy()[None])

    def record_many(self, active: NDArray[np.intp], generations: NDArray[np.int64], history: Array) -> None:
        """Take many generations at once: the best values after each, and each run's last generation."""
        values = np.tile(self.value, (len(history), 1))
        values[:, active] = history
        self.history.append(values)
        self.value[active] = history[-1]
        self.generations[active] = generations

    def stop(self, stopping: NDArray[np.intp], reasons: Iterable[str], x: Array) -> None:
        """Note why runs have stopped, and their best points."""
        self.x[stopping] = x
        for run, reason in zip(stopping, reasons, strict=True):
            self.stopped_by[run] = reason

    def result(self) -> OptimizationResult:
        """Return all of it."""
        history = np.concatenate(self.history) if self.history else np.empty((0, len(self.value)))
        return OptimizationResult(
            self.x.copy(),
            self.value.copy(),
            self.generations.copy(),
            self._first + self.generations * self._each,
            history,
            self._first + np.arange(len(history)) * self._each,
            tuple(self.stopped_by),
        )


class IndependentRuns:
    """What all optimisers here are made of: runs, each with its random stream, and what each has found.

    Args:
        bounds: the search box, of dimension D.
        runs: number of independent runs.
        seed: same seed, same result.
        population: vectors of a run, and so the function values of a generation.

    Raises:
        ParameterError: see :func:`require_runs`.
    """

    def __init__(self, bounds: Bounds, runs: int, seed: int, population: int) -> None:
        require_runs(runs, population, seed)
        self.bounds = bounds
        self.generation = 0
        self._streams = random_streams(seed, runs)
        self._active = np.arange(runs)
        self._found = Found(runs, len(bounds.lower), population, population)

    @property
    def done(self) -> bool:
        """Whether every run has stopped."""
        return not self._active.size

    @property
    def best_value(self) -> float:
        """The lowest value of any run so far."""
        return float(self._found.value.min())

    def result(self) -> OptimizationResult:
        """Return what the runs have found so far."""
        self._found.x[self._active] = self._leaders()
        return self._found.result()

    def _stop(self, reasons: NDArray[np.object_]) -> None:
        """End the active runs for which there is a reason, shape (active runs,); the others go on."""
        going: NDArray[np.bool_] = reasons == ''
        if going.all():
            return
        self._found.stop(self._active[~going], reasons[~going], self._leaders()[~going])
        self._active = self._active[going]
        self._streams = [stream for stream, goes in zip(self._streams, going, strict=True) if goes]
        self._keep(going)

    def _leaders(self) -> Array:
        """Return the best point of every active run so far, shape (active runs, D)."""
        raise NotImplementedError

    def _keep(self, going: NDArray[np.bool_]) -> None:
        """Keep of all that belongs to the runs what belongs to those that go on."""
        raise NotImplementedError
