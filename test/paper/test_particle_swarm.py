"""PSO against SwarmOps' formula written as plain loops, and against SwarmOps itself."""

import numpy as np
import pytest
from scipy.stats import mannwhitneyu

from pendubot_identification.errors import ParameterError
from pendubot_identification.optimizers.optimizer import minimize
from pendubot_identification.paper.benchmark_functions import FUNCTIONS
from pendubot_identification.paper.particle_swarm import PSO, PSOSettings
from test.paper.swarmops_peer import peer


def plain_pso(function, dimension, seed, run, s, w, c1, c2, generations):
    stream = np.random.Generator(np.random.SFC64([seed, run]))
    half = function.half_width
    x = [[-half + u * 2 * half for u in row] for row in stream.random((s, dimension)).tolist()]
    v = [[-2 * half + u * 4 * half for u in row] for row in stream.random((s, dimension)).tolist()]
    best, values = [list(p) for p in x], [float(function.value(np.array(p))) for p in x]
    for _ in range(generations):
        leader = list(best[int(np.argmin(values))])
        r1, r2 = stream.random((2, s)).tolist()
        for i in range(s):
            for j in range(dimension):
                moved = w * v[i][j] + c1 * r1[i] * (best[i][j] - x[i][j]) + c2 * r2[i] * (leader[j] - x[i][j])
                v[i][j] = max(-2 * half, min(2 * half, moved))
                x[i][j] = max(-half, min(half, x[i][j] + v[i][j]))
        for i in range(s):
            value = float(function.value(np.array(x[i])))
            if value < values[i]:
                best[i], values[i] = list(x[i]), value
    return min(values)


@pytest.mark.parametrize('function', FUNCTIONS, ids=lambda f: f.name)
def test_it_is_the_formula(function):
    settings = PSOSettings(12, evaluations=12 * 25)
    result = minimize(PSO(function.bounds(3), settings, runs=2, seed=4), function.value)
    assert result.generations.tolist() == [24, 24]
    for run in range(2):
        value = plain_pso(function, 3, 4, run, 12, -0.3236, -0.1136, 3.9789, 24)
        assert result.value[run] == pytest.approx(value, rel=1e-9)


@pytest.mark.parametrize('function', FUNCTIONS, ids=lambda f: f.name)
def test_it_agrees_with_swarmops(function):
    """Table 3's settings, n = 2, 100 runs of 4000 function values: the errors come from one distribution."""
    ours = minimize(PSO(function.bounds(2), runs=100, seed=1), function.value)
    assert ours.evaluations.tolist() == [27 * 149] * 100, 'the generation in which 4000 are reached is finished'
    parameters = [149, -0.3236, -0.1136, 3.9789]
    theirs = peer('PSO', function, 2, parameters, evaluations=4000, runs=100, seed=1)
    assert mannwhitneyu(ours.value, theirs).pvalue > 0.01


def test_a_runs_result_does_not_depend_on_its_neighbours_and_each_stops_by_itself():
    sphere = FUNCTIONS[0]
    settings = PSOSettings(30, evaluations=9000, target=1e-2)
    many = minimize(PSO(sphere.bounds(2), settings, runs=7, seed=5), sphere.value)
    few = minimize(PSO(sphere.bounds(2), settings, runs=3, seed=5), sphere.value)
    np.testing.assert_array_equal(many.x[:3], few.x)
    np.testing.assert_array_equal(many.generations[:3], few.generations)
    assert set(many.stopped_by) == {'target'}
    assert len(set(many.generations)) > 1
    assert (many.evaluations == 30 * (many.generations + 1)).all()
    np.testing.assert_array_equal(many.history[-1], many.value)
    assert (np.diff(many.history, axis=0) <= 0).all()
    np.testing.assert_allclose(sphere.value(many.x), many.value)


def test_it_never_leaves_the_box():
    asked = []

    def watched(x):
        asked.append(np.abs(x).max())
        return -np.abs(x).sum(axis=-1)

    minimize(PSO(FUNCTIONS[3].bounds(2), PSOSettings(20, evaluations=2000), runs=3), watched)
    assert max(asked) <= 5.12


@pytest.mark.parametrize(
    ('changes', 'sentence'),
    [({'particles': 0}, '0 particles'), ({'evaluations': 10}, '10 function values'), ({'inertia': np.nan}, 'finite')],
)
def test_settings_without_sense_are_refused(changes, sentence):
    with pytest.raises(ParameterError, match=sentence):
        PSOSettings(**changes)
