# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

import hashlib
import shutil
from dataclasses import replace
from itertools import chain
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType
from rosbags.convert import convert
from rosbags.typesys import Stores, get_typestore

from pendubot_identification.cli.main import main
from pendubot_identification.errors import BagError, TrajectoryError
from pendubot_identification.recordings import mcap_file
from pendubot_identification.recordings.bag_reader import (
    BagReader,
    BagWindow,
    open_recording,
    read_trajectory,
    stream_samples,
)
from pendubot_identification.recordings.bag_writer import BagWriter
from pendubot_identification.recordings.joint_states import JOINT_STATE, encode_joint_state, write_trajectory
from pendubot_identification.trajectories.conversion import Conversion
from test.conftest import SAMPLE

from .bags import FLOAT, START, STEP, TOPIC, foreign, message, samples, write
from .damage import flip


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    return write(tmp_path_factory.mktemp('of the rig@5') / 'bag', samples())


def test_the_name_of_a_folder_above_a_missing_bag_may_contain_an_at_sign():
    assert BagWindow.parse('me@home/run') == BagWindow(Path('me@home/run'))
    assert BagWindow.parse('me@home/run@1:2') == BagWindow(Path('me@home/run'), 1, 2)
    assert BagWindow.named('me@home/run@3.csv') == BagWindow(Path('me@home/run@3.csv'))
    assert BagWindow.named('bag@1:') == BagWindow(Path('bag'), 1)


@pytest.mark.parametrize(
    'window', ['', '5', '1:2:3', 'one:2', '3:3', '4:3', '-1:3', ':-1', 'nan:3', '1:nan', 'inf:', ':inf']
)
def test_a_malformed_window_is_refused_in_one_sentence(window):
    with pytest.raises(BagError, match=f'bag@{window}.* names no window'):
        BagWindow.parse(f'bag@{window}')


def test_a_bag_and_its_file_give_the_same_motion_and_counts(bag):
    reader = BagReader(bag)
    assert reader.topics == {TOPIC: (JOINT_STATE, 1000)}
    assert (reader.closed, reader.note, reader.count, reader.duration) == (True, '', 1000, 9.99)
    assert reader.first_ns == START + 3_000_000
    for path in (bag, bag / 'bag_0.mcap'):
        recorded = read_trajectory(path)
        assert recorded.closed
        assert recorded.sha256 == hashlib.sha256((bag / 'bag_0.mcap').read_bytes()).hexdigest()
        assert recorded.trajectory.name == str(path)
        np.testing.assert_array_equal(recorded.trajectory.t, np.arange(1000) * STEP / 1e9)
        for name, expected in (('q', [0.007, -0.007]), ('tau', [7, 0]), ('qd', [0.1, -0.1])):
            np.testing.assert_array_equal(getattr(recorded.trajectory, name)[7], expected)


@pytest.mark.parametrize(
    ('text', 'first', 'last'),
    [
        *(('@0:9', 0, 899), ('@9:', 900, 999), ('@:0.5', 0, 49), ('@2.005:3.005', 201, 300), ('@5:100', 500, 999)),
        *(('@:', 0, 999), ('', 0, 999)),
    ],
)
def test_a_window_is_relative_to_the_first_sample_of_the_bag(bag, text, first, last):
    window = BagWindow.parse(f'{bag}{text}')
    assert BagWindow.parse(str(window)) == window
    trajectory = read_trajectory(window).trajectory
    np.testing.assert_array_equal(trajectory.tau[[0, -1], 0], [first, last])
    np.testing.assert_array_equal(trajectory.t[[0, -1]], [first * STEP / 1e9, last * STEP / 1e9])


def test_windows_of_stamps_are_found_although_the_log_clock_jumps(tmp_path):
    # From 3 s on, the log clock is 30 s ahead, so that the index is misleading.
    path = write(tmp_path / 'bag', samples(), logged=lambda k: START + k * STEP + 30 * 10**9 * (k >= 300))
    trajectory = read_trajectory(BagWindow(path, 2, 6)).trajectory
    np.testing.assert_array_equal(trajectory.tau[[0, -1], 0], [200, 599])


def test_any_two_joints_of_any_topic_and_a_measured_current_may_be_selected(tmp_path):
    """The bridge records the current beside the commanded torque."""
    entries = {
        'names': lambda k: ('gripper', 'elbow', 'elbow_current'),
        'position': lambda k: (0, k, 0),
        'velocity': lambda k: (),
        'effort': lambda k: (k, 9, 2 * k),
    }
    path, selected = write(tmp_path / 'bag', samples(100, **entries), topic='/rig/joints'), ('elbow', 'gripper')
    commanded = read_trajectory(path, Conversion(topic='/rig/joints', joints=selected)).trajectory
    np.testing.assert_array_equal(commanded.q, np.outer(np.arange(100), [1, 0]))
    np.testing.assert_array_equal(commanded.tau, [(9, k) for k in range(100)])
    conversion = Conversion(topic='/rig/joints', joints=selected, torque_constant=0.05, gear=7.0)
    np.testing.assert_allclose(read_trajectory(path, conversion).trajectory.tau[:, 0], 0.7 * np.arange(100))


