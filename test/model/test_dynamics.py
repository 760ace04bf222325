"""The model against its own laws, and against Lagrange's equations derived by sympy."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pendubot_identification.model.dynamics import (
    GRAVITY,
    accelerations,
    coriolis_matrix,
    dry_friction_terms,
    energy,
    forward_dynamics,
    friction,
    gravity,
    inverse_dynamics,
    mass_matrix,
)
from pendubot_identification.model.parameters import MODELS
from test.strategies import angles, physical_parameters, torques, velocities


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


@given(physical_parameters('geared'), angles, velocities, torques)
def test_inverse_after_forward_dynamics_is_the_identity_though_friction_grows_with_the_torque(parameters, q, qd, tau):
    theta = parameters.vector('geared')
    qdd = forward_dynamics(theta, q, qd, tau)
    np.testing.assert_allclose(inverse_dynamics(theta, q, qd, qdd), tau, atol=1e-6 * (1 + abs(tau).max()))


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
def test_power_of_torques_less_friction_is_the_rate_of_energy(parameters, q, qd, tau):
    theta = parameters.vector()
    qdd = forward_dynamics(theta, q, qd, tau)
    h = 1e-5 / (1 + abs(qdd).max())
    rate = (energy(theta, q + h * qd, qd + h * qdd) - energy(theta, q - h * qd, qd - h * qdd)) / (2 * h)
    power = (tau - friction(theta, qd, tau)) @ qd
    rounding = 1e-15 * abs(energy(theta, q, qd) + 2 * GRAVITY * (parameters.P4 + parameters.P5)) / h
    assert rate == pytest.approx(power, rel=1e-4, abs=1e-4 + 10 * rounding)


@given(physical_parameters(), velocities, torques)
def test_friction_is_what_the_design_says(parameters, qd, tau):
    p = parameters
    expected = [
        b * v + (Fc + Fs * math.exp(-((v / 0.5) ** 2)) + k * abs(torque)) * math.tanh(v / 0.05)
        for v, torque, b, Fc, Fs, k in zip(
            qd, tau, (p.b1, p.b2), (p.Fc1, p.Fc2), (p.Fs1, p.Fs2), (p.k1, p.k2), strict=True
        )
    ]
    np.testing.assert_allclose(friction(p.vector(), qd, tau), expected, rtol=1e-12, atol=1e-15)
    coefficients = np.array([[p.Fc1, p.Fs1, p.k1], [p.Fc2, p.Fs2, p.k2]])
    terms = np.array([p.b1, p.b2]) * qd + (coefficients * dry_friction_terms(qd, tau)).sum(axis=-1)
    np.testing.assert_allclose(terms, expected, rtol=1e-12, atol=1e-15)


@given(physical_parameters(), velocities, torques)
def test_friction_is_odd_in_the_velocity_even_in_the_torque_and_takes_power(parameters, qd, tau):
    theta = parameters.vector()
    brake = friction(theta, qd, tau)
    np.testing.assert_array_equal(friction(theta, -qd, tau), -brake)
    np.testing.assert_array_equal(friction(theta, qd, -tau), brake)
    assert (brake * qd >= 0).all()
    np.testing.assert_array_equal(friction(theta, [0.0, 0.0], tau), [0, 0])


@given(physical_parameters('viscous'), angles, velocities, torques, st.sampled_from(list(MODELS)))
def test_a_larger_model_without_what_it_adds_is_the_smaller_one(parameters, q, qd, tau, model):
    small, large = parameters.vector(), parameters.vector(model)
    for function in (forward_dynamics, inverse_dynamics):
        np.testing.assert_array_equal(function(large, q, qd, tau), function(small, q, qd, tau))
    np.testing.assert_array_equal(mass_matrix(large, q), mass_matrix(small, q))
    assert energy(large, q, qd) == energy(small, q, qd)


@given(physical_parameters(), angles, velocities, torques)
def test_floats_and_arrays_give_the_same_accelerations(parameters, q, qd, tau):
    theta = tuple(map(float, parameters.vector()))
    floats = accelerations(theta, *map(float, [*q, *qd, *tau]), lib=math)
    expected = forward_dynamics(theta, q, qd, tau)
    np.testing.assert_allclose(floats, expected, rtol=1e-9, atol=1e-9 * (1 + abs(expected).max()))


@given(
    st.sampled_from(list(MODELS)).flatmap(lambda m: st.tuples(st.just(m), physical_parameters(m))), st.integers(1, 5)
)
def test_many_states_and_rigs_at_once_agree_with_one_at_a_time(rig, count):
    model, parameters = rig
    rng = np.random.default_rng(count)
    q, qd, tau = rng.normal(size=(3, count, 2))
    theta = parameters.vector(model)
    rigs = np.array([theta, 2 * theta])[:, None]
    for function in (forward_dynamics, inverse_dynamics):
        one_by_one = [function(theta, *x) for x in zip(q, qd, tau, strict=True)]
        np.testing.assert_array_equal(function(theta, q, qd, tau), one_by_one)
        together = function(rigs, q, qd, tau)
        np.testing.assert_array_equal(together, [function(each[0], q, qd, tau) for each in rigs])
    assert mass_matrix(rigs, q).shape == (2, count, 2, 2)
    assert energy(rigs, q, qd).shape == (2, count)
    assert friction(rigs, qd, tau).shape == (2, count, 2)


def test_agrees_with_lagranges_equations_at_random_states():
    """From masses, lengths, inertias, a rotor: kinetic less potential energy; sympy does the rest."""
    sympy = pytest.importorskip('sympy')
    mechanics = pytest.importorskip('sympy.physics.mechanics')
    q1, q2 = mechanics.dynamicsymbols('q1 q2')
    m1, m2, l1, d1, d2, i1, i2, rotor = sympy.symbols('m1 m2 l1 d1 d2 I1 I2 J2', positive=True)
    u1, u2 = q1.diff(), q2.diff()
    c1 = d1 * sympy.Matrix([sympy.cos(q1), sympy.sin(q1)])
    elbow = l1 * sympy.Matrix([sympy.cos(q1), sympy.sin(q1)])
    c2 = elbow + d2 * sympy.Matrix([sympy.cos(q1 + q2), sympy.sin(q1 + q2)])
    time = mechanics.dynamicsymbols._t
    speed = [c.diff(time).dot(c.diff(time)) for c in (c1, c2)]
    kinetic = (m1 * speed[0] + m2 * speed[1] + i1 * u1**2 + i2 * (u1 + u2) ** 2 + rotor * u2**2) / 2
    potential = GRAVITY * (m1 * c1[1] + m2 * c2[1])
    method = mechanics.LagrangesMethod(kinetic - potential, [q1, q2])
    method.form_lagranges_equations()
    state = sympy.symbols('a1 a2 w1 w2')
    replaced = {u1: state[2], u2: state[3]}
    M = method.mass_matrix.subs(replaced).subs({q1: state[0], q2: state[1]})
    F = method.forcing.subs(replaced).subs({q1: state[0], q2: state[1]})
    evaluate = sympy.lambdify([m1, m2, l1, d1, d2, i1, i2, rotor, *state], (M, F), 'numpy')

    rng = np.random.default_rng(1)
    for size in 25 * list(MODELS.values()):
        masses = rng.uniform(0.05, 2.0, 8)
        if size < 10:
            masses[7] = 0.0
        x = rng.normal(scale=[2, 2, 8, 8])
        dissipation, tau = rng.uniform(0, 0.1, size - 5), rng.normal(size=2)
        mass, forcing = evaluate(*masses, *x)
        a, b, length, e, f, j1, j2, j3 = masses
        theta = [a * e**2 + b * length**2 + j1, b * f**2 + j2, b * length * f, a * e + b * length, b * f, *dissipation]
        if size >= 10:
            theta[9] = j3
        expected = np.linalg.solve(mass, forcing.ravel() + tau - friction(theta, x[2:], tau))
        np.testing.assert_allclose(forward_dynamics(theta, x[:2], x[2:], tau), expected, rtol=1e-9, atol=1e-9)
