# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""MDE in numpy and C, compared with the paper's Table 1 written as plain loops."""

import random
from functools import cache

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.stats import mannwhitneyu

from pendubot_identification import kernel
from pendubot_identification.criteria.quadratic import Penalised, Quadratic
from pendubot_identification.errors import ParameterError
from pendubot_identification.model.parameters import Bounds, default_bounds
from pendubot_identification.optimizers.mde import MDESettings, mde


@pytest.fixture(params=['kernel', 'numpy'])
def path(request, monkeypatch):
    if request.param == 'kernel' and kernel.library() is None:
        pytest.skip(kernel.description())
    monkeypatch.setattr(kernel, 'wanted', request.param == 'kernel')


def box(dimension):
    return Bounds(np.zeros(dimension), np.full(dimension, 3.0), tuple(f'x{k}' for k in range(dimension)))


def quadratic(dimension, seed=1, indefinite=False):
    """Return a least-squares problem, on request with a minimum at which the mass matrix is indefinite."""
    rng = np.random.default_rng(seed)
    theta = rng.uniform(0.1, 0.9, dimension)
    if indefinite:
        theta[2] = 2 * np.sqrt(theta[0] * theta[1])
    phi = rng.normal(size=(100, dimension))
    return Quadratic.reduce(phi, phi @ theta + 0.1 * rng.normal(size=100))


def table_1(f, bounds, how, seed, line_14=True):
    """Return the best value of one run of the pseudocode; by `line_14`, r1 and r2 also differ from best."""
    chance = random.Random(seed)
    low, high = bounds.lower.tolist(), bounds.upper.tolist()
    D, NP = len(low), how.population
    x = [[chance.uniform(low[j], high[j]) for j in range(D)] for _ in range(NP)]
    J = [f(v) for v in x]
    for _ in range(how.generations):
        best, trials = J.index(min(J)), []

        def choose(i, best=best):
            if chance.random() > how.threshold:
                return chance.sample([k for k in range(NP) if k != i], 3)
            return best, *chance.sample([k for k in range(NP) if k not in ((i, best) if line_14 else (i,))], 2)

        for i in range(NP):
            F, CR, jrand = chance.uniform(*how.weight), chance.uniform(*how.crossover), chance.randrange(D)
            v, once = list(x[i]), choose(i)
            for j in range(D):
                if chance.random() < CR or j == jrand:
                    a, b, c = choose(i) if how.per_component else once
                    y = x[a][j] + F * (x[b][j] - x[c][j])
                    v[j] = (x[i][j] + low[j]) / 2 if y < low[j] else (x[i][j] + high[j]) / 2 if y > high[j] else y
            trials.append(v)
        for i, v in enumerate(trials):
            if (value := f(v)) <= J[i]:
                x[i], J[i] = v, value
    return min(J)


@cache
def found_by_table_1(how, line_14=True):
    """Return the best values of 100 runs of the plain loops on quadratic(3)."""
    root = quadratic(3).root.tolist()

    def f(v):
        return sum((sum(map(float.__mul__, row, v)) - row[-1]) ** 2 for row in root)

    return [table_1(f, box(3), how, seed, line_14) for seed in range(100)]


@pytest.mark.parametrize('per_component', [True, False])
@pytest.mark.parametrize('threshold', [0.3, 1.0])
def test_the_best_values_have_the_distribution_of_table_1(path, threshold, per_component):
    how = MDESettings(10, 40, threshold, per_component=per_component)
    ours = mde(quadratic(3), box(3), how, runs=1000).value
    assert mannwhitneyu(ours, found_by_table_1(how)).pvalue > 0.01
    if threshold == 1.0 and per_component:
        other = found_by_table_1(how, line_14=False)
        assert mannwhitneyu(ours, other).pvalue < 1e-6, 'the test detects a best vector among r1 and r2'


