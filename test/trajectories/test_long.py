# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Long recordings: taken piece by piece they are what they are in one."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pendubot_identification.errors import TrajectoryError
from pendubot_identification.excitation.excitation import PulseTrain
from pendubot_identification.identify.linear import linear
from pendubot_identification.identify.settings import Settings
from pendubot_identification.identify.uncertainty import bootstrap_covariance
from pendubot_identification.model.parameters import PAPER
from pendubot_identification.model.rollout import roll
from pendubot_identification.model.simulation import quantised
from pendubot_identification.trajectories.long import STRETCH, STRETCHES, Long, gridded
from pendubot_identification.trajectories.motion import LongMotion, Motion
from pendubot_identification.trajectories.trajectory import Trajectory

SETTINGS = Settings(delays=(0.003, 0.003))


def recording(seconds=180.0, interval=0.004, jitter=0.0):
    """What encoders say of the virtual rig under pulses; stamps that jitter, by a part of the interval."""
    t = np.arange(round(seconds / interval)) * interval
    tau = np.column_stack([PulseTrain(hold=0.02).torques(t), np.zeros(len(t))])
    states = roll(PAPER.vector(), np.array([[-np.pi / 2], [0], [0], [0]]), tau.T[:, :-1, None], interval)
    stamps = t + jitter * interval * np.random.default_rng(1).uniform(-1, 1, len(t))
    return quantised(Trajectory(stamps, states[:, :2, 0], tau, name='virtual rig'), 4000)


MOTIONS = {jitter: recording(jitter=jitter) for jitter in (0.0, 0.04, 0.4)}


def long(motion, size):
    def read():
        for first in range(0, len(motion), size):
            yield motion[first : first + size]

    return Long.survey(motion.name, read, motion.duration, '{}:{}'.format)


@pytest.mark.parametrize('jitter', MOTIONS)
@pytest.mark.parametrize(
    ('criterion', 'sliding'), [('energy', None), ('energy', 0.3), ('energy', 15.0), ('weak', None)]
)
@settings(max_examples=2)
@given(size=st.integers(300, 20_000))
def test_piece_by_piece_the_quadratic_criteria_are_the_same(jitter, criterion, sliding, size):
    motion, how = MOTIONS[jitter], replace(SETTINGS, sliding=sliding)
    held = Motion.prepare(motion, 0.02)
    recorded = long(motion, size)
    assert (recorded.near, len(recorded)) == (jitter < 0.1, len(motion))
    first = linear(criterion, [held], 'geared', how)
    again = linear(criterion, [LongMotion(recorded, 0.02, 'zero')], 'geared', how, like=first)
    one, other = first.criterion, again.criterion
    assert one.count == other.count
    for theta in (np.zeros(14), PAPER.vector('geared'), one.free_minimum()):
        np.testing.assert_allclose(other(theta), one(theta), rtol=1e-9)
    free, theta = np.arange(14) < 7, PAPER.vector('geared')
    errors = [np.sqrt(np.diag(bootstrap_covariance(x.blocks, theta, free))[:7]) for x in (first, again)]
    np.testing.assert_allclose(errors[1], errors[0], rtol=1e-6)
    seven = [np.linalg.lstsq(c.phi[:, :7], c.y, rcond=None)[0] for c in (one, other)]
    np.testing.assert_allclose(seven[1], seven[0], rtol=1e-9)


@pytest.mark.parametrize('jitter', MOTIONS)
def test_pieces_share_what_they_are_told_and_leave_nothing_out(jitter):
    motion = MOTIONS[jitter]
    recorded, end = long(motion, 700), 0
    grid = gridded(motion)
    assert (recorded.size, recorded.interval) == (grid.size, pytest.approx(grid.interval, rel=1e-9))
    (whole,) = grid.pieces(0.0)
    for piece in recorded.pieces(0.5):
        assert piece.begin == end
        end = piece.end
        np.testing.assert_array_equal(piece.recorded.t, motion.t[piece.at : piece.at + len(piece.recorded)])
        assert piece.recorded.t[0] <= max(recorded.time(piece.begin) - 0.5, motion.t[0])
        assert piece.recorded.t[-1] >= min(recorded.time(piece.end - 1) + 0.5, motion.t[-1])
        assert piece.recorded.duration < 32
        own = slice(piece.begin - piece.first, piece.end - piece.first)
        np.testing.assert_allclose(piece.even.t[own], whole.even.t[piece.begin : end], rtol=0, atol=1e-9)
        np.testing.assert_allclose(piece.even.q[own], whole.even.q[piece.begin : end], rtol=0, atol=1e-9)
    assert end == recorded.size


def test_stretches_are_those_in_which_the_rig_is_driven():
    motion = MOTIONS[0.0]
    quiet = np.abs(motion.t % 15 - 6) > 3
    motion = replace(motion, tau=np.where(quiet[:, None], 0, motion.tau))
    stretches = long(motion, 100).stretches
    assert len(stretches) == STRETCHES
    starts = [stretch.t[0] for stretch in stretches]
    assert starts == sorted(starts)
    for stretch in stretches:
        assert stretch.duration == pytest.approx(STRETCH, abs=0.01)
        assert stretch.tau.any()


def test_what_is_wrong_with_a_long_recording_is_named():
    motion = MOTIONS[0.0]
    hole = (motion.t < 70) | (motion.t > 71)
    with pytest.raises(TrajectoryError, match=r'virtual rig: 1\.0\d\d s without a sample begin at (69\.99|70\.0)'):
        long(motion[hole], 500)
    parts = motion[:2500], replace(motion[2500:], t=motion.t[2500:] - 0.01)
    with pytest.raises(TrajectoryError, match=r'virtual rig.*: the stamp of sample \d+ runs backwards by 0\.006 s'):
        Long.survey(motion.name, lambda: iter(parts), motion.duration, '{}:{}'.format)
    some = np.random.default_rng(1).random(len(motion)) > 0.1
    assert long(motion[some], 500).lost == pytest.approx((~some).sum(), rel=0.05)
