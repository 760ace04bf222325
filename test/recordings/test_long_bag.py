# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Bags that are too long to be held: read piece by piece, taken in stretches, and the same answers in the end."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from pendubot_identification.cli.main import main
from pendubot_identification.errors import TrajectoryError
from pendubot_identification.excitation.excitation import PulseTrain
from pendubot_identification.identify.identification import identify
from pendubot_identification.identify.settings import Settings
from pendubot_identification.level import Level
from pendubot_identification.model.parameters import PAPER
from pendubot_identification.model.rollout import roll
from pendubot_identification.model.simulation import quantised
from pendubot_identification.recordings.bag_metadata import Qos
from pendubot_identification.recordings.bag_reader import BagWindow, read_recording, read_trajectory
from pendubot_identification.recordings.bag_writer import BagWriter
from pendubot_identification.recordings.datasets import load_datasets
from pendubot_identification.recordings.joint_states import (
    EPOCH_NS,
    JOINT_NAMES,
    JOINT_STATE,
    encode_joint_state,
    write_trajectory,
)
from pendubot_identification.report import folder
from pendubot_identification.results.provenance import recordings
from pendubot_identification.results.result_file import result_of
from pendubot_identification.trajectories import long
from pendubot_identification.trajectories.long import STRETCH, Long
from pendubot_identification.trajectories.trajectory import Trajectory

INTERVAL, SAMPLES = 0.01, 8000
#: What is too long here [s], and how many stretches stand for it.
LONG, STRETCHES = 25.0, 4
SETTINGS = Settings(('energy', 'weak'), 'viscous', 'lsq', delays=(0.0, 0.0))


def recording():
    t = np.arange(SAMPLES) * INTERVAL
    tau = np.column_stack([PulseTrain().torques(t), np.zeros(SAMPLES)])
    states = roll(PAPER.vector(), np.array([[-np.pi / 2], [0], [0], [0]]), tau.T[:, :-1, None], INTERVAL)
    return quantised(Trajectory(t, states[:, :2, 0], tau), 4000)


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    path = tmp_path_factory.mktemp('bags') / 'long'
    write_trajectory(path, recording())
    return path


@pytest.fixture
def soon(monkeypatch):
    """Half a minute is already too long."""
    for name, value in (('LONG_SECONDS', LONG), ('STRETCHES', STRETCHES)):
        monkeypatch.setattr(long, name, value)


@pytest.fixture(params=['closed', 'cut'])
def either(request, bag, tmp_path):
    """The bag, and one whose end is missing with its index."""
    if request.param == 'closed':
        return bag
    path = shutil.copytree(bag, tmp_path / 'cut')
    (path / 'long_0.mcap').write_bytes((path / 'long_0.mcap').read_bytes()[:-30_000])
    return path


def test_a_long_recording_is_read_in_parts_and_in_stretches(either, soon):
    whole = read_trajectory(BagWindow(either, 10, 70)).trajectory
    recorded = read_recording(BagWindow(either, 10, 70)).trajectory
    assert isinstance(recorded, Long)
    assert (len(recorded), recorded.start, recorded.last) == (len(whole), whole.t[0], whole.t[-1])
    for _ in range(2):
        parts = list(recorded.read())
        assert max(map(len, parts)) < len(whole) / 2
        for name in ('t', 'q', 'tau'):
            read = np.concatenate([getattr(part, name) for part in parts])
            np.testing.assert_array_equal(read, getattr(whole, name))
    assert len(recorded.stretches) == STRETCHES
    for stretch in recorded.stretches:
        alone = read_trajectory(BagWindow.parse(stretch.name)).trajectory
        assert len(alone) == len(stretch) == round(STRETCH / INTERVAL)
        np.testing.assert_array_equal(alone.q, stretch.q)


def test_what_is_quadratic_is_that_of_all_of_it(bag, request):
    held = load_datasets([str(bag)])
    assert all(isinstance(motion, Trajectory) for motion in (*held.training, *held.validation))
    request.getfixturevalue('soon')
    data = load_datasets([str(bag)])
    assert [source.role for source in data.sources] == ['training', 'validation']
    assert sum(source.samples for source in data.sources) == SAMPLES
    assert all(len(source.stretches) == STRETCHES for source in data.sources)
    first, again = (identify(d.training, d.validation, SETTINGS) for d in (held, data))
    for one, other in zip(first.estimates, again.estimates, strict=True):
        # Half of it is 40 s to the sample; what is chosen from stretches is the smoothing and the weights.
        tolerance = 1e-6 if one.criterion == 'energy' else 0.01
        np.testing.assert_allclose(other.theta, one.theta, rtol=tolerance)
        np.testing.assert_allclose(other.std_error, one.std_error, rtol=0.1)
        np.testing.assert_allclose(other.J_validation, one.J_validation, rtol=0.25)
        assert other.residuals == pytest.approx(one.residuals, abs=3)
        assert 'from all of' in other.steps[0]
    motions = recordings(result_of(again, data.sources))
    assert [len(part) for part in motions] == [STRETCHES, STRETCHES]
    for part, recorded in zip(motions, (data.training, data.validation), strict=True):
        assert [m.name for m in part] == [m.name for m in recorded[0].stretches]


