# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Modified differential evolution (MDE), Table 1 of the paper.

:func:`trials` is Table 1 in numpy. For a quadratic criterion, a generation in C (mde.c) takes a ninth of the time. It
has other random numbers: single runs differ; minima and the distribution of the number of generations are the same.
"""

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import count
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from pendubot_identification import kernel as compiled
from pendubot_identification.arrays import Array, Indices
from pendubot_identification.errors import ParameterError
from pendubot_identification.model.parameters import LARGEST_COUPLING, Bounds

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
#: Number of parallel random number generators of mde.c; the length of its rows is a multiple.
LANES = 16


@dataclass(frozen=True, slots=True)
class MDESettings:
    """Table 6 of the paper, with its values as defaults. Raises ParameterError: a setting is invalid."""

    population: int = 30  #: NP, the vectors of one run.
    generations: int = 4000  #: most generations of a run.
    threshold: float = 0.3  #: a mutation is rand/1 if a random number exceeds it, else best/1.
    weight: tuple[float, float] = (0.4, 1.0)  #: the interval from which F is drawn.
    crossover: tuple[float, float] = (0.7, 1.0)  #: the interval from which CR is drawn.
    #: Whether operator and indices are drawn for every component (the pseudocode) or once for a target vector (the text
    #: of the paper; converges faster here).
    per_component: bool = True
    target: float | None = None  #: stop a run at a value of at most this.
    #: Stop a run when worst minus best value of its population is at most this fraction of the best value.
    spread: float | None = None

    def __post_init__(self) -> None:
        if self.population < 5:
            raise ParameterError(
                f'the population NP is {self.population}; at least 5 is expected, for a target and three others '
                'to differ'
            )
        if self.generations < 1:
            raise ParameterError(f'{self.generations} generations were requested; at least 1 is expected')
        if self.spread is not None and not self.spread > 0:
            raise ParameterError(f'the spread at which a run stops is {self.spread:g}; a number above 0 is expected')


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
    for done in count():
        x, values = state[:2]
        lowest = value[active] = values.min(axis=1)
        history.append(value.copy())
        reasons = np.full(len(values), 'generations' if done >= generations else '', dtype='U11')
        if spread is not None:
            reasons[values.max(axis=1) - lowest <= spread * np.abs(lowest)] = 'spread'
        if target is not None:
            reasons[lowest <= target] = 'target'
        going = reasons == ''
        if not going.all():
            ended = active[~going]
            points[:, ended], taken[ended] = best_points(x, values)[:, ~going], done
            stopped_by[ended] = reasons[~going]
            active, state = active[going], tuple(array[..., going, :] for array in state)
        reported = done <= REPORTED or done % REPORTED == 0 or not active.size
        if progress is not None and done and reported:
            progress(done, float(value.min()))
        if not active.size:
            break
        state = step(*state)
    each = population if per_generation is None else per_generation
    return OptimizationResult(
        points.T.copy(), value, taken, np.array(history), tuple(map(str, stopped_by)), population, each
    )


def mde(
    objective: Objective,
    bounds: Bounds,
    settings: MDESettings | None = None,
    *,
    runs: int = 10,
    seed: int = 1,
    progress: Progress | None = None,
) -> OptimizationResult:
    """Minimise a function within bounds in several independent runs.

    The C version (mde.c), if it was built, minimises a :class:`QuadraticObjective`. The default settings are from the
    paper. The same seed gives the same result.

    Raises:
        ParameterError: see :func:`require_runs`.
    """
    settings = settings or MDESettings()
    rng, x = random_points(bounds, runs, settings.population, seed)
    step, state = partial(generation, rng, objective, bounds, settings), (x, evaluate(objective, x))
    if isinstance(objective, QuadraticObjective) and (library := compiled.library()) is not None:
        step = _compiled(library, objective, bounds, settings)
        seeds = (np.random.SeedSequence([seed, run]) for run in range(runs))
        state += (np.array([each.generate_state(4 * LANES) for each in seeds]),)
    return run_generations(
        step, state, settings.generations, target=settings.target, spread=settings.spread, progress=progress
    )


def generation(
    rng: np.random.Generator, objective: Objective, bounds: Bounds, settings: MDESettings, x: Array, values: Array
) -> State:
    """Return the populations, shape (D, runs, NP), and their values, shape (runs, NP), one generation later.

    A trial replaces its target vector if it is at least as good.
    """
    trial = trials(rng, bounds, settings, x, values.argmin(axis=1))
    trial_values = evaluate(objective, trial)
    better = trial_values <= values
    return np.where(better, trial, x), np.where(better, trial_values, values)


def trials(rng: np.random.Generator, bounds: Bounds, settings: MDESettings, x: Array, best: NDArray[np.intp]) -> Array:
    """Return the trial of every target vector i in all runs, Table 1 of the paper.

    Populations ``x`` and trials have shape (D, runs, NP); ``best`` is the index of the best vector of each run.
    """
    D, runs, NP = x.shape
    choices = (D if settings.per_component else 1, runs, NP)
    j, best = np.arange(D)[:, None, None], best[:, None]

    F = rng.uniform(*settings.weight, (runs, NP))
    CR = rng.uniform(*settings.crossover, (runs, NP))
    jrand = np.floor(D * rng.random((runs, NP)))
    crosses = (rng.random(x.shape) < CR) | (j == jrand)

    best_1 = rng.random(choices) <= settings.threshold
    r1, r2, r3 = three_others(rng, NP, choices)
    # Line 14: in best/1 r1, r2, best and i all differ. If r1 or r2 is the best vector, r3 replaces it, which best/1
    # does not use otherwise; all pairs of other vectors remain equally likely.
    r1, r2 = (np.where(best_1 & (r == best), r3, r) for r in (r1, r2))

    flat, first = x.ravel(), NP * np.arange(D * runs).reshape(D, runs, 1)
    x1, x2, x3, x_best = (flat.take(first + r) for r in (r1, r2, r3, best))
    v = np.where(best_1, x_best + F * (x1 - x2), x1 + F * (x2 - x3))
    return np.where(crosses, drawn_back(v, x, bounds), x)


def three_others(rng: np.random.Generator, NP: int, shape: tuple[int, ...]) -> tuple[NDArray[np.intp], ...]:
    """Return r1, r2 and r3, which differ from each other and from the target i, the index along the last axis."""
    # Draw each from the number of remaining indices, then skip the indices in use.
    i = np.arange(NP)
    r1, r2, r3 = (((NP - taken) * rng.random(shape)).astype(np.intp) for taken in (1, 2, 3))
    r1 += r1 >= i
    low, high = np.minimum(i, r1), np.maximum(i, r1)
    r2 += r2 >= low
    r2 += r2 >= high
    low, middle, high = np.minimum(low, r2), np.maximum(low, np.minimum(high, r2)), np.maximum(high, r2)
    r3 += r3 >= low
    r3 += r3 >= middle
    r3 += r3 >= high
    return r1, r2, r3


def drawn_back(v: Array, x: Array, bounds: Bounds) -> Array:
    """Return v, shape (D, runs, NP), with components outside the bounds set halfway from the target's x to the bound.

    On the bound itself, components would soon be equal, and mutations, which are differences, would be zero.
    """
    lower, upper = columns(bounds)
    inside = np.minimum(np.maximum(v, lower), upper)
    return np.where(v == inside, v, (x + inside) / 2)


@runtime_checkable
class QuadraticObjective(Protocol):
    """The objective of mde.c: |root [x, -1]|^2 + worth * :func:`.parameters.coupling_excess` of x."""

    @property
    def root(self) -> Array:
        """Upper triangular, shape (D + 1, D + 1)."""

    @property
    def worth(self) -> float:
        """Weight of the penalty for an indefinite mass matrix; with 0, x need not begin with P1, P2, P3."""


class _Settings(ctypes.Structure):
    """The struct Settings of mde.c."""

    _fields_ = (
        *((name, ctypes.c_int64) for name in ('population', 'dimension', 'per_component')),
        *((name, ctypes.c_double) for name in ('threshold', 'F_low', 'F_high', 'CR_low', 'CR_high')),
        *((name, ctypes.c_double) for name in ('worth', 'largest_coupling')),
    )


def _compiled(
    library: ctypes.CDLL, objective: QuadraticObjective, bounds: Bounds, settings: MDESettings
) -> Callable[..., State]:
    """Return the generation of mde.c, for populations, their values, and random numbers, shape (runs, 4 LANES)."""
    rows, D = settings.population + -settings.population % LANES, len(bounds.lower)
    parameters = _Settings(
        *(settings.population, D, settings.per_component, settings.threshold, *settings.weight, *settings.crossover),
        *(objective.worth, LARGEST_COUPLING),
    )
    memory = np.zeros(9 * rows, dtype=np.uint32), np.zeros((3 + 2 * D) * rows)
    constants = np.ascontiguousarray(objective.root), bounds.lower, bounds.upper, *memory
    pointers = ctypes.byref(parameters), *(array.ctypes.data_as(ctypes.c_void_p) for array in constants)

    def step(x: Array, values: Array, random: Array) -> State:
        x, values, random = map(np.ascontiguousarray, (x, values, random))
        library.pendubot_mde(*pointers, len(values), random.ctypes.data, x.ctypes.data, values.ctypes.data)
        return x, values, random

    return step
