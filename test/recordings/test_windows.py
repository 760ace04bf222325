# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Windows of recordings: beyond their end, in messages, and of recordings too long to be read at once."""

import json
import pickle
from dataclasses import replace

import numpy as np
import pytest
import scipy.io

from pendubot_identification import api
from pendubot_identification.cli.main import main
from pendubot_identification.errors import LongRecordingError, PendubotError
from pendubot_identification.recordings import bag_reader
from pendubot_identification.recordings.bag_reader import BagWindow
from pendubot_identification.recordings.bag_writer import BagWriter
from pendubot_identification.recordings.datasets import load_datasets
from pendubot_identification.recordings.joint_states import JOINT_STATE, write_trajectory
from pendubot_identification.tracking import windows
from test.changing_rig import Day
from test.virtual import recording, recording_of_a_day

from .bags import STEP, TOPIC, csv, message

#: Length of informative windows [s].
LENGTH = 10


@pytest.fixture(scope='module')
def motion():
    day = Day(payload=0.2, payload_at=40.0)
    return recording_of_a_day(day, 90, 100, rests=(44, 50), push=(63, 63.5, 0.3))


@pytest.fixture(scope='module')
def bag(motion, tmp_path_factory):
    path = tmp_path_factory.mktemp('bags') / 'long'
    write_trajectory(path, motion)
    return path


@pytest.fixture(autouse=True)
def short_limits(monkeypatch):
    """Treat recordings over 25 s as too long."""
    monkeypatch.setattr(bag_reader, 'SETTINGS', replace(bag_reader.SETTINGS, longest=25.0, first_window=20.0))
    monkeypatch.setattr(windows, 'LENGTH', LENGTH)


def test_a_long_recording_is_refused_with_the_proposal_of_a_window(bag, motion, tmp_path):
    sentence = f'{bag} is too long: it lasts 90 s, and at most 25 s are read at once; take windows of it, such as '
    with pytest.raises(LongRecordingError, match=rf'^{sentence}{bag}@:20: pendubot track {bag} lists informative'):
        api.read(bag)
    with pytest.raises(LongRecordingError, match=r'it lasts 79 s.* such as .*@10:30: pendubot track') as refused:
        api.read(f'{bag}@10:89')
    # Another process may send the error.
    proposed = api.read(pickle.loads(pickle.dumps(refused.value)).first)
    np.testing.assert_array_equal(proposed.q, motion.q[(motion.t >= 10) & (motion.t < 30)])
    (tmp_path / 'me@home').mkdir()
    table = tmp_path / 'me@home' / 'x.mat'
    scipy.io.savemat(table, {'t': motion.t, 'q1': motion.q[:, 0], 'q2': motion.q[:, 1], 'tau1': motion.tau[:, 0]})
    with pytest.raises(LongRecordingError, match=rf'x\.mat is too long: it lasts 90 s.* pendubot track {table} lists'):
        api.read(table)
    assert len(api.read(f'{table}@80:')) == 1000


def test_the_remainder_of_a_long_recording_is_validated_on_windows_of_limited_length(bag, motion):
    data = load_datasets([f'{bag}@30:40'])
    assert [source.bag for source in data.sources] == [f'{bag}@{w}' for w in ('30:40', ':20', '40:60')]
    np.testing.assert_array_equal(data.validation[1].q, motion.q[(motion.t >= 40) & (motion.t < 60)])


def test_track_proposes_informative_windows_between_changes(bag, capsys):
    """A payload is added at 40 s; the torque is zero from 44 to 50 s; the rig is pushed at 63 s."""
    assert main(['track', str(bag), '--json']) == 0
    proposed = json.loads(capsys.readouterr().out)['tracked']['windows']
    parsed = [BagWindow.parse(text) for text in proposed]
    assert len(parsed) == windows.NAMED
    for window in parsed:
        assert window.end - window.start == LENGTH
        assert window.end <= 63 or window.start >= 63.5, 'without the push'
        assert (window.end <= 40) == (parsed[0].end <= 40), 'all with or all without the payload'
        assert not 40 <= window.start < 50, 'not at rest'
    assert main(['identify', *proposed, '--criterion', 'weak', '--model', 'coulomb', '--optimizer', 'lsq']) == 0


def test_the_length_limit_applies_to_the_topic_instead_of_the_bag(tmp_path):
    with BagWriter(tmp_path / 'bag') as writer:
        joints, other = (writer.add_topic(name, JOINT_STATE) for name in (TOPIC, '/other'))
        for k in (*range(1000), 8_500):
            stamp, data = message(k)
            writer.write(joints if k < 1000 else other, data, stamp)
    assert bag_reader.BagReader(tmp_path / 'bag').duration == 8500 * STEP / 1e9
    data = load_datasets([str(tmp_path / 'bag')])
    assert [len(d) for d in (*data.training, *data.validation)] == [500, 500]


def write(path, motion):
    """Write a bag, or a table if the path has a suffix."""
    if path.suffix:
        path.write_text(csv(motion))
    else:
        write_trajectory(path, motion)


@pytest.mark.parametrize('name', ['bag', 'file.csv'])
def test_a_window_beyond_the_end_is_reported_with_both_times(tmp_path, name):
    path = tmp_path / name
    write(path, recording(1200))
    data = load_datasets([f'{path}@0:50'])
    (note,) = data.notes
    assert not any(load_datasets([f'{path}{window}']).notes for window in ('', '@:', '@2:', '@0:6', '@6:12', '@0:12'))
    assert note.startswith(f'{path}@0:50 ends at 50 s, but its last sample is at 11.990 s')
    assert [len(motion) for motion in data.training] == [1200]
    with pytest.warns(match='@0:50 ends at 50 s, but its last sample is at 11'):
        assert len(api.read(f'{path}@0:50')) == 1200
    for window, refused in (
        ('13:50', r'holds no sample; choose a time within the 11\.99. s'),
        ('1:1.3', '30 samples .* too few'),
    ):
        with pytest.raises(PendubotError, match=f'@{window}:? {refused}'):
            load_datasets([f'{path}@{window}'])


@pytest.mark.parametrize('name', ['bag', 'file.csv'])
def test_times_in_messages_count_from_the_first_sample_of_the_file(tmp_path, name):
    """The gap is in the validation part or in a window."""
    motion = recording(1200)
    write(tmp_path / name, motion[(motion.t < 9.0) | (motion.t > 9.9)])
    for window in ('', '@2:'):
        with pytest.raises(PendubotError, match=r'0\.920 s without a sample begin at 8\.990 s'):
            api.identify(f'{tmp_path / name}{window}', criterion='weak')
