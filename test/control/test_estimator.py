# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The estimator follows a simulated rig, and predicts it over the dead time."""

import math

import numpy as np
import pytest

from pendubot_identification.control.estimator import CommandMonitor, Estimator
from pendubot_identification.control.linear_control import design
from pendubot_identification.model.parameters import BALANCE
from pendubot_identification.model.simulation import HANGING, LatePlant

COUNT = 2 * math.pi / 4000


def follow(period, transport, lag, counts=True, lost=()):
    """Return true states and predictions [rad, rad/s] of a rig that random torques move."""
    r = design(BALANCE, period, transport * period + lag)
    estimator = Estimator(BALANCE, period, lag, r.L)
    rig, fine = LatePlant(BALANCE, lag, (HANGING[0] + 0.2, 0.1)), 20
    rng, torques, states, predictions, gap = np.random.default_rng(1), [0.0] * transport, [], [], 0
    for k in range(round(2 / period)):
        gap += 1
        if k not in lost:
            q = tuple(round((a - z) / COUNT) * COUNT + z if counts else a for a, z in zip(rig.q, HANGING, strict=True))
            estimator.update(q, torques[k], gap)
            gap = 0
            predictions.append((k, estimator.predict(torques[k + 1 :])))
        torques.append(rng.uniform(-0.5, 0.5))
        for _ in range(fine):
            states.append((*rig.q, *rig.qd))
            rig.advance((torques[k], 0.0), period / fine)
    late = round((transport * period + lag) / (period / fine))
    pairs = [(states[k * fine + late], x) for k, x in predictions if k * fine + late < len(states)]
    return np.array([pair[0] for pair in pairs]), np.array([pair[1] for pair in pairs])


@pytest.mark.parametrize(
    ('period', 'transport', 'lag'), [(0.005, 1, 0.0), (0.005, 2, 0.0065), (0.002, 4, 0.0), (0.002, 1, 0.004)]
)
def test_the_prediction_is_the_true_state_when_the_torque_acts(period, transport, lag):
    true, predicted = follow(period, transport, lag, counts=False)
    settled = slice(len(true) // 4, None)
    assert np.abs(predicted - true)[settled, :2].max() < 1e-4
    assert np.abs(predicted - true)[settled, 2:].max() < 1e-2


def test_encoder_counts_and_lost_samples_cost_little():
    true, predicted = follow(0.005, 1, 0.004, lost={150, 200, 201, 202, 260})
    error = np.sqrt(((predicted - true)[100:] ** 2).mean(axis=0))
    assert error[:2].max() < 2 * COUNT
    assert error[2:].max() < 0.5


def test_after_a_gap_the_speed_is_at_most_distance_over_time():
    r = design(BALANCE, 0.005, 0.009)
    estimator = Estimator(BALANCE, 0.005, 0.004, r.L)
    estimator.update(HANGING, 0.0)
    estimator.update((HANGING[0] + 1.0, 1.0), 0.0, 20)
    assert max(map(abs, estimator.state[2:])) < 20


def echoed(transport, samples=200, period=0.005, obeyed=lambda k: True):
    echo, rng, torques = CommandMonitor(period), np.random.default_rng(2), [0.0] * transport
    for k in range(samples):
        if not echo.obeyed(torques[k] if obeyed(k) else 0.0):
            return k, echo
        torques.append(float(rng.uniform(-1, 1)))
        echo.command(torques[-1])
    return None, echo


@pytest.mark.parametrize('transport', [1, 2, 5])
def test_the_transport_of_torques_is_measured(transport):
    ended, echo = echoed(transport)
    assert ended is None
    assert echo.transport == transport
    for torque in range(10):
        echo.command(torque)
    assert echo.pending() == list(range(10))[11 - transport :]


def test_a_motor_that_does_not_obey_is_noticed_within_a_tenth_of_a_second():
    ended, _ = echoed(1, obeyed=lambda k: k < 100)
    assert ended is not None
    assert 100 < ended <= 100 + 20
