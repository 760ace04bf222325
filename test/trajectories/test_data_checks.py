# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Checks of samples, and the identification of recordings with timestamp jitter."""

from dataclasses import replace

import numpy as np
import pytest

from pendubot_identification.identification.pipeline import identify
from pendubot_identification.identification.settings import Settings
from pendubot_identification.model.parameters import PAPER
from pendubot_identification.model.simulation import quantised, simulate
from pendubot_identification.trajectories.data_checks import data_checks
from pendubot_identification.trajectories.signals import evenly_stamped
from test.virtual import recording

FAST = Settings(('likelihood',), model='viscous', hold='zero')


@pytest.mark.parametrize('interval', [0.002, 0.04])
def test_a_good_recording_has_no_warnings(interval):
    assert data_checks([recording(int(9 / interval), interval)]) == []


def test_clipped_efforts_and_angles_are_reported():
    motion, (low, high) = recording(), ([-9.0, -0.4], [9.0, 0.4])
    effort, greatest, least = data_checks(
        [replace(motion, q=np.clip(motion.q, low, high), tau=np.clip(motion.tau, -0.3, 0.3))]
    )
    assert 'the effort of the shoulder is at its maximum of 0.3 N m in 62 % of' in effort
    assert 'the elbow stops abruptly at its greatest position of 0.4 rad' in greatest
    assert 'the elbow stops abruptly at its least position of -0.4 rad' in least


def test_one_long_pulse_is_no_limit_of_the_effort():
    motion = recording()
    tau = np.zeros_like(motion.tau)
    tau[100:300, 0], tau[300:400, 0], tau[500:600, 0] = 0.4, -0.3, 0.2
    assert data_checks([replace(motion, tau=tau)]) == []


def jittering(rate, size, *, true):
    """Return a recording with uniform timestamp jitter +- size [s]; if ``true``, the sampling jitters as the stamps."""
    motion = recording(int(4 * rate), 1 / rate, seed=3)
    t = motion.t + np.random.default_rng(1).uniform(-size, size, len(motion))
    t = np.maximum.accumulate(t - 1e-9 * np.arange(len(t))) + 1e-9 * np.arange(len(t))
    return replace(quantised(simulate(PAPER, t, motion.tau), 4000) if true else motion, t=t)


def test_inconsistent_timestamps_are_replaced_and_consistent_ones_kept():
    rate, size = 100, 8e-4
    truth = jittering(rate, size, true=True)
    assert data_checks([truth]) == []
    assert evenly_stamped(truth) is truth
    false = jittering(rate, size, true=False)
    (sentence,) = data_checks([false])
    assert 'its stamps jitter' in sentence
    assert 'even stamps replace them' in sentence
    for motion, warnings in ((truth, ()), (false, (sentence,))):
        result = identify([motion], [], FAST)
        # Replaced stamps may leave a residual that resembles a lag.
        assert result.warnings[: len(warnings)] == warnings
        assert warnings or not result.warnings
        assert np.abs(result.best.theta / PAPER.vector() - 1).max() < 0.005
