"""The paper's competition: four algorithms with the settings of its Table 3, and how runs of two are compared."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import mannwhitneyu

from pendubot_identification.errors import ParameterError
from pendubot_identification.optimizers.mde import MDE, MDESettings
from pendubot_identification.optimizers.optimizer import Optimizer

from .benchmark_functions import BenchmarkFunction
from .differential_evolution import HDE, classic
from .particle_swarm import PSO, PSOSettings

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


def contestant(
    algorithm: str,
    function: BenchmarkFunction,
    dimension: int = DIMENSION,
    *,
    runs: int = RUNS,
    seed: int = 1,
    evaluations: int | None = None,
) -> Optimizer:
    """Return an algorithm with the settings of Table 3, ready to minimise a function.

    Args:
        algorithm: one of :data:`ALGORITHMS`, or :data:`PER_VECTOR`.
        function: for its box and, for HDE, its gradient.
        dimension: n.
        runs: independent runs.
        seed: same seed, same result.
        evaluations: end each run with the generation in which it has asked for so many function values, whatever the
            algorithm; None: at the paper's limits.

    Raises:
        ParameterError: an algorithm that is not known.
    """
    bounds = function.bounds(dimension)

    def limited(settings: MDESettings, each: int) -> MDESettings:
        if evaluations is None:
            return settings
        return replace(settings, generations=max(1, math.ceil((evaluations - settings.population) / each)))

    if algorithm == 'PSO':
        swarm = PSO_SETTINGS if evaluations is None else replace(PSO_SETTINGS, evaluations=evaluations)
        return PSO(bounds, swarm, runs=runs, seed=seed)
    if algorithm == 'DE':
        return MDE(bounds, limited(DE_SETTINGS, DE_SETTINGS.population), runs=runs, seed=seed)
    if algorithm == 'HDE':
        settings = limited(DE_SETTINGS, DE_SETTINGS.population + 1)
        return HDE(bounds, function.gradient, settings, rate=HDE_RATE, runs=runs, seed=seed)
    if algorithm in ('MDE', PER_VECTOR):
        settings = limited(replace(MDE_SETTINGS, per_component=algorithm == 'MDE'), MDE_SETTINGS.population)
        return MDE(bounds, settings, runs=runs, seed=seed)
    raise ParameterError(f'there is no algorithm {algorithm!r}; choose one of {", ".join((*ALGORITHMS, PER_VECTOR))}')


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
