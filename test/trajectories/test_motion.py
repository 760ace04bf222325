# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Prepared recordings, compared with their simulation; mean torques, compared with their integral."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pendubot_identification.model.dynamics import forward_dynamics
from pendubot_identification.model.parameters import PAPER, Parameters
from pendubot_identification.model.simulation import simulate
from pendubot_identification.trajectories.conversion import Affine
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.trajectory import Trajectory
from test import virtual

GEARED = Parameters.from_vector(virtual.GEARED)


def recording(t, tau, parameters=GEARED):
    return simulate(parameters, t, tau, q=(-0.5, 0.5))


def drive(t):
    """Return continuous torques, for continuous accelerations."""
    return np.column_stack([2 * np.sin(7 * t), 0.3 * np.cos(5 * t)])


@pytest.mark.parametrize(('rig', 'rate'), [(PAPER, 500), (GEARED, 1000)], ids=['paper', 'geared'])
def test_smoothed_states_and_rates_are_near_the_truth(rig, rate):
    t = np.arange(rate) / rate
    motion = recording(t, drive(t) * (1.0 if rig is GEARED else 0.05), rig)
    prepared = Motion.prepare(motion, smoothing=0.012)
    assert (prepared.start, prepared.end, prepared.interval) == pytest.approx((0, t[-1], 1 / rate))
    inside = slice(rate // 50, -rate // 50)
    states, rates = prepared.states(t), prepared.smoothed(t, 1).T
    np.testing.assert_allclose(states[:2, inside], motion.q[inside].T, atol=1e-4)
    for velocities in (states[2:], rates[:2]):
        np.testing.assert_allclose(velocities[:, inside], motion.qd[inside].T, atol=0.02)
    # Dry friction reverses within milliseconds, which a smoothing window of 12 ms cannot resolve.
    qdd = forward_dynamics(rig.vector(), motion.q, motion.qd, motion.tau)
    moving = (np.abs(motion.qd) > 0.3).all(axis=1)[inside] if rig is GEARED else slice(None)
    error = np.abs(rates[2:, inside] - qdd[inside].T)[:, moving]
    assert np.median(error) < 0.01 * np.abs(qdd).max()


@st.composite
def stamped_torques(draw):
    """Draw a trajectory with regular or jittering stamps and random torques."""
    count, jitter = draw(st.integers(60, 90)), draw(st.sampled_from([0.0, 0.05, 0.4]))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    t = draw(st.floats(-5, 5)) + 0.01 * (np.arange(count) + jitter * rng.uniform(-1, 1, count))
    return Trajectory(t, rng.normal(size=(count, 2)), rng.normal(scale=3, size=(count, 2)))


def integrals(trajectory, hold, begin, end):
    """Return the integral of the torques, and its integral, interval by interval."""
    t, tau = trajectory.t, trajectory.tau
    total = np.zeros((2, 2))
    for k in range(len(t) - 1):
        a, b = max(begin, t[k]), min(end, t[k + 1])
        if a < b:
            slope = (tau[k + 1] - tau[k] if hold == 'linear' else np.zeros(2)) / (t[k + 1] - t[k])
            pushed = (b - a) * (tau[k] + slope * ((a + b) / 2 - t[k]))
            total += pushed, pushed * (end - (a + b) / 2) - slope * (b - a) ** 3 / 12
    return total


@given(
    stamped_torques(),
    st.sampled_from(['zero', 'linear']),
    st.lists(st.floats(0, 0.2), min_size=1, max_size=4),
    st.floats(1e-4, 0.02),
    st.integers(1, 15),
)
def test_linear_torques_in_steps_conserve_impulse_and_displacement(trajectory, hold, shifts, step, steps):
    prepared = Motion.prepare(trajectory, smoothing=0.0, hold=hold)
    starts = prepared.start + 0.01 + np.array(shifts)
    torques, change = prepared.torques(starts + step * np.arange(steps + 1)[:, None])
    for lane, start in enumerate(starts):
        for last in {1, steps}:
            expected, _ = integrals(trajectory, hold, start, start + last * step)
            np.testing.assert_allclose(torques[:last, lane].sum(axis=0) * step, expected, atol=1e-11)
            _, expected = integrals(trajectory, hold, start + (last - 1) * step, start + last * step)
            found = (torques / 2 - change / 6)[last - 1, lane] * step**2
            np.testing.assert_allclose(found, expected, atol=1e-11)


def test_a_part_of_a_motion_has_the_same_states_and_torques():
    t = 3.0 + np.arange(300) * 0.01
    whole = Motion.prepare(recording(t, drive(t)), 0.02)
    part = whole.part(3.495, math.inf)
    assert (part.start, part.end) == (3.495, t[-1])
    np.testing.assert_allclose(part.recorded.t, t[50:])
    at = np.linspace(3.495, 4.5, 7)
    np.testing.assert_array_equal(part.states(at), whole.states(at))
    edges = at[:3] + 0.003 * np.arange(21)[:, None]
    np.testing.assert_array_equal(part.torques(edges), whole.torques(edges))


@pytest.mark.parametrize('hold', ['zero', 'linear'])
@pytest.mark.parametrize('jitter', [0.0, 0.3])
def test_changing_a_motion_equals_preparing_the_changed_recording(hold, jitter):
    rng = np.random.default_rng(1)
    t = (np.arange(300) + jitter * rng.uniform(size=300)) * 0.005
    recorded = recording(t, drive(t))
    change = Affine(*(rng.normal(size=shape) for shape in ((2, 2), 2, (2, 2), 2)))
    read = replace(recorded, q=recorded.q @ change.Q.T + change.c, tau=recorded.tau @ change.T.T + change.d, qd=None)
    changed, expected = Motion.prepare(recorded, 0.03, hold).changed(change), Motion.prepare(read, 0.03, hold)
    at = np.linspace(t[0], t[-1], 1000)
    np.testing.assert_allclose(changed.states(at), expected.states(at), atol=1e-9)
    np.testing.assert_allclose(changed.impulse(at), expected.impulse(at), atol=1e-12)
    np.testing.assert_array_equal(changed.recorded.q, read.q)
    np.testing.assert_array_equal(changed.recorded.tau, read.tau)
