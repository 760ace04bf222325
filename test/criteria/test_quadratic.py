# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from pendubot_identification.criteria.quadratic import Quadratic
from pendubot_identification.errors import ParameterError
from pendubot_identification.model.parameters import LARGEST_COUPLING, Bounds, repaired

NAMES = ('a', 'b', 'c')
PHYSICAL = ('P1', 'P2', 'P3', 'P4', 'P5')


def problem(seed, n=60):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(n, 3)) * [1, 10, 0.1], rng.normal(size=n)


@given(st.integers(0, 10**6), st.lists(st.integers(1, 59), max_size=4))
def test_reduced_pooled_projected_and_scaled_criteria_have_the_same_values(seed, cuts):
    phi, y = problem(seed)
    rows = np.split(np.arange(60), sorted(set(cuts)))
    J = Quadratic.pool([Quadratic.reduce(phi[r], y[r]) for r in rows])
    rng = np.random.default_rng(seed)
    directions, x = rng.normal(size=(3, 2)), rng.normal(size=(4, 5, 2))
    theta = x @ directions.T
    expected = ((theta @ phi.T - y) ** 2).mean(axis=-1)
    np.testing.assert_allclose(J(theta), expected, rtol=1e-9)
    np.testing.assert_allclose(J.along(directions)(x), expected, rtol=1e-9)
    np.testing.assert_allclose(J.scaled(3.0)(theta), 9 * expected, rtol=1e-9)


def coupled(seed, noise=1.0, size=5):
    """Return an ill-scaled problem and bounds; its minimum within them often has an indefinite mass matrix."""
    rng = np.random.default_rng(seed)
    phi = rng.normal(size=(40, size)) @ (np.eye(size) + 0.5 * rng.normal(size=(size, size)))
    phi *= 10 ** rng.uniform(-2, 2, size)
    truth = (0.2 + np.abs(rng.normal(size=size))) / np.linalg.norm(phi, axis=0)
    truth[2] = rng.choice([-1, 1]) * np.sqrt(truth[0] * truth[1]) * rng.uniform(0.8, 3)
    upper = truth * rng.uniform(0.5, 5, size)
    upper[2] = abs(truth[2])
    lower = np.where(np.arange(size) < 2, 0, -2 * np.abs(upper))
    J = Quadratic.reduce(phi, phi @ truth + noise * rng.normal(size=40) / 40)
    return J, Bounds(lower, upper, PHYSICAL[:size])


@settings(max_examples=12)
@given(st.integers(0, 10**6))
def test_the_minimum_with_a_definite_mass_matrix_is_no_worse_than_that_of_slsqp(seed):
    J, bounds = coupled(seed)
    found = J.minimum(bounds)
    assert ((bounds.lower <= found) & (found <= bounds.upper)).all()
    assert abs(found[2]) <= LARGEST_COUPLING * np.sqrt(found[0] * found[1]) * (1 + 1e-9)
    scale = bounds.upper - bounds.lower

    def slack(x):
        return LARGEST_COUPLING * np.sqrt(max(x[0] * scale[0] * x[1] * scale[1], 0)) / scale[2] - abs(x[2])

    for start in (found, repaired((bounds.lower + 2 * bounds.upper) / 3)):
        other = minimize(
            lambda x: float(J(x * scale)),
            start / scale,
            method='SLSQP',
            bounds=list(zip(bounds.lower / scale, bounds.upper / scale, strict=True)),
            constraints={'type': 'ineq', 'fun': slack},
            options={'ftol': 1e-14, 'maxiter': 500},
        )
        if slack(other.x) >= -1e-12:
            assert float(J(found)) <= float(J(np.clip(other.x * scale, bounds.lower, bounds.upper))) * (1 + 1e-8)


def test_bounds_that_exclude_every_definite_mass_matrix_are_refused():
    J, _ = coupled(1, size=3)
    bounds = Bounds(np.array([0.0, 0.0, 0.5]), np.array([0.1, 0.1, 1.0]), PHYSICAL[:3])
    with pytest.raises(ParameterError, match=r'at most P1 = 0\.1 and P2 = 0\.1, and at least \|P3\|'):
        J.minimum(bounds)
