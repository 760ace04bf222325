"""MDE's generations in the compiled kernel: the same random numbers, the same roundings, a tenth of the time."""

from __future__ import annotations

import ctypes
from typing import TYPE_CHECKING, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from .kernel import library

if TYPE_CHECKING:
    from .mde import MDESettings
    from .parameters import Bounds

Array = NDArray[np.float64]

#: In the order of kernel.c: objectives that it knows, and why a run has stopped.
KINDS = ('quadratic', 'sphere', 'griewank', 'ackley', 'rastrigin')
REASONS = ('', 'generations', 'spread', 'target')
#: Runs that the kernel leads side by side.
TOGETHER = 4
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
        *((name, ctypes.c_double) for name in ('threshold', 'weight_low', 'weight_high', 'crossover_low')),
        *((name, ctypes.c_double) for name in ('crossover_high', 'target', 'spread')),
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
    block: int,
    streams: list[np.random.Generator],
    vectors: Array,
    values: Array,
) -> Leap | None:
    """Lead runs on from the end of a generation by some blocks of generations, or until all have stopped.

    Args:
        problem: the objective.
        settings: of MDE.
        bounds: the search box, of dimension D.
        generation: the one at whose end the runs are.
        block: generations that share a draw of random numbers.
        streams: of the runs; they are left behind the last block.
        vectors: population and best vector of each run, shape (runs, NP + 1, D); changed in place.
        values: shape (runs, NP); changed in place.

    Returns:
        None where there is no kernel.
    """
    kernel = library()
    if kernel is None:
        return None
    runs, population, dimension = len(streams), settings.population, len(bounds.lower)
    count = block * max(1, LEAP // (block * runs * population * dimension))
    count = min(count, block * -(-(settings.generations - generation) // block))
    none = float('nan')
    how = _Settings(
        *(population, dimension, settings.per_component, settings.generations, settings.threshold),
        *(*settings.weight, *settings.crossover),
        none if settings.target is None else settings.target,
        none if settings.spread is None else settings.spread,
    )
    data = np.ascontiguousarray(problem.data)
    state = np.array([s.bit_generator.state['state']['state'] for s in streams], dtype=np.uint64)
    history, generations = np.empty((count, runs)), np.empty(runs, dtype=np.int64)
    reasons = np.empty(runs, dtype=np.int64)
    for first in range(0, runs, TOGETHER):
        some = slice(first, min(first + TOGETHER, runs))
        part = np.empty((count, some.stop - first))
        arrays = (state[some], vectors[some], values[some], part, generations[some], reasons[some])
        failed = kernel.pendubot_mde(
            ctypes.byref(how),
            KINDS.index(problem.kind),
            *(a.ctypes.data for a in (data, bounds.lower, bounds.upper)),
            *(some.stop - first, generation, count),
            *(a.ctypes.data for a in arrays),
        )
        if failed:
            raise MemoryError('for random numbers of a generation')
        history[:, some] = part
    for stream, words in zip(streams, state, strict=True):
        stream.bit_generator.state = {**stream.bit_generator.state, 'state': {'state': words}}
    done = int(generations.max()) - generation
    return Leap(history[:done], generations, np.array(REASONS, dtype=object)[reasons])
