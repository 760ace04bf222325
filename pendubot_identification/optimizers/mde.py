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
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from pendubot_identification import kernel as compiled
from pendubot_identification.arrays import Array
from pendubot_identification.errors import ParameterError
from pendubot_identification.model.parameters import LARGEST_COUPLING, Bounds

from .optimizer import (
    Objective,
    OptimizationResult,
    Progress,
    State,
    columns,
    evaluate,
    random_points,
    run_generations,
)

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
        ParameterError: see :func:`.optimizer.require_runs`.
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
