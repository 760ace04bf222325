# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The equations of motion in Python and C, compared with Lagrange's equations derived by sympy."""

import math
from functools import cache
from unittest import mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pendubot_identification import kernel
from pendubot_identification.model import dynamics
from pendubot_identification.model.rollout import roll, sensitivities
from test.simulated_rig import runge_kutta
from test.strategies import angles, rigs, theta, torques, velocities

both_paths = pytest.mark.parametrize('compiled', [True, False], ids=['kernel', 'numpy'])


def path(compiled):
    """Simulate by the kernel or by numpy; skip the test if the kernel is missing."""
    if compiled and kernel.library() is None:
        pytest.skip(kernel.description())
    return mock.patch.object(kernel, 'wanted', compiled)


def both(function, *arguments):
    """Return the results of a function by the kernel and by numpy."""
    found = []
    for compiled in (True, False):
        with path(compiled):
            found.append(function(*arguments))
    return found


#: Number of arguments of a rig: m1 m2 l1 d1 d2 I1 I2, then friction and rotor as in theta.
SIZE = 16


@cache
def derived():
    """Return a function of rig, state, torques and accelerations a.

    It gives M, the torques M a in excess, their derivatives by state and rig, energy, theta, and its derivatives by
    the rig.
    """
    sympy = pytest.importorskip('sympy')
    rig = sympy.symbols('m1 m2 l1 d1 d2 I1 I2 b1 b2 Fc1 Fc2 J2 Fs1 Fs2 k1 k2')
    m1, m2, l1, d1, d2, I1, I2, b1, b2, Fc1, Fc2, J2, Fs1, Fs2, k1, k2 = rig
    state, tau, a = sympy.symbols('q1 q2 v1 v2'), sympy.symbols('t1 t2'), sympy.symbols('a1 a2')
    q, v = sympy.Matrix(state[:2]), sympy.Matrix(state[2:])
    one, both = q[0], q[0] + q[1]
    place1 = d1 * sympy.Matrix([sympy.cos(one), sympy.sin(one)])
    place2 = sympy.Matrix([l1 * sympy.cos(one) + d2 * sympy.cos(both), l1 * sympy.sin(one) + d2 * sympy.sin(both)])
    speed1, speed2 = place1.jacobian(q) * v, place2.jacobian(q) * v
    kinetic = (m1 * speed1.dot(speed1) + m2 * speed2.dot(speed2) + I1 * v[0] ** 2 + I2 * (v[0] + v[1]) ** 2) / 2
    kinetic += J2 * v[1] ** 2 / 2
    potential = 9.81 * (m1 * place1[1] + m2 * place2[1])
    forces = sympy.Matrix(
        [
            t - b * w - (Fc + Fs * sympy.exp(-((w / 0.5) ** 2)) + k * sympy.Abs(t)) * sympy.tanh(w / 0.05)
            for t, w, b, Fc, Fs, k in zip(tau, v, (b1, b2), (Fc1, Fc2), (Fs1, Fs2), (k1, k2), strict=True)
        ]
    )
    # Lagrange: d/dt dL/dv - dL/dq = forces.
    lagrangian = sympy.Matrix([kinetic - potential])
    momentum = lagrangian.jacobian(v).T
    M = momentum.jacobian(v)
    excess = M * sympy.Matrix(a) + momentum.jacobian(q) * v - lagrangian.jacobian(q).T - forces
    slopes, P = excess.jacobian(sympy.Matrix([*state, *rig])), sympy.Matrix(theta(*rig))
    outputs = M, excess, slopes, kinetic + potential, P, P.jacobian(sympy.Matrix(rig))
    return sympy.lambdify([rig, state, tau, a], outputs, 'numpy', cse=True)


def lagrange(rig, x, tau):
    """Return accelerations, their derivatives by state and rig, M, energy, theta, and its derivatives by the rig.

    The rig has any model. The derivatives are of the implicit function.
    """
    full, size = [*rig, *[0.0] * (SIZE - len(rig))], len(rig) - 2
    M, excess, *_ = derived()(full, x, tau, (0.0, 0.0))
    qdd = -np.linalg.solve(M, excess).ravel()
    _, _, slopes, E, P, P_by = derived()(full, x, tau, qdd)
    by = -np.linalg.solve(M, slopes[:, : 4 + len(rig)])
    return qdd, by, M, E, P.ravel()[:size], P_by[:size, : len(rig)]


def by_rig(derivatives, P_by):
    """Return derivatives by state and rig from derivatives by state and theta, shape (..., 4 + D)."""
    return np.concatenate([derivatives[..., :4], derivatives[..., 4:] @ P_by], axis=-1)


def assert_near(found, expected, tolerance):
    np.testing.assert_allclose(found, expected, rtol=tolerance, atol=tolerance * np.abs(expected).max())


@given(rigs(), angles, velocities, torques)
def test_dynamics_agree_with_lagranges_equations(rig, q, v, tau):
    qdd, by, M, E, P, _ = lagrange(rig, [*q, *v], tau)
    assert_near(dynamics.mass_matrix(P, q), M, 1e-12)
    assert float(dynamics.energy(P, q, v)) == pytest.approx(E, rel=1e-9, abs=1e-9)
    assert_near(dynamics.forward_dynamics(P, q, v, tau), qdd, 1e-9)
    assert_near(dynamics.accelerations(P.tolist(), [*q.tolist(), *v.tolist()], tau.tolist(), math), qdd, 1e-9)
    point = dynamics.linearised(dynamics.padded(P), np.append(q, v), tau)
    assert_near(point.a, qdd, 1e-9)
    assert_near(point.by_state, by[:, :4], 1e-8)


def step(rig, x, X, tau, h):
    """Return the state, and its derivatives by initial state and rig, after a Runge-Kutta step of order 4."""

    def slope(y):
        x, X = y[:, 0], y[:, 1:]
        qdd, by, *_ = lagrange(rig, x, tau)
        accelerated = by[:, :4] @ X
        accelerated[:, 4:] += by[:, 4:]
        return np.column_stack([[*x[2:], *qdd], np.vstack([X[2:], accelerated])])

    y = runge_kutta(slope, np.column_stack([x, X]), h)
    return y[:, 0], y[:, 1:]


@both_paths
@settings(max_examples=40)
@given(rigs(), st.sampled_from([1, 3, 42, 300]), st.integers(0, 10**6))
def test_rollouts_and_sensitivities_are_runge_kutta_steps_of_lagranges_equations(compiled, rig, lanes, seed):
    """The numbers of lanes are one, few, no multiple of the kernel's block size, and many blocks."""
    rng = np.random.default_rng(seed)
    steps, h = 3, 1e-4
    start, tau = rng.normal(scale=[[2], [2], [8], [8]], size=(4, lanes)), rng.normal(size=(2, steps, lanes))
    *_, P, P_by = lagrange(rig, start[:, 0], tau[:, 0, 0])
    with path(compiled):
        states = roll(P, start, tau, h)
        derivatives = sensitivities(P, states, tau, h)
        np.testing.assert_array_equal(sensitivities(P, states, tau, h, every=2), derivatives[::2])
    for lane in {0, lanes // 2, lanes - 1}:
        x, X = start[:, lane], np.eye(4, 4 + len(rig))
        for k in range(steps):
            assert_near(by_rig(derivatives[k, :, :, lane], P_by), X, 1e-8)
            x, X = step(rig, x, X, tau[:, k, lane], h)
            assert_near(states[k + 1, :, lane], x, 1e-9)
        assert_near(by_rig(derivatives[steps, :, :, lane], P_by), X, 1e-8)
