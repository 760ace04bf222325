# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Compares MDE with differential evolutions from PyPI, all with the same number of function values."""

import numpy as np
from scipy.optimize import differential_evolution

from benchmarks.markdown import table
from benchmarks.speed.measure import interleaved, on, seconds
from pendubot_identification.criteria.energy import energy_regression
from pendubot_identification.criteria.quadratic import Penalised, Quadratic
from pendubot_identification.model.parameters import coupling_excess, default_bounds
from pendubot_identification.optimizers import mde as optimizer
from pendubot_identification.optimizers.mde import MDESettings
from pendubot_identification.recordings.bag_reader import read_trajectory
from test.conftest import ROOT

RUNS, POPULATION, GENERATIONS = 10, 30, 4000
#: Parameters of classic DE, close to MDE's averages.
WEIGHT, CROSSOVER = 0.7, 0.85


def energy_criterion():
    """Return the paper's criterion of the first half of the sample bag."""
    motion = read_trajectory(ROOT / 'bags' / 'paper_experiment').trajectory
    regression = energy_regression(motion[: len(motion) // 2])
    return Quadratic.reduce(regression.phi, regression.y)


def by_blas(criterion):
    """Return the same penalised criterion in plain numpy, for a population at once."""
    phi, y, count, floor = criterion.phi.T.copy(), criterion.y, criterion.count, criterion.floor
    worth = Penalised.of(criterion).worth

    def value(x):
        residual = x @ phi - y
        return (residual * residual).sum(axis=-1) / count + floor + worth * coupling_excess(x)

    return value


def mde(objective, bounds, **settings):
    chosen = MDESettings(POPULATION, GENERATIONS, **settings)
    return lambda: optimizer.mde(objective, bounds, chosen, runs=RUNS)


def scipys(value, bounds):
    limits = list(zip(bounds.lower, bounds.upper, strict=True))

    def run():
        for seed in range(RUNS):
            start = np.random.default_rng(seed).random((POPULATION, len(limits)))
            differential_evolution(
                lambda x: value(x.T),
                limits,
                init=bounds.lower + start * (bounds.upper - bounds.lower),
                maxiter=GENERATIONS,
                tol=0,
                atol=-1,  # at 0 it would stop if all values were equal
                polish=False,
                vectorized=True,
                updating='deferred',
                mutation=WEIGHT,
                recombination=CROSSOVER,
                rng=seed,
            )

    return run


def pygmos(criterion, bounds):
    """Return pygmo's DE, which evaluates one vector at a time, by the fastest numpy code."""
    import pygmo

    phi, y, count, floor = np.ascontiguousarray(criterion.phi), criterion.y, criterion.count, criterion.floor

    class Problem:
        def fitness(self, x):
            residual = phi @ x - y
            return [residual @ residual / count + floor]

        def get_bounds(self):
            return bounds.lower, bounds.upper

    def run():
        for seed in range(RUNS):
            start = pygmo.population(pygmo.problem(Problem()), size=POPULATION, seed=seed)
            how = pygmo.de(gen=GENERATIONS, F=WEIGHT, CR=CROSSOVER, ftol=0, xtol=0, seed=seed)
            pygmo.algorithm(how).evolve(start)

    return run


def full_budget():
    """Compare MDE on both paths, and the differential evolution of other packages."""
    criterion, bounds = energy_criterion(), default_bounds().of(7)
    objective = Penalised.of(criterion)
    spent = interleaved(
        {
            'kernel': on(True, mde(objective, bounds)),
            'kernel, per vector': on(True, mde(objective, bounds, per_component=False)),
            'numpy': on(False, mde(objective, bounds)),
            'numpy, per vector': on(False, mde(objective, bounds, per_component=False)),
            'scipy DE, vectorised': scipys(by_blas(criterion), bounds),
            'pygmo DE': pygmos(criterion, bounds),
            'exact bounded least squares (no MDE at all)': lambda: criterion.minimum(bounds),
        }
    )
    ours = 'kernel', 'numpy'
    rows = (
        (name, seconds(time), *('' if name in ours else f'{time / spent[other]:.3g}' for other in ours))
        for name, time in spent.items()
    )
    table(('', 'time', *(f'over {name}' for name in ours)), rows)
