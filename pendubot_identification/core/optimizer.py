"""What every optimiser shares: ask and tell over independent runs, and the loop that drives it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
#: Values of a function at points: (..., D) in, (...) out.
Objective = Callable[[Array], Array]
#: Called now and then with the generations done and the best value so far.
Progress = Callable[[int, float], None]

#: Generations between two calls of the progress function.
PROGRESS_EVERY = 50


@dataclass(frozen=True, slots=True)
class OptimizationResult:
    """What the runs found; every array has one entry (or row, or column) per run.

    Attributes:
        x: each run's best point, shape (runs, D).
        value: its value, shape (runs,).
        generations: how many generations each run took, shape (runs,).
        evaluations: how many function values each run asked for, shape (runs,).
        history: the best value after each generation, shape (generations + 1, runs); a run that stopped keeps its last.
        stopped_by: per run ``generations``, ``target`` or ``spread``.
    """

    x: Array
    value: Array
    generations: NDArray[np.int64]
    evaluations: NDArray[np.int64]
    history: Array
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
