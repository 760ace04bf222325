# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The experiments of the reproduction, their outcomes, and the comparison of runs."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import mannwhitneyu

from pendubot_identification.arrays import Array, Flags
from pendubot_identification.criteria.quadratic import Penalised, Quadratic
from pendubot_identification.model.parameters import Bounds
from pendubot_identification.optimizers.mde import MOST_VECTORS, MDESettings, Objective, OptimizationResult, mde

from .competitors import CLASSIC, FUNCTIONS, PARTICLES, BenchmarkFunction, hde, pso

#: Table 3: a run stops at this error, or after 4000 generations. For PSO these are 4000 function evaluations, as in
#: SwarmOps; otherwise it does not match its column of Table 4.
TARGET = 1e-5
#: Number of variables in Table 4, inferred from its times.
DIMENSION = 2
ALGORITHMS = ('PSO', 'DE', 'HDE', 'MDE')
#: MDE with the operator drawn once per vector, as in the text of the paper.
PER_VECTOR = 'MDE per vector'
#: Settings of Table 3 except PSO; see competitors.py for PSO, DE and HDE.
SETTINGS = {
    'DE': replace(CLASSIC, target=TARGET),
    'HDE': replace(CLASSIC, target=TARGET),
    'MDE': MDESettings(population=50, generations=4000, target=TARGET),
    PER_VECTOR: MDESettings(population=50, generations=4000, per_component=False, target=TARGET),
}

#: Number of runs for a success rate, per run of the paper's tables.
MANY = 10
#: Largest number of runs of a table, limited by the memory.
MOST_RUNS = MOST_VECTORS // (MANY * PARTICLES)
#: Runs of the sweep per run of a table, and largest number of generations; runs that reach the target take 200.
SWEEP, SWEEP_GENERATIONS = 5, 400
THRESHOLDS = tuple(k / 10 for k in range(11))
#: Relative distance from the minimum of J at which J counts as minimised.
NEAR = 1e-6
IDENTIFICATION = 'Identification'


def compete(algorithm: str, function: BenchmarkFunction, n: int, *, runs: int, seed: int = 1) -> OptimizationResult:
    """Minimise a function of n variables with the settings of an algorithm in Table 3."""
    f, bounds = function.value, function.bounds(n)
    if algorithm == 'PSO':
        return pso(f, bounds, target=TARGET, runs=runs, seed=seed)
    settings = SETTINGS[algorithm]
    if algorithm == 'HDE':
        return hde(f, function.gradient, bounds, settings, runs=runs, seed=seed)
    return mde(f, bounds, settings, runs=runs, seed=seed)


@dataclass(frozen=True, slots=True)
class Outcome:
    """The result of the runs of an algorithm on a function of n variables; ``threshold`` is set in the sweep of MDE."""

    function: str
    n: int
    algorithm: str
    threshold: float | None
    result: OptimizationResult

    @property
    def arrived(self) -> Flags:
        """Whether each run reached its target, shape (runs,)."""
        return np.array([reason == 'target' for reason in self.result.stopped_by])


def competition(seed: int, runs: int) -> Iterator[Outcome]:
    """Run the experiment of Table 4 and Figure 1: four algorithms on four functions with the paper's settings."""
    for f in FUNCTIONS:
        for algorithm in ALGORITHMS:
            trial_seed = seed_of(seed, 'competition', f.name, algorithm)
            result = compete(algorithm, f, DIMENSION, runs=MANY * runs, seed=trial_seed)
            yield Outcome(f.name, DIMENSION, algorithm, None, result)


def sweep(seed: int, runs: int, identification: Quadratic, bounds: Bounds) -> Iterator[Outcome]:
    """Run MDE with every threshold, per component and per vector, on each function and on J within its bounds."""
    least = float(identification(identification.minimum(bounds)))
    at_functions = MDESettings(population=50, generations=SWEEP_GENERATIONS, target=TARGET)
    problems: list[tuple[str, Objective, Bounds, MDESettings, int]] = [
        *((f.name, f.value, f.bounds(DIMENSION), at_functions, SWEEP * runs) for f in FUNCTIONS),
        (IDENTIFICATION, Penalised.of(identification), bounds, MDESettings(target=least * (1 + NEAR)), runs),
    ]
    for name, objective, box, settings, count in problems:
        for algorithm in ('MDE', PER_VECTOR):
            for threshold in THRESHOLDS:
                trial_seed = seed_of(seed, 'sweep', name, algorithm, threshold)
                variant = replace(settings, threshold=threshold, per_component=algorithm == 'MDE')
                result = mde(objective, box, variant, runs=count, seed=trial_seed)
                yield Outcome(name, len(box.lower), algorithm, threshold, result)


def seed_of(seed: int, *experiment: object) -> int:
    """Return the seed of an experiment, so that the random numbers of several experiments are independent."""
    name = ' '.join(map(str, experiment)).encode()
    return int(np.random.SeedSequence([seed, *name]).generate_state(1)[0])


def ranks(outcomes: Sequence[OptimizationResult]) -> list[Array]:
    """Return the ranks of runs, the lowest for the best run; ties have the same rank.

    Runs that reach the target rank first, by function evaluations, because their errors are meaningless; then the other
    runs, by their errors.
    """
    keys = []
    for each in outcomes:
        reached = each.value <= TARGET
        keys.append(np.column_stack([~reached, np.where(reached, each.evaluations, each.value)]))
    _, order = np.unique(np.concatenate(keys), axis=0, return_inverse=True)
    return np.split(order.ravel().astype(float), np.cumsum([len(key) for key in keys])[:-1])


def rank_sum(first: Array, second: Array) -> tuple[float, float]:
    """Return the two-sided p of the rank-sum test (Mann and Whitney 1947), and the fraction of pairs won by ``first``.

    Ties count half: the fraction is 1 if every run of ``first`` is better.
    """
    test = mannwhitneyu(first, second, alternative='two-sided', method='asymptotic')
    return float(test.pvalue), 1 - float(test.statistic) / (len(first) * len(second))
