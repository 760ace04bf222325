# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Common parts of the optimizers: independent parallel runs, stopping criteria, and results."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import count

import numpy as np

from pendubot_identification.arrays import Array, Indices
from pendubot_identification.errors import ParameterError
from pendubot_identification.model.parameters import Bounds

#: A function that maps points, shape (..., D), to values, shape (...).
Objective = Callable[[Array], Array]
#: Callback with the number of generations done and the best value so far.
Progress = Callable[[int, float], None]
#: Best points, shape (D, runs, NP), their values, shape (runs, NP), and further arrays of an optimizer.
State = tuple[Array, ...]

#: Largest number of vectors in all runs, limited by the memory.
MOST_VECTORS = 100_000
#: Progress is reported after each of this number of generations, and then after every multiple of it.
REPORTED = 100


@dataclass(frozen=True, slots=True)
class OptimizationResult:
    """The result of the runs; every array has one entry, row or column per run."""

    x: Array  #: best point of each run, shape (runs, D).
    value: Array  #: value of that point, shape (runs,).
    generations: Indices  #: number of generations of each run, shape (runs,).
    #: Best value after each generation, shape (generations + 1, runs); a run that has stopped keeps its last value.
    history: Array
    stopped_by: tuple[str, ...]  #: per run ``generations``, ``target`` or ``spread``.
    at_start: int  #: function values of a run before its first generation.
    per_generation: int  #: function values of a run in each generation.

    @property
    def best(self) -> int:
        """The index of the run with the lowest value."""
        return int(np.argmin(self.value))

    @property
    def evaluations(self) -> Indices:
        """The number of function values of each run, shape (runs,)."""
        return self.at_start + self.generations * self.per_generation


def require_runs(runs: int, population: int, seed: int) -> None:
    """Raise ParameterError for no runs, too many vectors in all, or a negative seed."""
    if runs < 1:
        raise ParameterError(f'{runs} runs were requested; at least 1 is expected')
    if runs * population > MOST_VECTORS:
        raise ParameterError(
            f'{runs * population} vectors in all runs were requested; at most {MOST_VECTORS} are expected, '
            'because memory is limited'
        )
    if seed < 0:
        raise ParameterError(f'the seed is {seed}; a whole number of at least 0 is expected')


def random_points(bounds: Bounds, runs: int, population: int, seed: int) -> tuple[np.random.Generator, Array]:
    """Return a random generator, and uniformly distributed points within the bounds, shape (D, runs, NP).

    Raises:
        ParameterError: see :func:`require_runs`.
    """
    require_runs(runs, population, seed)
    rng, (lower, upper) = np.random.Generator(np.random.SFC64(seed)), columns(bounds)
    return rng, rng.uniform(lower, upper, (len(lower), runs, population))


def columns(bounds: Bounds) -> tuple[Array, Array]:
    """Return the lower and the upper bounds, each of shape (D, 1, 1)."""
    return bounds.lower[:, None, None], bounds.upper[:, None, None]


def evaluate(objective: Objective, x: Array) -> Array:
    """Return the values of points of shape (D, runs, NP), shape (runs, NP)."""
    return objective(x.transpose(1, 2, 0))


def best_points(x: Array, values: Array) -> Array:
    """Return the best point of every run, shape (D, runs)."""
    return np.asarray(x[:, np.arange(len(values)), values.argmin(axis=1)])


def run_generations(
    step: Callable[..., State],
    state: State,
    generations: int,
    *,
    target: float | None = None,
    spread: float | None = None,
    per_generation: int | None = None,
    progress: Progress | None = None,
) -> OptimizationResult:
    """Advance all runs, generation by generation, until each has stopped.

    A run stops after the last of ``generations``, or at a best value of at most ``target``. It also stops if worst
    minus best value is at most the fraction ``spread`` of the best.

    Args:
        step: returns the arrays of the runs that continue, one generation later.
        state: the arrays at the start, see :data:`State`; the runs are on the last axis but one.
        generations: most generations of a run.
        target: None for no target.
        spread: None for no spread.
        per_generation: function values of a run in each generation; None: one for each vector.
        progress: called after generations, see :data:`REPORTED`, and after the last one.
    """
    runs, population = state[1].shape
    points, value, taken = np.empty((len(state[0]), runs)), np.empty(runs), np.zeros(runs, dtype=np.int64)
    stopped_by, history, active = np.full(runs, '', dtype='U11'), [], np.arange(runs)
    for generation in count():
        x, values = state[:2]
        lowest = value[active] = values.min(axis=1)
        history.append(value.copy())
        reasons = np.full(len(values), 'generations' if generation >= generations else '', dtype='U11')
        if spread is not None:
            reasons[values.max(axis=1) - lowest <= spread * np.abs(lowest)] = 'spread'
        if target is not None:
            reasons[lowest <= target] = 'target'
        going = reasons == ''
        if not going.all():
            ended = active[~going]
            points[:, ended], taken[ended] = best_points(x, values)[:, ~going], generation
            stopped_by[ended] = reasons[~going]
            active, state = active[going], tuple(array[..., going, :] for array in state)
        reported = generation <= REPORTED or generation % REPORTED == 0 or not active.size
        if progress is not None and generation and reported:
            progress(generation, float(value.min()))
        if not active.size:
            break
        state = step(*state)
    each = population if per_generation is None else per_generation
    return OptimizationResult(
        points.T.copy(), value, taken, np.array(history), tuple(map(str, stopped_by)), population, each
    )
