"""MDE as the paper's Table 1: what it draws, what it keeps, and that it finds minima."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pendubot_identification.core.energy import energy_regression
from pendubot_identification.core.errors import ParameterError
from pendubot_identification.core.estimate import REACHED
from pendubot_identification.core.mde import BLOCK, MDE, MDESettings, _Mutations
from pendubot_identification.core.optimizer import minimize
from pendubot_identification.core.parameters import Bounds, default_bounds
from pendubot_identification.core.quadratic import Penalised, Quadratic
from pendubot_identification.core.settings import SPREAD
from test.core.virtual import recording


def box(dimension, low=-5.0, high=10.0):
    names = tuple(f'x{k}' for k in range(dimension))
    return Bounds(np.full(dimension, low), np.full(dimension, high), names)


def sphere(x):
    return (np.asarray(x) ** 2).sum(axis=-1)


def rosenbrock(x):
    x = np.asarray(x)
    return (100 * (x[..., 1:] - x[..., :-1] ** 2) ** 2 + (1 - x[..., :-1]) ** 2).sum(axis=-1)


@pytest.mark.parametrize('per_component', [True, False])
@pytest.mark.parametrize(('function', 'dimension', 'where'), [(sphere, 4, 0.0), (rosenbrock, 2, 1.0)])
def test_finds_the_minimum_in_every_run(per_component, function, dimension, where):
    settings = MDESettings(generations=1500, per_component=per_component)
    result = minimize(MDE(box(dimension), settings, runs=5), function)
    np.testing.assert_allclose(result.x, where, atol=1e-3)
    np.testing.assert_allclose(result.value, function(result.x))
    assert result.value[result.best] == result.value.min()


def test_finds_a_minimum_on_the_bound():
    result = minimize(MDE(box(3, low=0.5), MDESettings(generations=600), runs=3), sphere)
    np.testing.assert_allclose(result.x, 0.5, atol=1e-9)


@pytest.mark.parametrize('per_component', [True, False])
def test_a_runs_result_does_not_depend_on_its_neighbours(per_component):
    settings = MDESettings(generations=60, target=1e-2, per_component=per_component)
    many = minimize(MDE(box(3), settings, runs=7, seed=5), sphere)
    few = minimize(MDE(box(3), settings, runs=3, seed=5), sphere)
    np.testing.assert_array_equal(many.x[:3], few.x)
    np.testing.assert_array_equal(many.generations[:3], few.generations)
    assert len(np.unique(many.value)) == 7, 'the runs differ from each other'


def test_same_seed_same_result_other_seed_other_result():
    first, again, other = (minimize(MDE(box(3), MDESettings(generations=30), seed=s), sphere) for s in (1, 1, 2))
    np.testing.assert_array_equal(first.x, again.x)
    assert (first.x != other.x).any()


def test_never_leaves_the_bounds_and_never_forgets_the_best():
    optimizer = MDE(box(2, -1.0, 0.3), MDESettings(population=8, generations=200), runs=4)
    asked = []

    def watched(x):
        asked.append(x.copy())
        return sphere(x - 0.29)

    result = minimize(optimizer, watched)
    points = np.concatenate([a.reshape(-1, 2) for a in asked])
    assert points.min() >= -1.0
    assert points.max() <= 0.3
    assert (np.diff(result.history, axis=0) <= 0).all()
    assert result.evaluations.tolist() == [201 * 8] * 4
    assert len(asked) == 201
    np.testing.assert_array_equal(result.history[-1], result.value)


def test_stops_at_the_target_at_the_spread_or_at_the_last_generation():
    at_target = minimize(MDE(box(2), MDESettings(target=1e-3)), sphere)
    assert set(at_target.stopped_by) == {'target'}
    assert at_target.value.max() <= 1e-3
    assert len(set(at_target.generations)) > 1, 'each run stops by itself'
    at_spread = minimize(MDE(box(2), MDESettings(spread=1e-6)), lambda x: 1 + sphere(x))
    assert set(at_spread.stopped_by) == {'spread'}
    np.testing.assert_allclose(at_spread.value, 1, rtol=1e-5)
    assert set(minimize(MDE(box(2), MDESettings(generations=3)), sphere).stopped_by) == {'generations'}


@pytest.mark.parametrize(('seed', 'strength'), [(1, 1.0), (2, 0.3), (4, 1.0)])
def test_stopping_at_the_spread_loses_nothing_that_4000_generations_find(seed, strength):
    """The default of an identification against the paper's, on the paper's criterion."""
    regression = energy_regression(recording(900, seed=seed, strength=strength))
    criterion, bounds = Quadratic.reduce(regression.phi, regression.y), default_bounds().of(7)
    exact = float(criterion(criterion.minimum(bounds)))
    objective = Penalised.of(criterion)
    full, early = (minimize(MDE(bounds, MDESettings(spread=spread), seed=seed), objective) for spread in (None, SPREAD))
    assert early.generations.max() < 4000
    np.testing.assert_array_less(full.value, exact * (1 + REACHED))
    np.testing.assert_array_less(early.value, exact * (1 + REACHED))


@settings(max_examples=40)
@given(st.integers(5, 40), st.integers(1, 8), st.booleans(), st.floats(0, 1), st.integers(0, 1000))
def test_mutations_are_the_papers(population, dimension, per_component, threshold, seed):
    """Partners differ from each other and the target; one component at least crosses over; F within its range."""
    chosen = MDESettings(population=population, threshold=threshold, per_component=per_component)
    m = _Mutations.draw([np.random.Generator(np.random.SFC64(seed))], chosen, dimension)
    target = np.arange(population)[:, None]
    rows = {name: getattr(m, name) // dimension for name in ('base', 'plus', 'minus')}
    for name in rows:
        assert (getattr(m, name) % dimension == np.arange(dimension)).all(), 'a component mixes with its own kind only'
    crosses = m.weight > 0
    assert crosses.any(axis=-1).all()
    assert m.weight.shape == (BLOCK, 1, population, dimension)
    assert m.weight[crosses].min() >= 0.4
    assert m.weight[crosses].max() <= 1.0
    assert (rows['base'][~crosses] == np.broadcast_to(target, m.base.shape)[~crosses]).all()
    best = crosses & (rows['base'] == population)
    partners = crosses & ~best
    assert (rows['plus'] != rows['minus']).all()
    assert (rows['plus'] != target).all()
    assert (rows['minus'] != target).all()
    assert (rows['base'] != target)[partners].all()
    assert (rows['base'] != rows['plus'])[partners].all()
    assert (rows['base'] != rows['minus'])[partners].all()
    assert (
        max(r.max() for r in (rows['plus'], rows['minus'], rows['base'][partners])) < population
        if partners.any()
        else True
    )
    if not per_component:
        assert (best.any(axis=-1) == (best == crosses).all(axis=-1)).all(), 'one operator for the whole vector'


def test_operators_partners_and_rates_are_drawn_as_often_as_told():
    chosen = MDESettings(population=10, threshold=0.3)
    stream = np.random.Generator(np.random.SFC64(1))
    drawn = [_Mutations.draw([stream], chosen, 7) for _ in range(60)]
    weight = np.concatenate([m.weight for m in drawn])
    base = np.concatenate([m.base for m in drawn]) // 7
    plus = np.concatenate([m.plus for m in drawn]) // 7
    crosses = weight > 0
    # CR ~ U[0.7, 1] crosses 0.85 of the components, and jrand one of the seven others.
    assert crosses.mean() == pytest.approx(0.85 + 0.15 / 7, abs=0.005)
    assert (base[crosses] == 10).mean() == pytest.approx(0.3, abs=0.01)
    assert weight[crosses].mean() == pytest.approx(0.7, abs=0.005)
    steps = (plus - np.arange(10)[:, None]) % 10
    np.testing.assert_allclose(np.bincount(steps.ravel(), minlength=10)[1:] / steps.size, 1 / 9, atol=0.005)
    rand1 = crosses & (base < 10)
    steps = ((base - np.arange(10)[:, None]) % 10)[rand1]
    np.testing.assert_allclose(np.bincount(steps, minlength=10)[1:] / steps.size, 1 / 9, atol=0.005)


@pytest.mark.parametrize(
    ('changes', 'sentence'),
    [
        ({'population': 4}, 'NP is 4; at least 5'),
        ({'generations': 0}, 'at least 1'),
        ({'threshold': 1.5}, 'from 0 to 1'),
        ({'weight': (1.0, 0.4)}, 'weight F'),
        ({'crossover': (0.7, 1.2)}, 'at most 1'),
        ({'spread': 0.0}, 'above 0'),
    ],
)
def test_settings_without_sense_are_refused(changes, sentence):
    with pytest.raises(ParameterError, match=sentence):
        MDESettings(**changes)


def test_no_runs_and_negative_seeds_are_refused():
    with pytest.raises(ParameterError, match='0 runs'):
        MDE(box(2), runs=0)
    with pytest.raises(ParameterError, match='seed is -1'):
        MDE(box(2), seed=-1)
