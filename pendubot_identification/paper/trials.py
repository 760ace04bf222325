"""What the reproduction of the paper runs, experiment by experiment, what came of it, and how runs are compared."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import mannwhitneyu

from pendubot_identification.criteria.quadratic import Penalised, Quadratic
from pendubot_identification.errors import ParameterError
from pendubot_identification.model.parameters import Bounds
from pendubot_identification.optimizers.mde import MDESettings, mde
from pendubot_identification.optimizers.optimizer import MOST_VECTORS, OptimizationResult

from .benchmark_functions import FUNCTIONS, BenchmarkFunction
from .competitors import PSOSettings, classic, hde, pso

Array = NDArray[np.float64]

#: Table 3: a run stops at this error, or after so many generations. PSO's 4000 are function values, as SwarmOps counts:
#: only so does it match its column of Table 4.
TARGET, GENERATIONS = 1e-5, 4000
#: n of Table 4, inferred, and its runs.
DIMENSION, RUNS = 2, 10
#: Table 3.
PSO_SETTINGS = PSOSettings(149, -0.3236, -0.1136, 3.9789, evaluations=4000, target=TARGET)
DE_SETTINGS = classic(18, weight=0.6714, crossover=0.5026, generations=GENERATIONS, target=TARGET)
HDE_RATE = 0.01
MDE_SETTINGS = MDESettings(population=50, generations=GENERATIONS, target=TARGET)
ALGORITHMS = ('PSO', 'DE', 'HDE', 'MDE')
#: The same as MDE, with the operator drawn once a vector, as the paper's text has it.
PER_VECTOR = 'MDE per vector'

#: Runs that tell how often an algorithm arrives, for each one that the paper's tables have.
MANY = 10
#: More of them would not fit into a usual memory.
MOST_RUNS = MOST_VECTORS // (MANY * PSO_SETTINGS.particles)
#: Runs of the sweep, likewise, and the generations after which one of them has failed. Those that arrive take 200.
SWEEP, SWEEP_GENERATIONS = 5, 400
THRESHOLDS = tuple(k / 10 for k in range(11))
#: n of the comparison beyond the paper, and the function values of each run, n times these: the budget for which
#: Pedersen chose the parameters that Table 3 has for DE. At n = 2 it is what the paper gives PSO.
DIMENSIONS, BUDGET = (2, 10, 30), 2000
#: How near to its least value J counts as minimised.
NEAR = 1e-6
IDENTIFICATION = 'Identification'


def compete(
    algorithm: str,
    function: BenchmarkFunction,
    dimension: int = DIMENSION,
    *,
    runs: int = RUNS,
    seed: int = 1,
    evaluations: int | None = None,
) -> OptimizationResult:
    """Minimise a function by an algorithm with the settings of Table 3.

    Args:
        algorithm: one of :data:`ALGORITHMS`, or :data:`PER_VECTOR`.
        function: with its box and, for HDE, its gradient.
        dimension: n.
        runs: independent runs.
        seed: same seed, same result.
        evaluations: end each run with the generation in which it has asked for so many function values, whatever the
            algorithm; None: at the paper's limits.

    Raises:
        ParameterError: an algorithm that is not known.
    """
    f, bounds = function.value, function.bounds(dimension)

    def limited(settings: MDESettings, each: int) -> MDESettings:
        if evaluations is None:
            return settings
        return replace(settings, generations=max(1, math.ceil((evaluations - settings.population) / each)))

    if algorithm == 'PSO':
        swarm = PSO_SETTINGS if evaluations is None else replace(PSO_SETTINGS, evaluations=evaluations)
        return pso(f, bounds, swarm, runs=runs, seed=seed)
    if algorithm == 'DE':
        return mde(f, bounds, limited(DE_SETTINGS, DE_SETTINGS.population), runs=runs, seed=seed)
    if algorithm == 'HDE':
        settings = limited(DE_SETTINGS, DE_SETTINGS.population + 1)
        return hde(f, function.gradient, bounds, settings, rate=HDE_RATE, runs=runs, seed=seed)
    if algorithm in ('MDE', PER_VECTOR):
        settings = limited(replace(MDE_SETTINGS, per_component=algorithm == 'MDE'), MDE_SETTINGS.population)
        return mde(f, bounds, settings, runs=runs, seed=seed)
    raise ParameterError(f'there is no algorithm {algorithm!r}; choose one of {", ".join((*ALGORITHMS, PER_VECTOR))}')


@dataclass(frozen=True, slots=True)
class Trial:
    """Runs of one algorithm on one function.

    Attributes:
        function: its name.
        dimension: n.
        algorithm: its name.
        threshold: of MDE, where it is not the paper's.
        seed: the trial's own.
        run: does it.
        detailed: whether points and histories are worth keeping.
    """

    function: str
    dimension: int
    algorithm: str
    threshold: float | None
    seed: int
    run: Callable[[], OptimizationResult]
    detailed: bool = False

    def data(self, result: OptimizationResult) -> dict[str, Any]:
        """Return what the runs came to as plain numbers, strings, lists and dictionaries.

        A history is a list of [generation, value], one for each generation that found something better.
        """
        runs = []
        for k in range(len(result.value)):
            run: dict[str, Any] = {
                'value': float(result.value[k]),
                'generations': int(result.generations[k]),
                'evaluations': int(result.evaluations[k]),
                'stopped_by': result.stopped_by[k],
            }
            if self.detailed:
                best = result.history[:, k]
                better = np.flatnonzero(np.diff(best, prepend=np.inf) < 0)
                run['x'] = result.x[k].tolist()
                run['history'] = [[int(g), float(best[g])] for g in better]
            runs.append(run)
        return {
            'function': self.function,
            'n': self.dimension,
            'algorithm': self.algorithm,
            'threshold': self.threshold,
            'seed': self.seed,
            'evaluations_at_start': result.at_start,
            'evaluations_per_generation': result.per_generation,
            'runs': runs,
        }


def competition(seed: int, runs: int) -> Iterator[Trial]:
    """Yield Table 4's and Figure 1's: four algorithms, four functions, the paper's settings."""
    for f in FUNCTIONS:
        for algorithm in ALGORITHMS:
            own = seed_of(seed, 'competition', f.name, algorithm)
            run = partial(compete, algorithm, f, runs=MANY * runs, seed=own)
            yield Trial(f.name, DIMENSION, algorithm, None, own, run, detailed=True)


