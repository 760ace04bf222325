# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

import os
from collections import deque
from itertools import count

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from pendubot_identification.errors import BagError
from pendubot_identification.recordings import bag_writer
from pendubot_identification.recordings.bag_reader import BagReader, read_trajectory
from pendubot_identification.recordings.bag_writer import RELIABLE, BagWriter, complete_bag, offered_profiles
from pendubot_identification.recordings.joint_states import JOINT_STATE, write_trajectory
from pendubot_identification.recordings.message_types import message_definition
from pendubot_identification.trajectories.trajectory import Trajectory
from test.cli.conftest import contents
from test.processes import small_disk

from .bags import START, STEP, TOPIC, log, message
from .independent import by_mcap, by_rosbags


def write(path):
    with BagWriter(path) as bag:
        log(bag, 100)
    return path


def test_rosbags_and_mcap_read_back_every_message(tmp_path):
    path = write(tmp_path / 'bag')
    assert by_rosbags(path) == by_mcap(path) == [(TOPIC, *message(k)) for k in range(100)]
    text, type_hash = message_definition(JOINT_STATE)
    with Reader(path) as reader:
        (connection,) = reader.connections
        assert (reader.start_time, reader.end_time) == (START, START + 99 * STEP + 1)
    assert connection.msgtype == JOINT_STATE
    assert connection.msgdef.data == text
    assert 'MSG: std_msgs/Header' in text
    with (path / 'bag_0.mcap').open('rb') as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == 'ros2'
        schema, channel, first = next(reader.iter_messages())
    assert (schema.name, schema.encoding, channel.message_encoding) == (JOINT_STATE, 'ros2msg', 'cdr')
    assert channel.metadata['topic_type_hash'] == type_hash == connection.digest
    assert offered_profiles(channel.metadata['offered_qos_profiles']) == [RELIABLE]
    assert (first.log_time, first.publish_time, first.sequence) == (START, START - 1000, 1)


