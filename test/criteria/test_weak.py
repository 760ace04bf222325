# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The weak criterion on simulated motions and real rigs, and compared with integrated inverse dynamics."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pendubot_identification.criteria.quadratic import Quadratic
from pendubot_identification.criteria.weak import WIDTH, estimate_delay, residual_weights, weak_regression
from pendubot_identification.errors import TrajectoryError
from pendubot_identification.model.dynamics import forward_dynamics, mass_matrix
from pendubot_identification.model.parameters import default_bounds
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.trajectory import Trajectory
from test.strategies import physical_parameters
from test.virtual import recording


def smooth_motion(amplitude, frequency, phase, t):
    """Return positions, velocities and accelerations in closed form."""
    angle = t[:, None] * frequency + phase
    return amplitude * np.sin(angle), amplitude * frequency * np.cos(angle), -amplitude * frequency**2 * np.sin(angle)


@settings(max_examples=8)
@given(physical_parameters(), st.integers(0, 10**6))
def test_residuals_are_weighted_averages_of_residual_torque_and_power(parameters, seed):
    """Residual torque is M(q) times the error of the acceleration; the test function is (1 - x^2)^3."""
    rng = np.random.default_rng(seed)
    t = np.arange(801) / 1000
    q, qd, qdd = smooth_motion(rng.uniform(0.3, 2, 2), rng.uniform(2, 6, 2), rng.uniform(0, 6, 2), t)
    tau = rng.normal(size=2) + rng.normal(size=2) * np.sin(9 * t[:, None])
    model, theta = parameters.model, parameters.vector()
    regression = weak_regression(Motion.prepare(Trajectory(t, q, tau), 0.0, 'linear'), model)
    errors = forward_dynamics(theta, q, qd, tau) - qdd
    torques = np.array([mass_matrix(theta, angles) @ a for angles, a in zip(q, errors, strict=True)])
    torques = np.column_stack([torques, (torques * qd).sum(axis=1)])
    x = (t - regression.t[::3, None]) / (WIDTH / 2)
    test_functions = np.where(np.abs(x) < 1, (1 - np.minimum(x**2, 1)) ** 3, 0)
    expected = test_functions @ torques / test_functions.sum(axis=1, keepdims=True)
    residual = (regression.y - regression.phi @ theta).reshape(-1, 3)
    scale = np.abs(np.column_stack([tau, (tau * qd).sum(axis=1)])).max() + np.abs(torques).max()
    np.testing.assert_allclose(residual, expected, atol=2e-3 * scale)


@settings(max_examples=8)
@given(st.integers(0, 10**6), st.floats(-0.02, 0.02), st.sampled_from([0.0, 0.3]))
def test_every_pulse_counts_once_despite_jitter_and_delay(seed, delay, jitter):
    """The test functions add up to a constant; the residuals add up to the impulse and the work of the pulses."""
    rng = np.random.default_rng(seed)
    t = np.arange(150) * 0.01 + rng.uniform(-jitter, jitter, 150) * 0.01
    tau = np.zeros((150, 2))
    k = rng.integers(60, 90, 4)
    tau[k] = rng.normal(size=(4, 2))
    rows = weak_regression(
        Motion.prepare(Trajectory(t, np.column_stack([2 * t, -3 * t]), tau), 0.02), 'viscous', delay, stride=0.01
    )
    total = rows.y.reshape(-1, 3).sum(axis=0) * 0.01
    impulse = (tau[:-1] * np.diff(t)[:, None]).sum(axis=0)
    np.testing.assert_allclose(total, [*impulse, impulse @ [2, -3]], atol=2e-4)


def test_weighted_residuals_have_equal_RMS():
    motion, bounds = Motion.prepare(recording(), 0.02), default_bounds().of(7)
    weights = residual_weights([weak_regression(motion, 'viscous')], bounds)
    parts = weak_regression(motion, 'viscous', weights=weights)
    theta = Quadratic.reduce(parts.phi, parts.y).minimum(bounds)
    sizes = np.sqrt(((parts.y - parts.phi @ theta).reshape(-1, 3) ** 2).mean(axis=0))
    assert weights[0] == 1
    np.testing.assert_allclose(sizes, sizes[0], rtol=0.05)


def test_a_delay_that_the_effort_does_not_determine_is_zero():
    motion = recording()
    steady = Motion.prepare(replace(motion, tau=np.full_like(motion.tau, 0.5)), 0.02)
    assert estimate_delay([steady], 'viscous', default_bounds(), -0.013, 0.02) == 0


def test_a_motion_that_is_too_short_or_in_degrees_is_refused():
    short = recording()[:60]
    with pytest.raises(TrajectoryError, match=r'0\.190 s with known torque are shorter than the test function'):
        weak_regression(Motion.prepare(short, 0.02), 'viscous', delay=-0.4)
    with pytest.raises(TrajectoryError, match=r': 0\.000 s with known torque'):
        weak_regression(Motion.prepare(short, 0.02), 'viscous', delay=-0.7)
    degrees = Trajectory(short.t, np.rad2deg(np.column_stack([9 * short.t, short.t])), short.tau)
    with pytest.raises(TrajectoryError, match=r'the shoulder turns at .* in radians'):
        weak_regression(Motion.prepare(degrees, 0.02), 'viscous')
