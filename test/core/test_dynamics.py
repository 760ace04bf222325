"""The model against its own laws, and against Lagrange's equations derived by sympy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pendubot_identification.core.dynamics import (
    GRAVITY,
    coriolis_matrix,
    energy,
    forward_dynamics,
    gravity,
    inverse_dynamics,
    mass_matrix,
)
from test.core.strategies import angles, physical_parameters, torques, velocities


@given(physical_parameters(), angles)
def test_mass_matrix_is_symmetric_and_positive_definite(parameters, q):
    M = mass_matrix(parameters.vector(), q)
    assert M[0, 1] == M[1, 0]
    assert np.linalg.eigvalsh(M).min() > 0


@given(physical_parameters(), angles, velocities, torques)
def test_forward_after_inverse_dynamics_is_the_identity(parameters, q, qd, qdd):
    theta = parameters.vector()
    tau = inverse_dynamics(theta, q, qd, qdd)
    np.testing.assert_allclose(forward_dynamics(theta, q, qd, tau), qdd, rtol=1e-6, atol=1e-6 * (1 + abs(qdd).max()))


@given(physical_parameters(), angles, velocities)
def test_mass_derivative_less_twice_coriolis_is_skew_symmetric(parameters, q, qd):
    theta, h = parameters.vector(), 1e-6
    derivative = (mass_matrix(theta, q + h * qd) - mass_matrix(theta, q - h * qd)) / (2 * h)
    S = derivative - 2 * coriolis_matrix(theta, q, qd)
    np.testing.assert_allclose(S + S.T, 0, atol=1e-6 * (1 + abs(S).max()))


@given(physical_parameters(), angles)
def test_gravity_is_the_slope_of_the_potential(parameters, q):
    theta, h = parameters.vector(), 1e-6
    slope = [(energy(theta, q + h * e, [0, 0]) - energy(theta, q - h * e, [0, 0])) / (2 * h) for e in np.eye(2)]
    np.testing.assert_allclose(gravity(theta, q), slope, atol=1e-6)


@given(physical_parameters(), angles, velocities, torques)
def test_power_of_torques_and_friction_is_the_rate_of_energy(parameters, q, qd, tau):
    theta, h = parameters.vector(), 1e-6
    qdd = forward_dynamics(theta, q, qd, tau)
    rate = (energy(theta, q + h * qd, qd + h * qdd) - energy(theta, q - h * qd, qd - h * qdd)) / (2 * h)
    power = (tau - theta[5:] * qd) @ qd
    scale = abs(tau @ qd) + abs(gravity(theta, q) @ qd) + abs(energy(theta, q, qd)) + 1
    assert rate == pytest.approx(power, abs=1e-4 * scale)


@given(physical_parameters(), st.integers(1, 5))
def test_many_states_at_once_agree_with_one_at_a_time(parameters, count):
    rng = np.random.default_rng(count)
    q, qd, tau = rng.normal(size=(3, count, 2))
    theta = parameters.vector()
    together = forward_dynamics(theta, q, qd, tau)
    np.testing.assert_array_equal(together, [forward_dynamics(theta, *x) for x in zip(q, qd, tau, strict=True)])


def test_agrees_with_lagranges_equations_at_random_states():
    """From masses, lengths, inertias: kinetic less potential energy; sympy does the rest."""
    sympy = pytest.importorskip('sympy')
    mechanics = pytest.importorskip('sympy.physics.mechanics')
    q1, q2 = mechanics.dynamicsymbols('q1 q2')
    m1, m2, l1, d1, d2, i1, i2 = sympy.symbols('m1 m2 l1 d1 d2 I1 I2', positive=True)
    u1, u2 = q1.diff(), q2.diff()
    c1 = d1 * sympy.Matrix([sympy.cos(q1), sympy.sin(q1)])
    elbow = l1 * sympy.Matrix([sympy.cos(q1), sympy.sin(q1)])
    c2 = elbow + d2 * sympy.Matrix([sympy.cos(q1 + q2), sympy.sin(q1 + q2)])
    time = mechanics.dynamicsymbols._t
    speed = [c.diff(time).dot(c.diff(time)) for c in (c1, c2)]
    kinetic = (m1 * speed[0] + m2 * speed[1] + i1 * u1**2 + i2 * (u1 + u2) ** 2) / 2
    potential = GRAVITY * (m1 * c1[1] + m2 * c2[1])
    method = mechanics.LagrangesMethod(kinetic - potential, [q1, q2])
    method.form_lagranges_equations()
    state = sympy.symbols('a1 a2 w1 w2')
    replaced = {u1: state[2], u2: state[3]}
    M = method.mass_matrix.subs(replaced).subs({q1: state[0], q2: state[1]})
    F = method.forcing.subs(replaced).subs({q1: state[0], q2: state[1]})
    evaluate = sympy.lambdify([m1, m2, l1, d1, d2, i1, i2, *state], (M, F), 'numpy')

    rng = np.random.default_rng(1)
    for _ in range(100):
        masses = rng.uniform(0.05, 2.0, 7)
        x = rng.normal(scale=[2, 2, 8, 8])
        damping, tau = rng.uniform(0, 0.1, 2), rng.normal(size=2)
        mass, forcing = evaluate(*masses, *x)
        expected = np.linalg.solve(mass, forcing.ravel() + tau - damping * x[2:])
        a, b, length, e, f, j1, j2 = masses
        theta = [a * e**2 + b * length**2 + j1, b * f**2 + j2, b * length * f, a * e + b * length, b * f, *damping]
        np.testing.assert_allclose(forward_dynamics(theta, x[:2], x[2:], tau), expected, rtol=1e-9, atol=1e-9)