def test_the_files_of_a_split_bag_are_read_in_order(tmp_path):
    path = tmp_path / 'bag'
    path.mkdir()
    for k in range(12):
        foreign(path / f'bag_{k}.mcap', map(message, range(10 * k, 10 * k + 10)))
    np.testing.assert_array_equal(read_trajectory(path).trajectory.tau[:, 0], np.arange(120))


@settings(max_examples=50)
@given(
    st.lists(st.integers(0, 60), min_size=10, max_size=60) | st.lists(st.integers(0, 60), min_size=10).map(sorted),
    st.just([0, 61]) | st.tuples(st.integers(0, 60), st.integers(0, 60)).map(sorted),
    st.sampled_from([1, 1500]),
    st.booleans(),
)
def test_messages_of_a_window_are_read_in_the_order_of_writing(tmp_path_factory, numbers, window, block, closed):
    """The threads of a recorder write messages out of order, also into later chunks."""
    file = tmp_path_factory.getbasetemp() / 'unordered.mcap'
    unclosed = foreign(file, [(message(n)[0], message(k)[1]) for k, n in enumerate(numbers)], chunk_size=500)
    with file.open('rb') as stream:
        start, end = (START + bound * STEP for bound in window)
        expected = make_reader(stream).iter_messages(starting_at=start, ending_before=end, log_time_order=False)
        expected = [(each.log_time, each.data) for _, _, each in expected]
    if not closed:
        file.write_bytes(unclosed)
    with mock.patch.object(mcap_file, 'BLOCK', block):
        messages = chain.from_iterable(mcap_file.McapFile(file).messages([TOPIC], start, end))
        found = [(each.log_time, each.data) for each in messages]
    assert found == expected


@pytest.mark.parametrize('closed', [True, False])
@pytest.mark.parametrize(
    'options',
    [
        {'compression': CompressionType.ZSTD},
        {'compression': CompressionType.LZ4},
        {'compression': CompressionType.NONE, 'enable_crcs': False},
        {'use_chunking': False},
        {'use_statistics': False, 'repeat_channels': False, 'use_summary_offsets': False},
        {'repeat_channels': False},
        {'repeat_schemas': False},
    ],
    ids=['zstd', 'lz4', 'no checksums', 'no chunks', 'no index', 'no channels', 'no schemas'],
)
def test_files_of_other_writers_are_read(tmp_path, options, closed):
    file = tmp_path / 'other.mcap'
    unfinished = foreign(file, map(message, range(300)), **options)
    if not closed:
        file.write_bytes(unfinished)
    recorded = read_trajectory(BagWindow(file, 0.5, 2))
    assert recorded.closed == closed
    np.testing.assert_array_equal(recorded.trajectory.t, np.arange(50, 200) * STEP / 1e9)
    np.testing.assert_array_equal(recorded.trajectory.tau[:, 0], np.arange(50, 200))


def test_messages_are_found_despite_a_damaged_index(bag, tmp_path):
    path = shutil.copytree(bag, tmp_path / 'bag')
    flip(path / 'bag_0.mcap', -300)  # near the end
    read = read_trajectory(BagWindow(path, 0, 9.99))
    assert len(read.trajectory) == 999
    assert not read.closed
    assert 'damaged' in read.note


def test_damage_in_a_closed_file_is_reported_and_a_window_can_avoid_it(bag, tmp_path):
    path = shutil.copytree(bag, tmp_path / 'bag')
    flip(path / 'bag_0.mcap', (path / 'bag_0.mcap').read_bytes().index(encode_joint_state(*samples()[500])) + 60)
    with pytest.raises(BagError, match=r'is damaged \d+ bytes from its start, 5\.\d+ s after its first message'):
        read_trajectory(path)
    assert len(read_trajectory(BagWindow(path, 0, 3)).trajectory) == 300


NO_BAG = 'is no bag with messages of type sensor_msgs/msg/JointState that can be read'


@pytest.mark.parametrize(
    ('name', 'content', 'sentence'),
    [
        ('', b'', r'holds no \.mcap or \.db3 file; name the folder that holds one, or a \.bag file'),
        ('bag.mcap', b'', 'is empty'),
        ('bag.mcap', b't,q1,q2\n1,2,3', 'is no MCAP file'),
        ('run.dat', b't,q1,q2\n1,2,3', r'or a file with columns and a name in \.csv, \.txt'),
        ('bag.db3', b'hello', NO_BAG),
        ('bag.bag', b'hello', NO_BAG),
    ],
)
def test_a_path_without_a_bag_is_refused_in_one_sentence(tmp_path, name, content, sentence):
    if name:
        (tmp_path / name).write_bytes(content)
    for path, expected in ((tmp_path / name, sentence), (tmp_path / 'absent', 'there is no bag .*absent')):
        with pytest.raises(BagError, match=expected):
            read_trajectory(path)