def test_the_metadata_has_the_structure_of_rosbags(tmp_path):
    def shape(node):
        if isinstance(node, dict):
            return {key: shape(value) for key, value in node.items()}
        return [shape(entry) for entry in node] if isinstance(node, list) else None

    path = write(tmp_path / 'bag')
    store = get_typestore(Stores.ROS2_JAZZY)
    with Writer(tmp_path / 'other', version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        other = writer.add_connection(TOPIC, JOINT_STATE, typestore=store, offered_qos_profiles=[RELIABLE])
        for k in range(100):
            writer.write(other, *message(k))
    ours, theirs = (
        yaml.safe_load((bag / 'metadata.yaml').read_text())['rosbag2_bagfile_information']
        for bag in (path, tmp_path / 'other')
    )
    assert shape(ours) == shape(theirs)
    for key in ('version', 'storage_identifier', 'message_count', 'starting_time', 'topics_with_message_count'):
        assert ours[key] == theirs[key]
    # Not every reader supports anchors of YAML.
    assert '&' not in (path / 'metadata.yaml').read_text()
    with (path / 'bag_0.mcap').open('rb') as file:
        (copy,) = make_reader(file).iter_metadata()
    assert yaml.safe_load(copy.metadata['serialized_metadata']) == ours


@pytest.mark.parametrize(
    'make',
    [
        lambda path: path.write_text('mine'),
        lambda path: path.mkdir(),
        lambda path: (path.mkdir(), (path / 'notes.txt').write_text('mine')),
        lambda path: (write(path), (path / 'notes.txt').write_text('mine')),
    ],
    ids=['file', 'empty folder', 'folder', 'bag and more'],
)
def test_only_bags_are_overwritten(tmp_path, make):
    path = tmp_path / 'taken'
    make(path)
    before = contents(tmp_path)
    for overwrite in (False, True):
        with pytest.raises(BagError, match=r'give another name'), complete_bag(path, overwrite=overwrite):
            pass
    with pytest.raises(BagError, match=r'give another name'):
        BagWriter(path)
    assert contents(tmp_path) == before


def test_the_bag_behind_a_link_is_overwritten(tmp_path):
    write(tmp_path / 'bag')
    (tmp_path / 'latest').symlink_to('bag')
    with complete_bag(tmp_path / 'latest', overwrite=True) as bag:
        log(bag, 5)
    assert (tmp_path / 'latest').is_symlink()
    assert BagReader(tmp_path / 'bag').count == 5
    assert [path.name for path in tmp_path.iterdir() if 'partial' in path.name] == []


def test_a_full_disk_is_reported_in_one_sentence_and_leaves_complete_chunks(tmp_path, monkeypatch):
    """A limit of the file size stands for the full disk; the test of the recorder fills a disk."""
    monkeypatch.setattr(bag_writer, '_shortage', lambda *_: '')
    bag, numbers = BagWriter(tmp_path / 'bag'), count()
    channel = bag.add_topic(TOPIC, JOINT_STATE)
    with small_disk(100_000), pytest.raises(BagError, match=r'cannot be written \(File too large\); free some space'):
        deque((bag.write(channel, *message(k)[::-1]) for k in numbers), maxlen=0)
    with pytest.raises(BagError, match='cannot be written'):
        bag.write(channel, message(0)[1], START)
    bag.close()
    reader = BagReader(tmp_path / 'bag')
    sent = next(numbers)
    # A chunk has 64 kB.
    assert sent - 500 <= reader.count <= sent
    assert sum(map(len, reader.files[0].scan())) == reader.count
    assert reader.files[0].damages == [], 'no incomplete chunk at the end'


def test_the_removal_of_the_file_is_reported_at_once(tmp_path):
    bag = BagWriter(tmp_path / 'bag')
    bag.flush()
    bag.file.unlink()
    with pytest.raises(BagError, match=r'cannot be written \(No such file'):
        bag.flush()


@pytest.mark.parametrize('velocities', [True, False])
def test_a_written_trajectory_is_read_back(tmp_path, velocities):
    t = np.arange(100) * 0.01
    q = np.column_stack([np.sin(t), np.cos(3 * t)])
    trajectory = Trajectory(t=t, q=q, tau=0.5 * q, qd=2 * q if velocities else None)
    for folder in ('one', 'two'):
        write_trajectory(tmp_path / folder / 'bag', trajectory)
    assert contents(tmp_path / 'one') == contents(tmp_path / 'two')
    back = read_trajectory(tmp_path / 'one' / 'bag').trajectory
    np.testing.assert_allclose(back.t, trajectory.t, rtol=0, atol=0.5e-9)
    for name in ('q', 'qd', 'tau'):
        np.testing.assert_array_equal(getattr(back, name), getattr(trajectory, name))


def test_a_message_type_of_a_workspace_is_found_with_its_dependencies(tmp_path, monkeypatch):
    folder = tmp_path / 'share' / 'rig_msgs' / 'msg'
    folder.mkdir(parents=True)
    (folder / 'Phase.msg').write_text('float64 current  # A\n')
    (folder / 'Motor.msg').write_text('std_msgs/Header header\nPhase[3] phases\nPhase[] more\nrig_msgs/Phase one\n')
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path))
    text, type_hash = message_definition('rig_msgs/msg/Motor')
    assert 'MSG: rig_msgs/Phase\nfloat64 current' in text
    assert 'MSG: builtin_interfaces/Time' in text
    assert type_hash.startswith('RIHS01_')


@pytest.mark.parametrize(
    ('name', 'sentence'),
    [
        ('absent_msgs/msg/Thing', 'is not installed'),
        *((name, 'is no message type') for name in ('Thing', 'a/srv/B', 'a/msg/../B')),
    ],
)
def test_an_unknown_message_type_is_refused_in_one_sentence(name, sentence):
    with pytest.raises(BagError, match=sentence):
        message_definition(name)


def test_sync_and_close_write_the_file_to_the_disk(tmp_path, monkeypatch):
    synced = []
    fsync = os.fsync
    monkeypatch.setattr(os, 'fsync', lambda fd: synced.append(os.readlink(f'/proc/self/fd/{fd}')) or fsync(fd))
    bag = BagWriter(tmp_path / 'bag')
    folder = str(tmp_path / 'bag')
    # metadata.yaml under its temporary name, its folder, and the parent folder.
    listed = [f'{folder}/metadata.yaml.tmp', folder]
    assert synced == [*listed, str(tmp_path)]
    channel = bag.add_topic(TOPIC, JOINT_STATE)
    bag.write(channel, message(0)[1], START)
    for action, expected in (
        (bag.sync, [f'{folder}/bag_0.mcap', *listed]),
        (bag.sync, [f'{folder}/bag_0.mcap']),
        (lambda: bag.write(channel, message(1)[1], START), []),
        (bag.close, [f'{folder}/bag_0.mcap', *listed]),
    ):
        synced.clear()
        action()
        assert synced == expected
