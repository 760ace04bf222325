"""The compiled kernel and numpy, held together: one path must never tell what the other does not."""

import contextlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pendubot_identification.criteria.quadratic import Penalised, Quadratic
from pendubot_identification.model import kernel
from pendubot_identification.model.parameters import MODELS, Bounds, default_bounds
from pendubot_identification.model.rollout import roll, sensitivities
from pendubot_identification.optimizers.mde import MDE, MDESettings
from pendubot_identification.optimizers.optimizer import minimize
from pendubot_identification.paper.benchmark_functions import FUNCTIONS
from pendubot_identification.paper.differential_evolution import HDE, classic
from test.virtual import GEARED

# Here and nowhere else: whoever switches the kernel off wants to see that all the rest works without it.
pytestmark = pytest.mark.skipif(kernel.library() is None, reason=kernel.description())


@contextlib.contextmanager
def without_kernel():
    before, kernel.wanted = kernel.wanted, False
    try:
        yield
    finally:
        kernel.wanted = before


def both(work):
    """Return what the kernel makes of it, and what numpy does."""
    compiled = work()
    with without_kernel():
        return compiled, work()


def criterion(dimension, seed, indefinite=False):
    """A least-squares problem whose minimum may lie where the mass matrix is indefinite."""
    rng = np.random.default_rng(seed)
    theta = rng.uniform(0.1, 0.9, dimension)
    if indefinite:
        theta[2] = 2 * np.sqrt(theta[0] * theta[1])
    phi = rng.normal(size=(100, dimension))
    return Quadratic.reduce(phi, phi @ theta + 0.1 * rng.normal(size=100))


def box(dimension):
    return Bounds(np.zeros(dimension), np.full(dimension, 3.0), tuple(f'x{k}' for k in range(dimension)))


def assert_same_result(compiled, numpys):
    for name in ('x', 'value', 'generations', 'evaluations', 'history', 'cost'):
        np.testing.assert_array_equal(getattr(compiled, name), getattr(numpys, name), err_msg=name)
    assert compiled.stopped_by == numpys.stopped_by


@settings(max_examples=40)
@given(
    dimension=st.integers(3, 20),
    population=st.integers(5, 40),
    runs=st.integers(1, 9),
    generations=st.integers(1, 150),
    per_component=st.booleans(),
    threshold=st.sampled_from([0.0, 0.3, 0.7, 1.0]),
    weight=st.sampled_from([(0.4, 1.0), (0.0, 2.0), (0.5, 0.5)]),
    crossover=st.sampled_from([(0.7, 1.0), (0.0, 1.0), (0.0, 0.0)]),
    stop=st.sampled_from([{}, {'spread': 0.5}, {'target': 0.5}, {'spread': 0.5, 'target': 0.2}]),
    penalty=st.booleans(),
    seed=st.integers(0, 1000),
)
def test_generations_are_the_same_bit_for_bit(
    dimension, population, runs, generations, per_component, threshold, weight, crossover, stop, penalty, seed
):
    chosen = MDESettings(population, generations, threshold, weight, crossover, per_component, **stop)
    J = criterion(dimension, seed, indefinite=penalty)
    objective = Penalised.of(J) if penalty else J
    assert_same_result(*both(lambda: minimize(MDE(box(dimension), chosen, runs=runs, seed=seed), objective)))


@pytest.mark.parametrize('per_component', [True, False])
def test_a_whole_identification_search_is_the_same_bit_for_bit(per_component):
    J = criterion(7, 5)
    chosen = MDESettings(generations=2500, per_component=per_component, spread=1e-9)
    assert_same_result(*both(lambda: minimize(MDE(default_bounds().of(7), chosen, seed=3), Penalised.of(J))))


@pytest.mark.parametrize('per_component', [True, False])
@pytest.mark.parametrize('runs', [1, 5, 10, 23])
def test_what_comes_out_does_not_depend_on_the_threads(monkeypatch, runs, per_component):
    objective, found = Penalised.of(criterion(7, 2, indefinite=True)), []
    chosen = MDESettings(generations=900, spread=1e-3, per_component=per_component)
    for threads in (1, 2, 3, 64):
        monkeypatch.setattr(kernel, 'threads', threads)
        found.append(minimize(MDE(box(7), chosen, runs=runs, seed=4), objective))
    for other in found[1:]:
        assert_same_result(found[0], other)


@pytest.mark.parametrize('lanes', [1, 90, 203])
def test_motions_do_not_depend_on_the_threads(monkeypatch, lanes):
    x, tau = random_motion(lanes, 900, 3)
    found = []
    for threads in (1, 2, 5):
        monkeypatch.setattr(kernel, 'threads', threads)
        states = roll(GEARED, x, tau, 1e-3)
        found.append((states, sensitivities(GEARED, states, tau, 1e-3)))
    for other in found[1:]:
        for a, b in zip(found[0], other, strict=True):
            np.testing.assert_array_equal(a, b)