def test_several_long_recordings_share_the_stretches(bag, soon):
    data = load_datasets([f'{bag}@0:30', f'{bag}@45:75'], [f'{bag}@0:28'])
    assert [len(recorded.stretches) for recorded in (*data.training, *data.validation)] == [2, 2, 3]
    found = identify(data.training, data.validation, SETTINGS)
    motions = recordings(result_of(found, data.sources))
    assert [len(part) for part in motions] == [4, 3]


def test_trajectory_takes_the_stretches_and_says_so(bag, soon, tmp_path, capsys, monkeypatch):
    # Its figures are of no interest here.
    monkeypatch.setattr(folder, '_wanted', lambda *_: ())
    arguments = ('--criterion', 'trajectory', '--model', 'viscous', '--verbose', '--report', str(tmp_path / 'look'))
    assert main(['identify', str(bag), *arguments]) == 0
    said = ' '.join(capsys.readouterr().out.split())
    assert f'from {STRETCHES} stretches of 8 s, spread over {bag}@:39.995, 40 s' in said
    page = (tmp_path / 'look' / 'report.html').read_text()
    assert f'what lies between {STRETCHES} stretches of {bag}@:39.995, 40 s' in page


def test_a_long_day_on_which_friction_drifts_is_never_ok(tmp_path, monkeypatch):
    """Dry and viscous friction fall by a third, in a recording of which stretches are taken."""
    monkeypatch.setattr(long, 'LONG_SECONDS', 100.0)
    rig = replace(PAPER, Fc1=0.01, Fc2=0.0005)
    state, q, count = np.array([-np.pi / 2, 0.0, 0.0, 0.0]), [], 30
    t = np.arange(count * 1000) * INTERVAL
    tau = np.column_stack([PulseTrain().torques(t), np.zeros(len(t))])
    for k in range(count):
        worn = 1 - k / count / 3
        now = replace(rig, **{name: worn * getattr(rig, name) for name in ('b1', 'b2', 'Fc1', 'Fc2')})
        torque = np.repeat(tau[1000 * k : 1000 * (k + 1)].T, 2, axis=1)[:, :, None]
        states = roll(now.vector(), state[:, None], torque, INTERVAL / 2)[:, :, 0]
        q.append(states[:-1:2, :2])
        state = states[-1]
    path = tmp_path / 'day'
    write_trajectory(path, quantised(Trajectory(t, np.concatenate(q), tau), 4000))
    (recording,) = load_datasets([f'{path}@0:299']).training
    assert isinstance(recording, Long)
    found = identify([recording], settings=Settings(('weak', 'trajectory'), 'coulomb', 'lsq'))
    assert found.level is Level.WARN
    (said,) = (warning for warning in found.warnings if 'friction changes with time' in warning)
    assert 'may change P1 to P5 by' in said, 'it is not allowed for'


def test_a_topic_that_ended_long_before_the_bag_is_taken_as_long_as_it_is(tmp_path, soon):
    motion = recording()
    writer = BagWriter(tmp_path / 'bag')
    joints = writer.add_topic('/joint_states', JOINT_STATE, Qos())
    other = writer.add_topic('/other', JOINT_STATE, Qos())
    for k in range(SAMPLES):
        stamp = EPOCH_NS + k * 10_000_000
        message = encode_joint_state(stamp, JOINT_NAMES, motion.q[k], [0, 0], motion.tau[k])
        if k < 500 or k == 7900:
            writer.write(joints if k < 500 else other, message, stamp, stamp)
    writer.close()
    data = load_datasets([str(tmp_path / 'bag')])
    assert [len(d) for d in (*data.training, *data.validation)] == [250, 250]
    with pytest.raises(TrajectoryError, match='the window holds no sample'):
        load_datasets([f'{tmp_path / "bag"}@50:'])


def test_gaps_and_stamps_that_run_back_are_named(tmp_path, soon):
    motion = recording()
    write_trajectory(tmp_path / 'hole', motion[(motion.t < 50) | (motion.t > 51)])
    with pytest.raises(TrajectoryError, match=r'1\.020 s without a sample begin at 49\.990 s, where 0\.01 s is'):
        read_recording(BagWindow(tmp_path / 'hole'))
    assert read_recording(BagWindow(tmp_path / 'hole', 0, 50)).trajectory.lost == 0


def test_a_sliding_window_longer_than_a_stretch_is_one_sentence(bag, soon, capsys):
    assert main(['identify', str(bag), '--criterion', 'energy', '--sliding', '20']) == 1
    assert 'the sliding window of 20 s is too long for a long recording' in capsys.readouterr().err
