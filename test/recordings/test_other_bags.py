# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Bags of ROS 1, and of ROS 2 with storage sqlite3, converted by rosbags."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rosbags.convert import convert
from rosbags.typesys import Stores, get_typestore

from pendubot_identification.errors import BagError, TrajectoryError
from pendubot_identification.recordings.bag_reader import BagWindow, open_recording, read_trajectory, stream_samples
from pendubot_identification.recordings.joint_states import write_trajectory
from pendubot_identification.trajectories.conversion import Conversion
from test.conftest import ROOT

BAG = ROOT / 'bags' / 'paper_experiment'


@pytest.mark.parametrize(
    ('name', 'version', 'store'), [('run.bag', 3, Stores.ROS1_NOETIC), ('run', 8, Stores.ROS2_JAZZY)]
)
def test_a_converted_bag_gives_the_same_motion_and_a_replaced_one_is_read_again(
    tmp_path, monkeypatch, name, version, store
):
    stores = get_typestore(Stores.ROS2_JAZZY), get_typestore(store)
    convert([BAG], tmp_path / name, 'sqlite3', version, None, 'none', *stores, [], [], [], [])
    found, expected = read_trajectory(tmp_path / name).trajectory, read_trajectory(BAG).trajectory
    for field in ('t', 'q', 'tau'):
        np.testing.assert_array_equal(getattr(found, field), getattr(expected, field))
    for folder, q in (('one', expected.q), ('other', -expected.q)):
        (tmp_path / folder).mkdir()
        monkeypatch.chdir(tmp_path / folder)
        write_trajectory(Path('motion'), replace(expected, q=q))
        convert([Path('motion')], Path(name), 'sqlite3', version, None, 'none', *stores, [], [], [], [])
        np.testing.assert_array_equal(read_trajectory(Path(name)).trajectory.q, q)


@pytest.mark.parametrize('name', ['empty.bag', 'empty.db3'])
def test_an_invalid_file_is_refused_in_one_sentence(tmp_path, name):
    (tmp_path / name).write_bytes(b'hello')
    with pytest.raises(BagError, match='is no bag with messages of type sensor_msgs/msg/JointState that can be read'):
        read_trajectory(tmp_path / name)


@pytest.mark.parametrize('conversion', [Conversion(unwrap=True), Conversion(unwrap=True, degrees=True)])
def test_wrapped_angles_are_unwrapped_in_files_and_streams(tmp_path, conversion):
    expected = read_trajectory(BAG).trajectory
    wrapped = (expected.q + 2) % (2 * np.pi) - 2
    assert np.abs(np.diff(wrapped, axis=0)).max() > 6
    write_trajectory(tmp_path / 'run', replace(expected, q=np.degrees(wrapped) if conversion.degrees else wrapped))
    with pytest.raises(TrajectoryError, match=r'run: q1 jumps by .* at 4\.\d* s, .*: add --unwrap'):
        read_trajectory(tmp_path / 'run')
    window = BagWindow(tmp_path / 'run')
    reader = open_recording(window.path, conversion)
    rows = stream_samples(reader, window, conversion)
    for q in (read_trajectory(window, conversion).trajectory.q, np.concatenate(list(rows))[:, 1:3]):
        np.testing.assert_allclose(q, expected.q, atol=1e-9)