def test_a_missing_topic_and_a_topic_of_another_type_are_refused_in_one_sentence(tmp_path):
    write(tmp_path / 'empty', [])
    assert BagReader(tmp_path / 'empty').closed
    with BagWriter(tmp_path / 'bag') as bag:
        bag.write(bag.add_topic('/effort', 'std_msgs/msg/Float64'), FLOAT + bytes(8), START)
    with BagWriter(tmp_path / 'arm') as bag:
        bag.write(bag.add_topic('/arm/states', JOINT_STATE), bytes(8), START)
    others = '; its topics are /effort: record the joint states, too'
    for name, topic, sentence in (
        ('empty', TOPIC, 'it is empty: record again'),
        ('arm', TOPIC, f'on {TOPIC}; add --topic /arm/states$'),
        ('arm', '/arm/states', 'arm: /arm/states, sample 0 is no sensor_msgs/msg/JointState'),
        *(('bag', each, f'holds no sensor_msgs/msg/JointState on {each}{others}') for each in (TOPIC, '/effort')),
    ):
        with pytest.raises(BagError, match=sentence):
            read_trajectory(tmp_path / name, Conversion(topic=topic))


def test_samples_that_repeat_the_previous_stamp_are_dropped_and_counted(tmp_path):
    path = write(tmp_path / 'bag', samples(100, stamp=lambda k: START + (k - (k in (40, 70))) * STEP))
    recorded = read_trajectory(path)
    np.testing.assert_array_equal(recorded.trajectory.tau[[39, 40, 97], 0], [39, 41, 99])
    assert recorded.note == f'{path}: 2 of 100 samples repeat the time before; they were left out'


@pytest.mark.parametrize(
    ('changed', 'error', 'sentence'),
    [
        ({'names': lambda k: ('a', 'b')}, BagError, "no joint 'shoulder'; its joints are a, b"),
        ({'effort': lambda k: (1,) if k == 70 else (1, 2)}, BagError, 'sample 70 has 1 efforts for 2 joints'),
        ({'position': lambda k: ()}, BagError, 'has 0 positions for 2 joints'),
        ({'effort': lambda k: (1, np.nan)}, TrajectoryError, '100 of 100 samples hold a tau .*; record it for both'),
        ({'stamp': lambda k: START + (k - 2 * (k == 60)) * STEP}, TrajectoryError, 'runs backwards by 0.01 s'),
        ({'stamp': lambda k: 0}, TrajectoryError, 'sample 1 repeats'),
    ],
)
def test_invalid_samples_are_refused_in_one_sentence(tmp_path, changed, error, sentence):
    path = write(tmp_path / 'bag', samples(100, **changed))
    with pytest.raises(error, match=sentence):
        read_trajectory(path)


@pytest.mark.parametrize(
    ('name', 'version', 'store'), [('run.bag', 3, Stores.ROS1_NOETIC), ('run', 8, Stores.ROS2_JAZZY)]
)
def test_a_converted_bag_gives_the_same_motion(tmp_path, capsys, name, version, store):
    """Also without the metadata.yaml that a recorder writes when it closes a bag. A repair would lose other topics."""
    stores = get_typestore(Stores.ROS2_JAZZY), get_typestore(store)
    convert([SAMPLE], tmp_path / name, 'sqlite3', version, None, 'none', *stores, [], [], [], [])
    expected = read_trajectory(SAMPLE).trajectory
    for _ in range(2):
        found = read_trajectory(tmp_path / name).trajectory
        for field in ('t', 'q', 'tau'):
            np.testing.assert_array_equal(getattr(found, field), getattr(expected, field))
        (tmp_path / 'run' / 'metadata.yaml').unlink(missing_ok=True)
    assert main(['info', str(tmp_path / name)]) == 0
    assert 'only its messages of type sensor_msgs/msg/JointState are read' in capsys.readouterr().out
    assert main(['repair', str(tmp_path / name)]) == 1
    assert 'only .mcap files can be repaired: use rosbag' in capsys.readouterr().err


@pytest.mark.parametrize('conversion', [Conversion(unwrap=True), Conversion(unwrap=True, degrees=True)])
def test_wrapped_angles_are_unwrapped_in_files_and_streams(tmp_path, conversion):
    expected = read_trajectory(SAMPLE).trajectory
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


def test_a_missing_angle_leaves_the_unwrapped_angles_after_it(tmp_path):
    angles = 0.05 * np.arange(300)
    shown = np.where(np.arange(300) == 40, np.nan, angles % (2 * np.pi))
    conversion = Conversion(unwrap=True)
    path = write(tmp_path / 'bag', samples(300, position=lambda k: (shown[k], 0.0)))
    rows = np.concatenate([*stream_samples(BagReader(path), BagWindow(path), conversion)])
    np.testing.assert_allclose(rows[:, 1], np.where(np.arange(300) == 40, np.nan, angles))
    with pytest.raises(TrajectoryError, match='1 of 300 samples hold a q that is not a number below'):
        read_trajectory(path, conversion)
