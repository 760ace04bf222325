"""What the reproduction of the paper runs, experiment by experiment, and what came of it, as plain data."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.criteria.quadratic import Penalised, Quadratic
from pendubot_identification.model.parameters import Bounds
from pendubot_identification.optimizers.mde import MDE, MDESettings
from pendubot_identification.optimizers.optimizer import MOST_VECTORS, Objective, OptimizationResult, Optimizer

from .benchmark_functions import FUNCTIONS
from .competition import ALGORITHMS, DIMENSION, MDE_SETTINGS, PER_VECTOR, PSO_SETTINGS, contestant, seed_of

Array = NDArray[np.float64]

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


@dataclass(frozen=True, slots=True)
class Trial:
    """Runs of one algorithm on one function.

    Attributes:
        function: its name.
        dimension: n.
        algorithm: as in :mod:`.competition`.
        threshold: of MDE, where it is not the paper's.
        seed: the trial's own.
        start: makes the optimiser.
        objective: what it minimises.
        detailed: whether points and histories are worth keeping.
    """

    function: str
    dimension: int
    algorithm: str
    threshold: float | None
    seed: int
    start: Callable[[], Optimizer]
    objective: Objective
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
            'evaluations_at_start': int(result.cost[0]),
            'evaluations_per_generation': int(np.diff(result.cost[:2]).sum()),
            'runs': runs,
        }


def competition(seed: int, runs: int) -> Iterator[Trial]:
    """Yield Table 4's and Figure 1's: four algorithms, four functions, the paper's settings."""
    for f in FUNCTIONS:
        for algorithm in ALGORITHMS:
            own = seed_of(seed, 'competition', f.name, algorithm)
            start = partial(contestant, algorithm, f, runs=MANY * runs, seed=own)
            yield Trial(f.name, DIMENSION, algorithm, None, own, start, f.value, detailed=True)


def dimensions(seed: int, runs: int) -> Iterator[Trial]:
    """Yield the same in more dimensions, everyone with as many function values."""
    for n in DIMENSIONS:
        for f in FUNCTIONS:
            for algorithm in (*ALGORITHMS, PER_VECTOR):
                own = seed_of(seed, 'dimensions', n, f.name, algorithm)
                start = partial(contestant, algorithm, f, n, runs=runs, seed=own, evaluations=BUDGET * n)
                yield Trial(f.name, n, algorithm, None, own, start, f.value)


def sweep(seed: int, runs: int, identification: Quadratic, bounds: Bounds) -> Iterator[Trial]:
    """Yield MDE with every threshold, its operator drawn per component and per vector, on each function and on J.

    Args:
        seed: of everything.
        runs: as Table 4 has.
        identification: J of the paper's experiment.
        bounds: its box.
    """
    least = float(identification(identification.minimum(bounds)))
    problems: list[tuple[str, Bounds, Objective, MDESettings, int]] = [
        (f.name, f.bounds(DIMENSION), f.value, replace(MDE_SETTINGS, generations=SWEEP_GENERATIONS), SWEEP * runs)
        for f in FUNCTIONS
    ]
    settings = MDESettings(target=least * (1 + NEAR))
    problems.append((IDENTIFICATION, bounds, Penalised.of(identification), settings, runs))
    for name, box, objective, settings, count in problems:
        for algorithm in ('MDE', PER_VECTOR):
            for threshold in THRESHOLDS:
                own = seed_of(seed, 'sweep', name, algorithm, threshold)
                chosen = replace(settings, threshold=threshold, per_component=algorithm == 'MDE')
                start = partial(MDE, box, chosen, runs=count, seed=own)
                yield Trial(name, len(box.lower), algorithm, threshold, own, start, objective)
