"""MDE's generations in the compiled kernel: the same random numbers, the same roundings, a tenth of the time."""

from __future__ import annotations

import ctypes
from typing import TYPE_CHECKING, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.model import kernel as compiled

if TYPE_CHECKING:
    from pendubot_identification.model.parameters import Bounds

    from .mde import MDESettings

Array = NDArray[np.float64]

#: In the order of kernel.c: objectives that it knows, and why a run has stopped.
KINDS = ('quadratic', 'sphere', 'griewank', 'ackley', 'rastrigin')
REASONS = ('', 'generations', 'spread', 'target')
#: Of a population: the kernel multiplies numbers of 16 bits.
MOST_VECTORS = 1 << 16
#: Components that are advanced before Python has its turn again, to tell how far it is or to be interrupted.
LEAP = 4_000_000


class Problem(NamedTuple):
    """An objective as the kernel takes it: one of :data:`KINDS`, and the numbers that define it."""

    kind: str
    data: Array


@runtime_checkable
class Compiled(Protocol):
    """An objective that the kernel knows."""

    @property
    def problem(self) -> Problem:
        """The same as calling the objective, to a rounding; of quadratic ones bit for bit."""


class _Settings(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_int64) for name in ('population', 'dimension', 'per_component', 'generations')),
        *((name, ctypes.c_int64) for name in ('threshold', 'crossover_low', 'crossover_count')),
        *((name, ctypes.c_double) for name in ('weight_low', 'weight_step', 'target', 'spread')),
    )


class Leap(NamedTuple):
    """What many generations came to: the best values, shape (generations, runs); and of each run its last generation,
    and why it has stopped, empty where it has not.
    """

    history: Array
    generations: NDArray[np.int64]
    reasons: NDArray[np.object_]


def leap(
    problem: Problem,
    settings: MDESettings,
    bounds: Bounds,
    generation: int,
    streams: list[np.random.Generator],
    vectors: Array,
    values: Array,
) -> Leap | None:
    """Lead runs on from the end of a generation by many generations, or until all have stopped.

    Args:
        problem: the objective.
        settings: of MDE.
        bounds: the search box, of dimension D.
        generation: the one at whose end the runs are.
        streams: of the runs; they are left behind the last generation.
        vectors: component by component the population of each run and, behind it, its best vector, shape
            (runs, D, NP + 1), C-ordered; changed in place.
        values: shape (runs, NP); changed in place.

    Returns:
        None where there is no kernel, or it does not know so large a population.
    """
    kernel, population = compiled.library(), settings.population
    if kernel is None or population > MOST_VECTORS:
        return None
    runs, dimension = len(streams), len(bounds.lower)
    count = min(max(1, LEAP // (runs * population * dimension)), settings.generations - generation)
    none = float('nan')
    how = _Settings(
        *(population, dimension, settings.per_component, settings.generations),
        *(settings.threshold_units, *settings.crossover_units, *settings.weight_steps),
        none if settings.target is None else settings.target,
        none if settings.spread is None else settings.spread,
    )
    data = np.ascontiguousarray(problem.data)
    state = np.array([s.bit_generator.state['state']['state'] for s in streams], dtype=np.uint64)
    history, generations = np.empty((runs, count)), np.empty(runs, dtype=np.int64)
    reasons = np.empty(runs, dtype=np.int64)
    failed = kernel.pendubot_mde(
        compiled.threads,
        ctypes.byref(how),
        KINDS.index(problem.kind),
        *(a.ctypes.data for a in (data, bounds.lower, bounds.upper)),
        *(runs, generation, count),
        *(a.ctypes.data for a in (state, vectors, values, history, generations, reasons)),
    )
    if failed:
        raise MemoryError('for random numbers of a generation')
    for stream, words in zip(streams, state, strict=True):
        stream.bit_generator.state = {**stream.bit_generator.state, 'state': {'state': words}}
    done = int(generations.max()) - generation
    return Leap(history[:, :done].T, generations, np.array(REASONS, dtype=object)[reasons])
