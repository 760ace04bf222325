# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

import signal
import struct

import pytest
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from pendubot_identification.recordings.bag_metadata import Qos
from pendubot_identification.recordings.bag_writer import BagWriter
from pendubot_identification.recordings.joint_states import JOINT_STATE, decode_joint_state, encode_joint_state
from test.recordings.independent import by_mcap

from ..faults.recorder import recorded, recorder, wait
from ..processes import Program, parameters, run_program, spin_until

pytestmark = pytest.mark.ros

START = 1_700_000_000_000_000_000
MS = 1_000_000
FLOAT = 'std_msgs/msg/Float64'
COMMAND = '/pendubot/effort_command'


@pytest.fixture
def node(ros):
    node = ros.create_node('player_test')
    yield node
    node.destroy_node()


@pytest.fixture
def bag(tmp_path):
    """Two topics of 0.4 s in two files, one of them latched; a message of one between those of the other."""
    path = tmp_path / 'bag'
    path.mkdir()
    for part in range(2):
        with BagWriter(tmp_path / f'part{part}') as writer:
            states = writer.add_topic('/states', JOINT_STATE)
            latched = writer.add_topic('/latched', FLOAT, Qos(durability='transient_local', depth=1))
            for k in range(200 * part, 200 * part + 200):
                stamp = START + k * MS
                if k == 100:
                    writer.write(latched, bytes([0, 1, 0, 0]) + struct.pack('<d', 4.5), stamp)
                writer.write(states, encode_joint_state(stamp, ('a', 'b'), [k, 0], [], [0.5, 0]), stamp)
        writer.file.rename(path / f'bag_{part}.mcap')
    return path


@pytest.fixture
def heard(node):
    """What comes on /states and /latched: (topic, bytes)."""
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64

    came = []
    latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    for topic, kind, qos in (('/states', JointState, 1000), ('/latched', Float64, latched)):
        node.create_subscription(kind, topic, lambda data, topic=topic: came.append((topic, data)), qos, raw=True)
    return came


def player(bag, **values):
    return Program('player', *parameters(**{'bag': bag, 'wait': 10.0, **values}))


def numbers(came):
    """The first joint's position of every joint state."""
    return [int(decode_joint_state(data).position[0]) for topic, data in came if topic == '/states']


def test_everything_is_published_as_it_was_recorded(bag, node, heard):
    with player(bag) as program:
        assert spin_until(node, lambda: len(heard) == 401, 20.0)
        assert program.process.wait(10) == 0
        program.wait_for('401 messages played')
    sent = [(topic, data) for topic, _, data in by_mcap(bag)]
    for topic in ('/states', '/latched'):
        assert [data for t, data in heard if t == topic] == [data for t, data in sent if t == topic]


@pytest.mark.parametrize('mode', ['MESSAGE', 'FILE'])
def test_a_bag_that_rosbag2_compressed_is_played(tmp_path, node, heard, mode):
    store = get_typestore(Stores.ROS2_JAZZY)
    writer = Writer(tmp_path / 'bag', version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode[mode], CompressionFormat.ZSTD)
    sent = [encode_joint_state(START + k * MS, ('a', 'b'), [k, 0], [], [0.5, 0]) for k in range(100)]
    with writer:
        states = writer.add_connection('/states', JOINT_STATE, typestore=store)
        for k, data in enumerate(sent):
            writer.write(states, START + k * MS, data)
    with player(tmp_path / 'bag') as program:
        assert spin_until(node, lambda: len(heard) == 100, 20.0), program.output
        assert program.process.wait(10) == 0
    assert [data for _, data in heard] == sent


def test_a_part_is_played(bag, node, heard):
    with player(f'{bag}@0.1:0.25', topics='[/states]') as program:
        assert spin_until(node, lambda: len(heard) >= 150, 20.0)
        assert program.process.wait(10) == 0
    assert numbers(heard) == [*range(100, 250)]


def test_the_clock_is_the_recordings(bag, node, heard):
    from rosgraph_msgs.msg import Clock

    clock = []
    node.create_subscription(Clock, '/clock', lambda m: clock.append(m.clock.sec * 1000 * MS + m.clock.nanosec), 1000)
    with player(bag, clock=100.0, rate=0.1, topics='[/states]') as program:
        assert spin_until(node, lambda: len(heard) == 400, 30.0)
        assert program.process.wait(10) == 0
    assert clock == sorted(clock)
    assert START <= clock[0] < clock[-1] <= START + 400 * MS
    assert len(set(clock)) > 10


def test_the_pace_is_the_recordings(bag, node):
    from sensor_msgs.msg import JointState

    published = []
    node.create_subscription(JointState, '/states', lambda _, info: published.append(info['source_timestamp']), 1000)
    with player(bag, rate=0.02, topics='[/states]') as program:
        assert spin_until(node, lambda: len(published) >= 20, 20.0)
        # However busy the machine: one may be late, but none too early.
        assert published[19] - published[0] > 900 * MS
        assert program.stop(signal.SIGTERM) == 0