@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(3, 20), st.integers(5, 70), st.integers(1, 5), st.booleans(), st.booleans(), st.integers(0, 1000))
def test_problems_of_any_size_are_minimised(path, dimension, population, runs, per_component, indefinite, seed):
    criterion, bounds = quadratic(dimension, seed, indefinite), box(dimension)
    objective = Penalised.of(criterion) if indefinite else criterion
    how = MDESettings(population, 60, per_component=per_component)
    result = mde(objective, bounds, how, runs=runs, seed=seed)
    np.testing.assert_allclose(objective(result.x), result.value, rtol=1e-9)
    np.testing.assert_array_equal(result.history[-1], result.value)
    assert result.value[result.best] == result.value.min()
    assert result.evaluations.tolist() == [61 * population] * runs
    assert (result.value < result.history[0]).all()
    assert (np.diff(result.history, axis=0) <= 0).all()
    assert ((bounds.lower <= result.x) & (result.x <= bounds.upper)).all()


@pytest.mark.parametrize('seed', [1, 2])
def test_an_indefinite_minimum_is_replaced_by_the_best_definite_vector(path, seed):
    criterion = quadratic(7, seed, indefinite=True)
    bounds = Bounds(np.zeros(7), np.full(7, 3.0), default_bounds().of(7).names)
    least = float(criterion(criterion.minimum(bounds)))
    assert least > 1.01 * float(criterion(criterion.minimum_in_box(bounds)))
    result = mde(Penalised.of(criterion), bounds, MDESettings(generations=1500, per_component=False), runs=3)
    np.testing.assert_allclose(result.value, least, rtol=1e-4)


def test_the_result_is_determined_by_the_seed(path):
    first, again, other = (mde(quadratic(3), box(3), MDESettings(generations=30), seed=s) for s in (1, 1, 2))
    np.testing.assert_array_equal(first.x, again.x)
    np.testing.assert_array_equal(first.history, again.history)
    assert (first.x != other.x).any()
    assert len(np.unique(first.value)) == 10, 'the runs differ from each other'


def test_each_run_stops_at_the_target_the_spread_or_the_last_generation(path):
    criterion, bounds = quadratic(7), box(7)
    least = float(criterion(criterion.minimum(bounds)))
    target = least * (1 + 1e-6)
    at_target = mde(criterion, bounds, MDESettings(target=target))
    assert set(at_target.stopped_by) == {'target'}
    assert len(set(at_target.generations)) > 1, 'each run stops by itself'
    for run, last in enumerate(at_target.generations):
        assert at_target.history[last, run] <= target < at_target.history[last - 1, run]
        assert (at_target.history[last:, run] == at_target.value[run]).all(), 'a run that has stopped keeps its value'
    at_spread = mde(criterion, bounds, MDESettings(spread=1e-6))
    assert set(at_spread.stopped_by) == {'spread'}
    np.testing.assert_allclose(at_spread.value, least, rtol=1e-5)
    at_once = mde(criterion, bounds, MDESettings(target=1e9))
    assert (set(at_once.generations), at_once.history.shape) == ({0}, (1, 10))
    at_last = mde(criterion, bounds, MDESettings(generations=100))
    assert set(at_last.stopped_by) == {'generations'}
    assert at_last.history.shape == (101, 10)


def test_progress_is_reported_to_the_end(path):
    reports = []
    how = MDESettings(generations=1200)
    result = mde(quadratic(7), box(7), how, runs=2, progress=lambda *report: reports.append(report))
    assert reports[-1] == (1200, result.value.min())
    done, best = zip(*reports, strict=True)
    assert list(done) == sorted(done)
    assert list(best) == sorted(best, reverse=True)


@pytest.mark.parametrize(
    ('changes', 'sentence'),
    [
        ({'population': 4}, 'NP is 4; at least 5'),
        ({'generations': 0}, 'at least 1'),
        ({'spread': 0.0}, 'above 0'),
        ({'runs': 0}, '0 runs'),
        ({'seed': -1}, 'seed is -1'),
        ({'runs': 4000}, 'at most 100000'),
    ],
)
def test_invalid_settings_are_refused(changes, sentence):
    of_runs = {name: value for name, value in changes.items() if name in ('runs', 'seed')}
    with pytest.raises(ParameterError, match=sentence):
        mde(quadratic(2), box(2), MDESettings(**{n: v for n, v in changes.items() if n not in of_runs}), **of_runs)
