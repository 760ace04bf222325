# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Bags compressed in the modes of rosbag2."""

import json

import numpy as np
import pytest
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from pendubot_identification.cli.main import main
from pendubot_identification.errors import BagError
from pendubot_identification.recordings.bag_reader import BagWindow, read_trajectory
from pendubot_identification.recordings.joint_states import JOINT_STATE

from .bags import FLOAT, STEP, TOPIC, message
from .independent import by_mcap


def write(path, mode, count=300):
    store = get_typestore(Stores.ROS2_JAZZY)
    writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode[mode], CompressionFormat.ZSTD)
    with writer:
        states = writer.add_connection(TOPIC, JOINT_STATE, typestore=store)
        other = writer.add_connection('/other', 'std_msgs/msg/Float64', typestore=store)
        for stamp, data in map(message, range(count)):
            writer.write(states, stamp, data)
            writer.write(other, stamp, FLOAT + bytes(8))
    return path


@pytest.mark.parametrize('mode', ['MESSAGE', 'FILE'])
def test_a_compressed_bag_is_read_surveyed_and_repaired(tmp_path, capsys, mode):
    bag = write(tmp_path / 'bag', mode)
    recorded = read_trajectory(BagWindow(bag, 0.5, 2))
    assert recorded.closed
    np.testing.assert_array_equal(recorded.trajectory.t, np.arange(50, 200) * STEP / 1e9)
    np.testing.assert_array_equal(recorded.trajectory.tau[:, 0], np.arange(50, 200))
    assert main(['info', str(bag), '--json']) == 0
    info = json.loads(capsys.readouterr().out)
    assert (info['closed'], info['note'], info['damaged']) == (True, '', [])
    found = [[topic[name] for name in ('messages', 'period', 'gaps', 'latency_max')] for topic in info['topics']]
    assert found == [[300, 0.01, 0, 0], [300, 0.01, 0, None]]
    assert main(['repair', str(bag), '--output', str(tmp_path / 'copy')]) == 0
    saved = by_mcap(tmp_path / 'copy')
    assert [each[1:] for each in saved if each[0] == TOPIC] == [message(k) for k in range(300)]
    assert len(saved) == 600


@pytest.mark.parametrize('mode', ['MESSAGE', 'FILE'])
def test_intact_messages_of_a_truncated_compressed_bag_are_read(tmp_path, mode):
    bag = write(tmp_path / 'bag', mode, 8000)
    (file,) = bag.glob('*.mcap*')
    data = file.read_bytes()
    file.write_bytes(data[: len(data) * 2 // 3])
    recorded = read_trajectory(bag)
    assert 2000 < len(recorded.trajectory) < 8000
    assert not recorded.closed
    file.write_bytes(data[:100])
    with pytest.raises(BagError, match=r'it is truncated or damaged.* copy it again from the recorder'):
        read_trajectory(bag)
