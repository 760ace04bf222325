# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Prediction of a simulated rig over the dead time, and measurement of the latency of commands."""

import numpy as np
import pytest

from pendubot_identification.control.estimator import CommandMonitor, Estimator
from pendubot_identification.control.linear_control import Design, Loop
from pendubot_identification.model.parameters import BALANCE
from pendubot_identification.model.simulation import HANGING, LatePlant


@pytest.mark.parametrize(
    ('period', 'transport', 'lag'), [(0.005, 1, 0.0), (0.005, 2, 0.0065), (0.002, 4, 0.0), (0.002, 1, 0.004)]
)
def test_the_prediction_is_the_true_state_at_the_time_when_the_torque_acts(period, transport, lag):
    delay, fine = transport * period + lag, 20
    estimator = Estimator(BALANCE, period, lag, Design.make(BALANCE, Loop(period, lag)).L)
    rig, rng = LatePlant(BALANCE, lag, (HANGING[0] + 0.2, 0.1)), np.random.default_rng(1)
    torques, states, predictions = [0.0] * transport, [], []
    for k in range(round(2 / period)):
        estimator.update(rig.q, torques[k])
        predictions.append(estimator.predict(torques[k + 1 :]))
        torques.append(rng.uniform(-0.5, 0.5))
        for _ in range(fine):
            states.append((*rig.q, *rig.qd))
            rig.advance((torques[k], 0.0), period / fine)
    true = np.array(states[round(delay / period * fine) :: fine])
    settled = slice(len(true) // 4, len(true))
    error = np.abs(np.array(predictions)[settled] - true[settled])
    assert error[:, :2].max() < 1e-4
    assert error[:, 2:].max() < 1e-2


def test_after_a_gap_the_speed_is_at_most_distance_over_time():
    estimator = Estimator(BALANCE, 0.005, 0.004, Design.make(BALANCE, Loop(0.005, 0.004)).L)
    estimator.update(HANGING, 0.0)
    estimator.update((HANGING[0] + 1.0, 1.0), 0.0, 20)
    assert max(map(abs, estimator.state[2:])) < 20


@pytest.mark.parametrize('transport', [1, 2, 5])
def test_the_latency_of_commands_is_measured_and_ignored_commands_are_detected_within_a_tenth_of_a_second(transport):
    monitor, rng, torques = CommandMonitor(0.005), np.random.default_rng(2), [0.0] * transport
    for k in range(200):
        assert monitor.obeyed(torques[k])
        torques.append(float(rng.uniform(-1, 1)))
        monitor.command(torques[-1])
    assert monitor.transport == transport
    assert monitor.pending() == torques[len(torques) + 1 - transport :]
    assert any(not monitor.obeyed(0.0) for _ in range(21))
