# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""DE and PSO, compared with SwarmOps, the source of the paper's settings; the gradient step of HDE."""

from dataclasses import replace
from functools import partial
from unittest import mock

import numpy as np
import pytest
from scipy.stats import mannwhitneyu

from pendubot_identification.optimizers import mde as mde_module
from pendubot_identification.optimizers.mde import columns, mde
from pendubot_identification.paper.competitors import CLASSIC, FUNCTIONS, hde, pso

with mock.patch.object(np, 'Infinity', np.inf, create=True):  # numpy 2 has dropped the name
    pytest.importorskip('swarmops')
    from swarmops import DE, PSO, tools
    from swarmops.Problem import Problem

SPHERE, GRIEWANK, _, RASTRIGIN = FUNCTIONS


def swarmops(algorithm, function, parameters, *, evaluations, runs):
    """Return the errors of 2-dimensional runs after ``evaluations`` function values."""
    bounds = function.bounds(2)

    def fitness(x, limit=np.inf):
        return float(function.value(x))

    problem = Problem(function.name, 2, 0.0, bounds.lower, bounds.upper, func=fitness)
    errors = []
    for run in range(runs):
        tools.new_prng(1000 + run)
        errors.append(algorithm(problem=problem, parameters=parameters, max_evaluations=evaluations).best_fitness)
    return np.array(errors)


def test_de_agrees_with_swarmops(monkeypatch):
    """Table 3's settings, 30 generations; both clip to the bounds. The errors have the same distribution."""
    monkeypatch.setattr(mde_module, 'drawn_back', lambda v, x, bounds: np.clip(v, *columns(bounds)))
    ours = mde(RASTRIGIN.value, RASTRIGIN.bounds(2), replace(CLASSIC, generations=29), runs=1000).value
    theirs = swarmops(DE.DE, RASTRIGIN, [18, 0.5026, 0.6714], evaluations=30 * 18, runs=100)
    assert mannwhitneyu(ours, theirs).pvalue > 0.01


def test_pso_agrees_with_swarmops():
    """Table 3's settings, 4000 function values: the errors have the same distribution."""
    ours = pso(GRIEWANK.value, GRIEWANK.bounds(2), runs=500)
    assert ours.evaluations.tolist() == [27 * 149] * 500, 'the generation that reaches 4000 is completed'
    theirs = swarmops(PSO.PSO, GRIEWANK, [149, -0.3236, -0.1136, 3.9789], evaluations=4000, runs=50)
    assert mannwhitneyu(ours.value, theirs).pvalue > 0.01


@pytest.mark.parametrize('minimise', [pso, partial(hde, gradient=GRIEWANK.gradient, settings=CLASSIC, rate=1e4)])
def test_pso_and_hde_keep_the_bounds_and_never_worsen(minimise):
    distances = []

    def value(x):
        distances.append(np.abs(x).max())
        return GRIEWANK.value(x)

    result = minimise(value, bounds=GRIEWANK.bounds(2), runs=4)
    assert max(distances) <= GRIEWANK.half_width
    assert (np.diff(result.history, axis=0) <= 0).all()
    np.testing.assert_array_equal(result.history[-1], result.value)
    np.testing.assert_allclose(GRIEWANK.value(result.x), result.value)


def test_each_run_of_pso_stops_at_the_target():
    result = pso(SPHERE.value, SPHERE.bounds(2), particles=30, evaluations=9000, target=1e-2, runs=7, seed=5)
    assert set(result.stopped_by) == {'target'}
    assert len(set(result.generations)) > 1
    assert (result.evaluations == 30 * (result.generations + 1)).all()


def test_hde_steps_along_the_gradient_of_the_best_vector_and_keeps_improvements():
    evaluated, short = [], replace(CLASSIC, generations=30)

    def value(x):
        evaluated.append(x.copy())
        return SPHERE.value(x)

    result = hde(value, lambda x: 2 * x, SPHERE.bounds(2), short, rate=0.25, runs=3)
    assert [x.shape for x in evaluated] == [(3, 18, 2)] + [(3, 2), (3, 18, 2)] * 30
    assert result.evaluations.tolist() == [18 + 30 * 19] * 3
    for generation, step in enumerate(evaluated[1::2], start=1):
        np.testing.assert_allclose(SPHERE.value(step), result.history[generation - 1] / 4, rtol=1e-12)
        assert (result.history[generation] <= SPHERE.value(step) * (1 + 1e-12)).all(), 'a better step is kept'