def dimensions(seed: int, runs: int) -> Iterator[Trial]:
    """Yield the same in more dimensions, everyone with as many function values."""
    for n in DIMENSIONS:
        for f in FUNCTIONS:
            for algorithm in (*ALGORITHMS, PER_VECTOR):
                own = seed_of(seed, 'dimensions', n, f.name, algorithm)
                run = partial(compete, algorithm, f, n, runs=runs, seed=own, evaluations=BUDGET * n)
                yield Trial(f.name, n, algorithm, None, own, run)


def sweep(seed: int, runs: int, identification: Quadratic, bounds: Bounds) -> Iterator[Trial]:
    """Yield MDE with every threshold, its operator drawn per component and per vector, on each function and on J.

    Args:
        seed: of everything.
        runs: as Table 4 has.
        identification: J of the paper's experiment.
        bounds: its box.
    """
    least = float(identification(identification.minimum(bounds)))
    at_functions = replace(MDE_SETTINGS, generations=SWEEP_GENERATIONS)
    problems: list[tuple[str, Callable[..., Array], Bounds, MDESettings, int]] = [
        *((f.name, f.value, f.bounds(DIMENSION), at_functions, SWEEP * runs) for f in FUNCTIONS),
        (IDENTIFICATION, Penalised.of(identification), bounds, MDESettings(target=least * (1 + NEAR)), runs),
    ]
    for name, objective, box, settings, count in problems:
        for algorithm in ('MDE', PER_VECTOR):
            for threshold in THRESHOLDS:
                own = seed_of(seed, 'sweep', name, algorithm, threshold)
                chosen = replace(settings, threshold=threshold, per_component=algorithm == 'MDE')
                run = partial(mde, objective, box, chosen, runs=count, seed=own)
                yield Trial(name, len(box.lower), algorithm, threshold, own, run)


def seed_of(seed: int, *what: object) -> int:
    """Return a seed of its own for one of several experiments, so that none shares its random numbers with another."""
    name = ' '.join(map(str, what)).encode()
    return int(np.random.SeedSequence([seed, *name]).generate_state(1)[0])


def ranks(samples: Sequence[tuple[ArrayLike, ArrayLike]]) -> list[Array]:
    """Return how good runs are among each other, the lower the better; equally good ones have the same number.

    A run that reaches the target is better than one that does not. Of two that do, the one with fewer function values
    is better, for its error only says by how much it overshot; of two that do not, the one with the lower error.

    Args:
        samples: errors and function values, each of shape (runs,), of every algorithm.
    """
    keys = []
    for value, evaluations in samples:
        error, spent = np.asarray(value, dtype=float), np.asarray(evaluations, dtype=float)
        reached = error <= TARGET
        keys.append(np.column_stack([~reached, np.where(reached, spent, error)]))
    _, order = np.unique(np.concatenate(keys), axis=0, return_inverse=True)
    return np.split(order.ravel().astype(float), np.cumsum([len(key) for key in keys])[:-1])


def rank_sum(first: Array, second: Array) -> tuple[float, float]:
    """Return the two-sided p of the rank-sum test (Mann and Whitney 1947), and how often the first is lower.

    The latter is the share of all pairs of runs, ties counting half: 1 where every run of the first is better.
    """
    test = mannwhitneyu(first, second, alternative='two-sided', method='asymptotic')
    return float(test.pvalue), 1 - float(test.statistic) / (len(first) * len(second))