def test_numpy_goes_on_where_the_kernel_has_stopped():
    """After a leap the optimiser is where it would be: whoever asks then is told the same."""
    objective, states = criterion(7, 1), []
    for leaps in (True, False):
        optimizer = MDE(box(7), MDESettings(generations=10**6), runs=3)
        optimizer.tell(objective(optimizer.ask()))
        if leaps:
            assert optimizer.leap(objective)
            reached = optimizer.generation
            assert reached > 1
        while optimizer.generation < reached + 20:
            optimizer.tell(objective(optimizer.ask()))
        states.append(optimizer.ask())
    np.testing.assert_array_equal(*states)


def test_progress_is_told_of_leaps():
    told = []
    result = minimize(MDE(box(7), MDESettings(generations=300)), criterion(7, 1), lambda *what: told.append(what))
    assert told[-1] == (300, result.value.min())


def found_by(function, dimension, generations, runs, **stop):
    chosen = MDESettings(50, generations, **stop)
    return minimize(MDE(function.bounds(dimension), chosen, runs=runs), function)


@pytest.mark.parametrize('function', FUNCTIONS, ids=lambda f: f.name)
@pytest.mark.parametrize('dimension', [2, 10])
def test_the_benchmark_functions_agree_to_a_rounding(function, dimension):
    compiled, numpys = both(lambda: found_by(function, dimension, 20, 6))
    np.testing.assert_allclose(compiled.history, numpys.history, rtol=1e-9)
    np.testing.assert_allclose(function(compiled.x), compiled.value, rtol=1e-9)


@pytest.mark.parametrize('function', FUNCTIONS, ids=lambda f: f.name)
def test_both_paths_find_the_minima_of_the_paper(function):
    """From the last bit of a sine on runs go their own ways; what they find, and how soon, is the same."""
    compiled, numpys = both(lambda: found_by(function, 2, 4000, 20, target=1e-5))
    for result in (compiled, numpys):
        # On Griewank a run now and then ends in another valley.
        assert result.stopped_by.count('target') >= 17
        np.testing.assert_allclose(function(result.x), result.value, rtol=1e-6, atol=1e-14)
    assert 0.5 < np.median(compiled.generations) / np.median(numpys.generations) < 2


def test_an_optimiser_that_needs_more_than_the_kernel_knows_does_without_it():
    sphere = FUNCTIONS[0]

    def hde():
        return minimize(HDE(sphere.bounds(3), sphere.gradient, classic(generations=100), runs=2), sphere)

    assert_same_result(*both(hde))


def random_motion(lanes, steps, seed):
    rng = np.random.default_rng(seed)
    return rng.normal(scale=[[2], [2], [4], [4]], size=(4, lanes)), rng.normal(size=(2, steps, lanes))


@settings(max_examples=40)
@given(
    st.sampled_from(sorted(MODELS)), st.integers(1, 150), st.integers(0, 30), st.integers(0, 5), st.integers(0, 1000)
)
def test_motions_and_sensitivities_agree(model, lanes, steps, vectors, seed):
    x, tau = random_motion(lanes, steps, seed)
    theta = GEARED[: MODELS[model]]
    if vectors:
        theta = (theta[:, None] * np.random.default_rng(seed).uniform(0.7, 1.3, (len(theta), vectors)))[:, :, None]
    compiled, numpys = both(lambda: roll(theta, x, tau, 1e-3))
    assert compiled.shape == numpys.shape
    np.testing.assert_allclose(compiled, numpys, rtol=1e-10, atol=1e-10)
    if not vectors:
        compiled, numpys = both(lambda: sensitivities(theta, numpys, tau, 1e-3))
        assert compiled.shape == numpys.shape
        np.testing.assert_allclose(compiled, numpys, rtol=1e-9, atol=1e-9 * np.abs(numpys).max(initial=0.0))


@pytest.mark.parametrize('speed', [0.0, 1e-12, 1e-4, 0.05, 3.0, 1e3, 1e5])
@pytest.mark.parametrize('angle', [0.0, -np.pi / 2, np.pi, 1e-9, 1e3, -3e5])
def test_elementary_functions_hold_from_rest_to_absurd_speeds(speed, angle):
    """Sine, cosine, hyperbolic tangent and exponential have no way out but through the accelerations."""
    x = np.array([[angle], [angle / 3], [speed], [-speed / 2]])
    tau = np.array([[[0.3]], [[-0.1]]])
    compiled, numpys = both(lambda: roll(GEARED, x, tau, 1e-6))
    np.testing.assert_allclose(compiled, numpys, rtol=1e-12, atol=1e-15)


def test_arrays_of_any_layout_are_understood():
    x, tau = random_motion(40, 10, 1)
    compiled, numpys = both(lambda: roll(GEARED[:7].copy(), x[:, ::-2], np.asfortranarray(tau)[:, :, ::-2], 1e-3))
    np.testing.assert_allclose(compiled, numpys, rtol=1e-10, atol=1e-10)