def test_what_is_played_can_be_recorded_again(bag, tmp_path):
    copy = tmp_path / 'copy'
    with recorder(copy, '/states', '/latched') as program, player(bag) as played:
        assert played.process.wait(30) == 0
        wait(lambda: recorded(copy) == 401)
        assert program.stop() == 0
    for topic in ('/states', '/latched'):
        assert [d for t, _, d in by_mcap(copy) if t == topic] == [d for t, _, d in by_mcap(bag) if t == topic]


def test_a_late_subscriber_hears_what_is_latched(bag, node):
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from std_msgs.msg import Float64

    came = []
    with player(bag, wait=0.0, rate=0.02) as program:
        program.wait_for('playing')
        qos = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        node.create_subscription(Float64, '/latched', lambda m: came.append(m.data), qos)
        assert spin_until(node, lambda: 4.5 in came)
        assert program.stop() == 0


def test_an_unclosed_bag_is_played_as_far_as_it_is_whole(bag, node, heard):
    file = bag / 'bag_1.mcap'
    file.write_bytes(file.read_bytes()[:-3000])
    with player(bag, topics='[/states]', rate=10.0) as program:
        program.wait_for('was never closed, or is cut or damaged')
        assert program.process.wait(20) == 0
    assert spin_until(node, lambda: len(heard) > 200)
    assert numbers(heard) == list(range(len(heard)))


def test_damage_in_a_closed_bag_is_one_sentence(bag):
    file = bag / 'bag_0.mcap'
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(data)
    ended = run_program('player', *parameters(bag=bag, rate=100.0))
    assert ended.returncode == 1
    assert 'is damaged' in ended.stderr
    assert 'Traceback' not in ended.stderr


@pytest.fixture
def commands(tmp_path):
    """Half a second of effort commands."""
    path = tmp_path / 'commands'
    with BagWriter(path) as writer:
        effort = writer.add_topic(COMMAND, FLOAT)
        for k in range(50):
            writer.write(effort, bytes([0, 1, 0, 0]) + struct.pack('<d', 1.0), START + 10 * k * MS)
    return path


@pytest.fixture
def listener(ros):
    """Makes nodes that listen to effort commands, some of which arm; what comes is in their list."""
    from std_msgs.msg import Float64
    from std_srvs.srv import Trigger

    nodes = []

    def make(name, arms):
        nodes.append(ros.create_node(name))
        came = []
        nodes[-1].create_subscription(Float64, COMMAND, lambda m: came.append(m.data), 100)
        if arms:
            nodes[-1].create_service(Trigger, '~/arm', lambda _, answer: answer)
        return nodes[-1], came

    yield make
    for each in nodes:
        each.destroy_node()


@pytest.mark.parametrize(('name', 'arms'), [('bridge', False), ('left_rig', True)])
def test_effort_commands_are_not_played_to_a_bridge(commands, listener, name, arms):
    there, came = listener(name, arms)
    with player(commands) as program:
        program.wait_for(f'/{name} obeys {COMMAND}, which this bag holds: an armed rig would move; stop the bridge')
        assert program.process.wait(10) == 1
    assert not spin_until(there, lambda: came, 0.2)


def test_effort_commands_end_when_a_bridge_comes(commands, listener):
    with player(commands, wait=0.0, rate=0.02) as program:
        program.wait_for('playing')
        there, came = listener('bridge', True)
        program.wait_for('/bridge obeys')
        assert program.process.wait(10) == 1
    assert not spin_until(there, lambda: came, 0.2)


@pytest.mark.parametrize(('name', 'values'), [('plotter', {}), ('bridge', {'topics': f'[{COMMAND}]'})])
def test_effort_commands_are_played_to_others_and_where_asked_for(commands, listener, name, values):
    there, came = listener(name, False)
    with player(commands, **values) as program:
        assert spin_until(there, lambda: len(came) == 50, 20.0), program.output
        assert program.process.wait(10) == 0


@pytest.mark.parametrize(
    ('values', 'sentence'),
    [
        ({'bag': "''"}, 'bag is empty; give the folder of a bag'),
        ({'bag': '/nowhere'}, 'there is no bag /nowhere'),
        ({'bag': '{bag}@5:6'}, '@5:6: the bag lasts 0.399 s; give a START within it'),
        ({'bag': '{bag}@5'}, 'names no window of a bag'),
        ({'topics': '[/other]'}, 'holds nothing on /other; its topics are /latched, /states'),
        ({'topics': '["two words"]'}, 'a name such as joint_states is expected'),
        ({'rate': 0.0}, 'rate is 0.0; a number with a decimal point from 0.001 to 1000 is expected'),
    ],
)
def test_settings_that_make_no_sense_are_one_sentence(bag, values, sentence):
    values = {'bag': bag, **values}
    ended = run_program('player', *parameters(**values | {'bag': str(values['bag']).format(bag=bag)}))
    assert ended.returncode == 1
    assert sentence in ended.stderr
    assert len(ended.stderr.splitlines()) == 1
