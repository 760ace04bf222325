"""Times MDE beside a peer in the same run: ``make benchmark``.

Ten runs of 30 vectors over 4000 generations on the energy criterion with the paper's seven parameters, of the sample
bag and, where they exist, of the pooled real recordings; interleaved with scipy's differential evolution, vectorised,
on the same criterion and with the same number of function values. Medians; the ratio is what carries over to another
machine.
"""

import csv
import platform
import statistics
import time

import numpy as np
import scipy
from scipy.optimize import differential_evolution

from pendubot_identification.adapters.bag_reader import read_trajectory
from pendubot_identification.adapters.csv_import import import_csv
from pendubot_identification.core.energy import energy_regression
from pendubot_identification.core.mde import MDE, MDESettings
from pendubot_identification.core.optimizer import minimize
from pendubot_identification.core.parameters import coupling_excess, default_bounds
from pendubot_identification.core.quadratic import Quadratic
from test.conftest import RECORDINGS, ROOT

REPETITIONS = 5
RUNS, POPULATION, GENERATIONS = 10, 30, 4000


def problems():
    """Yield a name and its motions."""
    motion = read_trajectory(ROOT / 'bags' / 'paper_experiment').trajectory
    yield 'sample bag, 900 samples', [motion[: len(motion) // 2]]
    if (RECORDINGS / 'manifest.csv').exists():
        rows = list(csv.DictReader((RECORDINGS / 'manifest.csv').open()))
        train = [r['file'] for r in rows if r['group'] == 'dfki_C1_sysid' and r['role'] == 'train']
        motions = [import_csv(RECORDINGS / name) for name in train]
        yield f'dfki_C1_sysid, {sum(map(len, motions))} samples pooled', motions


def timed(work, *arguments):
    begin = time.perf_counter()
    result = work(*arguments)
    return time.perf_counter() - begin, result


def penalised(criterion):
    """Return what ``pendubot identify`` minimises: a mass matrix that is not positive definite costs more."""
    worth = float(criterion(np.zeros(7)))
    return lambda x: criterion(x) + worth * coupling_excess(x)


def scipy_once(objective, bounds, seed):
    """One run of the peer with the same budget and no early stop, its population as wide as ours."""
    return differential_evolution(
        lambda x: objective(x.T),
        list(zip(bounds.lower, bounds.upper, strict=True)),
        init=bounds.lower + np.random.default_rng(seed).random((POPULATION, 7)) * (bounds.upper - bounds.lower),
        maxiter=GENERATIONS,
        tol=0,
        atol=0,
        polish=False,
        vectorized=True,
        updating='deferred',
        seed=seed,
    )


def main():
    """Print a table."""
    versions = f'Python {platform.python_version()}, numpy {np.__version__}, scipy {scipy.__version__}'
    print(f'{platform.processor() or platform.machine()}, {versions}')
    print(f'{RUNS} runs x {GENERATIONS} generations x {POPULATION} vectors, medians of {REPETITIONS}\n')
    print('| problem | variant | time of all runs | runs at the minimum | generations to it | scipy DE / this |')
    print('|---|---|---|---|---|---|')
    bounds = default_bounds().of(7)
    for name, motions in problems():
        begin = time.perf_counter()
        parts = [Quadratic.reduce(r.phi, r.y) for r in map(energy_regression, motions)]
        criterion = Quadratic.pool(parts)
        reduction = time.perf_counter() - begin
        exact, objective = float(criterion(criterion.minimum(bounds))), penalised(criterion)
        variants = {'per component': True, 'per vector': False}
        times = {variant: [] for variant in variants}
        results, peer = {}, []
        for seed in range(REPETITIONS):
            for variant, per_component in variants.items():
                settings = MDESettings(POPULATION, GENERATIONS, per_component=per_component)
                optimizer = MDE(bounds, settings, runs=RUNS, seed=seed)
                spent, results[variant] = timed(minimize, optimizer, objective)
                times[variant].append(spent)
            peer.append(RUNS * timed(scipy_once, objective, bounds, seed)[0])
        for variant in variants:
            reached = results[variant].history <= exact * (1 + 1e-6)
            median = statistics.median(times[variant])
            print(
                f'| {name} | {variant} | {median:.2f} s | {int(reached[-1].sum())} of {RUNS} '
                f'| {int(np.median(reached.argmax(axis=0)))} | {statistics.median(peer) / median:.0f} |'
            )
        print(f'| {name} | reduction by QR, all samples | {reduction * 1e3:.1f} ms | | | |')


if __name__ == '__main__':
    main()
