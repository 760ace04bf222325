"""MDE as the paper's Table 1: what it draws, what it keeps, and that it finds minima."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import binomtest, chisquare

from pendubot_identification.criteria.energy import energy_regression
from pendubot_identification.criteria.quadratic import Penalised, Quadratic
from pendubot_identification.errors import ParameterError
from pendubot_identification.identify.estimate import REACHED
from pendubot_identification.identify.settings import SPREAD
from pendubot_identification.model.parameters import Bounds, default_bounds
from pendubot_identification.optimizers.mde import BLOCK, MDE, MDESettings, _draw, _looked_up, _steps
from pendubot_identification.optimizers.optimizer import minimize
from test.virtual import recording


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
@given(st.integers(5, 60), st.integers(1, 8), st.booleans(), st.floats(0, 1), st.integers(0, 1000))
def test_mutations_are_the_papers(population, dimension, per_component, threshold, seed):
    """Partners differ from each other and the target; one component at least crosses over; F within its range."""
    chosen = MDESettings(population=population, threshold=threshold, per_component=per_component)
    steps, weight = _draw([np.random.Generator(np.random.SFC64(seed))], chosen, dimension)
    assert weight.shape == (BLOCK, 1, population)
    assert weight.min() >= 0.4
    assert weight.max() <= 1.0
    assert steps.shape[:4] == (BLOCK, dimension, 1, population)
    plus, minus, base = (steps[..., k].astype(int) for k in range(3))
    kept, best = base == 0, base == 2 * population
    crosses, rand = ~kept, ~kept & ~best
    assert (plus == minus)[kept].all(), 'a difference of 0'
    assert crosses.any(axis=1).all()
    for others in (plus, minus, base[rand]):
        assert 1 <= others.min(initial=1) <= others.max(initial=1) < population, 'once round the ring is the target'
    assert (plus != minus)[crosses].all()
    assert (base != plus)[rand].all()
    assert (base != minus)[rand].all()
    if not per_component:
        one = crosses.argmax(axis=1)[:, None]
        for what in (plus, minus, base):
            same = np.take_along_axis(what, one, axis=1)
            assert ((what == same) | kept).all(), 'partners and operator are those of the whole vector'


def test_a_threshold_is_kept_at_its_ends():
    for threshold, best in ((0.0, False), (1.0, True)):
        for per_component in (True, False):
            chosen = MDESettings(crossover=(0.0, 1.0), threshold=threshold, per_component=per_component)
            base = _draw([np.random.Generator(np.random.SFC64(1))], chosen, 7)[0][..., 2]
            assert ((base[base > 0] == 60) == best).all()


@pytest.mark.parametrize('rate', [0.0, 1.0])
def test_a_crossover_rate_is_kept_at_its_ends(rate):
    steps, _ = _draw([np.random.Generator(np.random.SFC64(1))], MDESettings(crossover=(rate, rate)), 7)
    assert ((steps[..., 2] > 0).sum(axis=1) == (7 if rate else 1)).all()


@settings(max_examples=30)
@given(st.integers(5, 60), st.integers(0, 1000))
def test_a_table_of_partners_tells_what_is_computed(population, seed):
    rng = np.random.default_rng(seed)
    ends = [0, 1, 2**31, 2**32 - 1]
    u = np.concatenate([ends, rng.integers(2**32, size=500)]).astype(np.uint32)
    how = rng.integers(3, size=len(u)).astype(np.uint8)
    tabulated = _looked_up(u, how, population)[..., :3]
    np.testing.assert_array_equal(tabulated, _steps(u, how, population))


def drawn(generations, per_component, population=6, dimension=7):
    """Return what many generations drew, shape (generations, D, NP, 3), and the weights, shape (generations, NP)."""
    chosen = MDESettings(population=population, threshold=0.3, per_component=per_component)
    stream = np.random.Generator(np.random.SFC64(1))
    parts = [_draw([stream], chosen, dimension) for _ in range(generations // BLOCK)]
    steps = np.concatenate([steps[..., :3].astype(int) for steps, _ in parts])[:, :, 0]
    return steps, np.concatenate([weight for _, weight in parts])[:, 0]


@pytest.mark.parametrize('per_component', [True, False])
def test_partners_and_operators_are_drawn_as_often_as_told(per_component):
    """Chi-square tests, of a draw that is the same every time."""
    population, dimension = 6, 7
    steps, weight = drawn(8000, per_component)
    plus, minus, base = np.moveaxis(steps, -1, 0)
    crosses = base > 0
    best = base == 2 * population
    if not per_component:  # once for a vector
        one = crosses.argmax(axis=1)[:, None]
        plus, minus, base, best = (np.take_along_axis(a, one, axis=1) for a in (plus, minus, base, best))
        of_draws = np.ones_like(best)
    else:
        of_draws = crosses
    rand = of_draws & ~best
    triples = np.stack([plus[rand], minus[rand], base[rand]])
    _, counts = np.unique(triples, axis=1, return_counts=True)
    assert len(counts) == 5 * 4 * 3
    assert chisquare(counts).pvalue > 0.01
    pairs = np.unique(np.stack([plus[best], minus[best]]), axis=1, return_counts=True)[1]
    assert len(pairs) == 5 * 4
    assert chisquare(pairs).pvalue > 0.01, 'of best/1 too: partners do not depend on the operator'
    # One of seven components is forced; of the others CR ~ U[0.7, 1] crosses 0.85.
    share = 0.85 + 0.15 / dimension
    counted = [crosses.sum(), (~crosses).sum()]
    assert chisquare(counted, np.multiply([share, 1 - share], crosses.size)).pvalue > 0.01
    counted = [best[of_draws].sum(), rand.sum()]
    assert chisquare(counted, np.multiply([0.3, 0.7], of_draws.sum())).pvalue > 0.01
    counted = np.histogram(weight, 30, (0.4, 1.0))[0]
    assert chisquare(counted).pvalue > 0.01


def test_the_operator_depends_neither_on_the_crossover_rate_nor_on_how_a_component_came_to_cross():
    """Of vectors in which many components cross, and so of high CR, and of those whose forced one alone does."""
    for crossover in ((0.7, 1.0), (0.0, 0.05), (0.0, 1.0)):
        chosen = MDESettings(population=20, crossover=crossover, threshold=0.3)
        stream = np.random.Generator(np.random.SFC64(2))
        base = np.concatenate([_draw([stream], chosen, 7)[0][..., 2] for _ in range(60)])
        crosses = base > 0
        many = np.broadcast_to(crosses.sum(axis=1)[:, None], crosses.shape)
        for count in range(1, 8):
            here = crosses & (many == count)
            if here.sum() > 200:
                assert binomtest(int((base[here] == 40).sum()), int(here.sum()), 0.3).pvalue > 1e-3


@pytest.mark.parametrize(
    ('changes', 'sentence'),
    [
        ({'population': 4}, 'NP is 4; at least 5'),
        ({'generations': 0}, 'at least 1'),
        ({'threshold': 1.5}, 'from 0 to 1'),
        ({'weight': (1.0, 0.4)}, 'weight F'),
        ({'crossover': (0.7, 1.2)}, '0.7 to 1.2; 0 <= low <= high <= 1 is expected'),
        ({'weight': (0.4, 2.5)}, '0.4 to 2.5; 0 <= low <= high <= 2 is expected'),
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
