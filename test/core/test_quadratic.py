import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from pendubot_identification.core.parameters import Bounds
from pendubot_identification.core.quadratic import Quadratic

NAMES = ('a', 'b', 'c')


def problem(seed, n=60):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(n, 3)) * [1, 10, 0.1], rng.normal(size=n)


@given(st.integers(0, 10**6), st.integers(1, 5))
def test_the_triangle_gives_the_same_value_as_all_the_residuals(seed, n):
    phi, y = problem(seed, n * 20)
    theta = np.random.default_rng(seed).normal(size=(4, 5, 3))
    expected = ((theta @ phi.T - y) ** 2).mean(axis=-1)
    np.testing.assert_allclose(Quadratic.reduce(phi, y)(theta), expected, rtol=1e-9)


@given(st.integers(0, 10**6), st.lists(st.integers(1, 59), max_size=4))
def test_pooling_parts_is_reducing_the_whole(seed, cuts):
    phi, y = problem(seed)
    rows = np.split(np.arange(60), sorted(set(cuts)))
    pooled = Quadratic.pool([Quadratic.reduce(phi[r], y[r]) for r in rows])
    theta = np.random.default_rng(seed).normal(size=3)
    assert pooled.count == 60
    assert pooled(theta) == pytest.approx(float(Quadratic.reduce(phi, y)(theta)), rel=1e-9)


@settings(max_examples=30)
@given(st.integers(0, 10**6))
def test_the_bounded_minimum_is_what_a_general_optimiser_finds(seed):
    phi, y = problem(seed)
    J = Quadratic.reduce(phi, y)
    bounds = Bounds(np.array([0.0, -0.01, 0.0]), np.array([0.1, 0.02, 5.0]), NAMES)
    found = J.minimum(bounds)
    assert (found >= bounds.lower).all()
    assert (found <= bounds.upper).all()
    other = minimize(lambda x: float(J(x)), found + 1e-3, bounds=list(zip(bounds.lower, bounds.upper, strict=True)))
    assert J(found) <= other.fun * (1 + 1e-9)


def test_what_cannot_be_told_is_told():
    phi, y = problem(1)
    phi[:, 2] = 3 * phi[:, 1]
    assert Quadratic.reduce(phi, y).undetermined(1e-6).tolist() == [False, True, True]
    phi[:, 2] = 0
    J = Quadratic.reduce(phi, y)
    assert J.undetermined(1e-6).tolist() == [False, False, True]
    assert J.condition_number() > 1e12


def test_condition_number_does_not_depend_on_units():
    phi, y = problem(2)
    scaled = Quadratic.reduce(phi * [1, 1000, 1e-6], y)
    assert scaled.condition_number() == pytest.approx(Quadratic.reduce(phi, y).condition_number(), rel=1e-6)
