"""MDE in the compiled kernel and in numpy gives the same; of simulations test_rollout and test_dynamics show it."""

import contextlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pendubot_identification.criteria.quadratic import Penalised, Quadratic
from pendubot_identification.model import kernel
from pendubot_identification.model.parameters import Bounds, default_bounds
from pendubot_identification.optimizers.mde import MDE, MDESettings
from pendubot_identification.optimizers.optimizer import minimize
from pendubot_identification.paper.benchmark_functions import FUNCTIONS
from pendubot_identification.paper.differential_evolution import HDE, classic

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
