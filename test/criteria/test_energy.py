# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The energy criterion on exact motions, and compared with the paper's equations."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pendubot_identification.criteria.energy import energy_regression
from pendubot_identification.criteria.quadratic import Quadratic
from pendubot_identification.errors import TrajectoryError
from pendubot_identification.excitation.excitation import PulseTrain
from pendubot_identification.model.dynamics import energy
from pendubot_identification.model.parameters import MODELS, PAPER, Parameters
from pendubot_identification.model.simulation import simulate
from pendubot_identification.trajectories.trajectory import Trajectory


def swing(n, interval=0.01):
    """Return a smooth, exact motion."""
    t = np.arange(n) * interval
    return simulate(PAPER, t, np.outer(0.15 * np.sin(4 * t + 1), [1, 0]))


@pytest.mark.parametrize('model', ['viscous', 'geared'])
def test_the_residual_of_the_true_parameters_is_zero_for_every_model(model):
    theta = (0.06, 0.05, 0.032, 0.23, 0.16, 0.005, 0.004, 0.2, 0.15, 0.0026, 0.1, 0.08, 0.1, 0.08)[: MODELS[model]]
    t = np.arange(2000) / 1000
    tau = np.column_stack([2 * np.sin(4 * t), 0.6 * np.sin(7 * t + 1)])
    motion = simulate(Parameters.from_vector(theta), t, tau)
    for window in (None, 0.3):
        regression = energy_regression(motion, window, 0.006, model)
        assert regression.phi.shape == (len(regression.y), MODELS[model])
        residual = regression.y - regression.phi @ theta
        assert np.abs(residual).max() < 1e-3 * np.abs(regression.y).max()


def test_the_criterion_is_the_papers_sum():
    motion = swing(120)
    theta = PAPER.vector() * [1.1, 0.9, 1.2, 0.8, 1.1, 1.3, 0.7]
    qd = np.gradient(motion.q, 0.01, axis=0)
    total = 0.0
    for n in range(1, 120):
        work = loss = 0.0
        for k in range(n):
            work += motion.tau[k] @ (motion.q[k + 1] - motion.q[k])
            loss += 0.01 * theta[5:] @ (qd[k] ** 2 + qd[k + 1] ** 2) / 2
        gained = energy(theta, motion.q[n], qd[n]) - energy(theta, motion.q[0], qd[0])
        total += (work - loss - gained) ** 2
    regression = energy_regression(motion)
    J = Quadratic.reduce(regression.phi, regression.y)(theta)
    np.testing.assert_allclose(J, total / 119, rtol=1e-9)


@settings(max_examples=5)
@given(st.integers(2, 40))
def test_a_sliding_window_is_the_difference_of_two_cumulative_sums(samples):
    motion = swing(150)
    whole, part = energy_regression(motion), energy_regression(motion, samples * 0.01)
    theta = np.ones(7)
    eps = np.concatenate([[0.0], whole.y - whole.phi @ theta])
    np.testing.assert_allclose(part.y - part.phi @ theta, eps[samples:] - eps[:-samples], atol=1e-9)


def test_timestamp_jitter_neither_loses_nor_repeats_a_pulse():
    """The clock of the board is also 30 ppm slow."""
    t = np.arange(900) * 0.0100003
    pulses = PulseTrain(seed=4)
    tau = np.column_stack([[pulses.torque(x) for x in np.arange(900) * 0.01], np.zeros(900)])
    stamped = t + np.random.default_rng(1).uniform(-3e-3, 3e-3, 900)
    motion = simulate(PAPER, stamped, tau)
    for window in (None, 0.5):
        regression = energy_regression(motion, window)
        residual = regression.y - regression.phi @ PAPER.vector()
        assert np.sqrt(np.mean(residual**2)) < 0.2 * np.sqrt(np.mean(regression.y**2))


def test_degrees_and_wrapped_angles_are_refused():
    t = 5 + np.arange(200) / 100
    q, tau = np.column_stack([t, np.sin(9 * t)]), np.ones((len(t), 2))
    energy_regression(Trajectory(t, q, tau))
    wrapped = q + np.where(t > 6, -2 * np.pi, 0)[:, None] * [1, 0]
    for angles, place in ((np.rad2deg(q), 'elbow turns at .* at'), (wrapped, r'shoulder turns at .* at 6\.0\d\d s')):
        with pytest.raises(
            TrajectoryError,
            match=rf'the {place}.* in radians, unwrapped and without jumps, and its stamps correct',
        ):
            energy_regression(Trajectory(t, angles, tau))


def test_a_sliding_window_that_does_not_fit_is_refused():
    for window, sentence in ((5.0, 'sliding window of 5 s'), (1e-9, '1e-09 s is shorter than the sampling interval')):
        with pytest.raises(TrajectoryError, match=sentence):
            energy_regression(swing(50), window)
