# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

import signal
import struct

import pytest
from rclpy.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile
from rosbags.interfaces import QosDurability, QosLiveliness, QosTime
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from pendubot_identification.recordings.bag_metadata import RELIABLE
from pendubot_identification.recordings.bag_writer import BagWriter
from pendubot_identification.recordings.joint_states import JOINT_STATE, decode_joint_state, encode_joint_state
from test.recordings.independent import by_mcap

from ..processes import Program, parameters, spin_until

pytestmark = pytest.mark.ros

START = 1_700_000_000_000_000_000
MS = 1_000_000
FLOAT = 'std_msgs/msg/Float64'
COMMAND = '/pendubot/effort_command'
LATCHED = RELIABLE._replace(
    durability=QosDurability.TRANSIENT_LOCAL,
    depth=1,
    deadline=QosTime(7, 5),
    lifespan=QosTime(3600, 0),
    liveliness=QosLiveliness.MANUAL_BY_TOPIC,
    liveliness_lease_duration=QosTime(60, 0),
)


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
            latched = writer.add_topic('/latched', FLOAT, LATCHED)
            for k in range(200 * part, 200 * part + 200):
                stamp = START + k * MS
                if k == 100:
                    writer.write(latched, bytes([0, 1, 0, 0]) + struct.pack('<d', 4.5), stamp)
                writer.write(states, encode_joint_state(stamp, ('a', 'b'), [k, 0], [], [0.5, 0]), stamp)
        writer.file.rename(path / f'bag_{part}.mcap')
    return path


def subscribe(node, topic):
    """What comes on /states or /latched, as bytes."""
    came = []
    latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    kind, qos = (JointState, 1000) if topic == '/states' else (Float64, latched)
    node.create_subscription(kind, topic, came.append, qos, raw=True)
    return came


def player(bag, **values):
    return Program('player', *parameters(**{'bag': bag, 'wait': 10.0, **values}))


def test_everything_is_published_as_it_was_recorded(bag, node):
    heard = {topic: subscribe(node, topic) for topic in ('/states', '/latched')}
    with player(bag) as program:
        assert spin_until(node, lambda: sum(map(len, heard.values())) == 401, 20.0)
        (offered,) = (each.qos_profile for each in node.get_publishers_info_by_topic('/latched'))
        assert program.process.wait(10) == 0
        program.wait_for('401 messages played')
    assert offered.liveliness == LivelinessPolicy.MANUAL_BY_TOPIC
    durations = offered.deadline, offered.lifespan, offered.liveliness_lease_duration
    assert [each.nanoseconds for each in durations] == [7 * 10**9 + 5, 3600 * 10**9, 60 * 10**9]
    sent = by_mcap(bag)
    for topic, came in heard.items():
        assert came == [data for t, _, data in sent if t == topic]


def test_a_part_of_an_unclosed_bag_is_played_by_the_recordings_clock_as_far_as_it_is_whole(bag, node):
    file = bag / 'bag_1.mcap'
    file.write_bytes(file.read_bytes()[:-3000])
    clock, heard = [], subscribe(node, '/states')
    node.create_subscription(Clock, '/clock', lambda m: clock.append(m.clock.sec * 1000 * MS + m.clock.nanosec), 1000)
    with player(f'{bag}@0.1:0.39', clock=100.0, rate=0.2, topics='[/states]') as program:
        program.wait_for('was never closed, or is truncated or damaged')
        assert spin_until(node, lambda: program.process.poll() is not None, 20.0)
        assert program.process.returncode == 0
    spin_until(node, lambda: False, 0.2)
    assert len(heard) > 100
    assert [int(decode_joint_state(data).position[0]) for data in heard] == list(range(100, 100 + len(heard)))
    assert clock == sorted(clock)
    assert START + 99 * MS <= clock[0] < clock[-1] <= START + 400 * MS
    assert len(set(clock)) > 10


def test_the_pace_is_the_recordings_and_a_late_subscriber_hears_what_is_latched(bag, node):
    published = []
    node.create_subscription(JointState, '/states', lambda _, info: published.append(info['source_timestamp']), 1000)
    with player(f'{bag}@0.1:0.4', rate=0.02, wait=0.0) as program:
        assert spin_until(node, lambda: len(published) >= 20, 20.0)
        # However busy the machine: one may be late, but none too early.
        assert published[19] - published[0] > 900 * MS
        heard = subscribe(node, '/latched')
        assert spin_until(node, lambda: heard)
        assert heard[0][4:] == struct.pack('<d', 4.5)
        assert program.stop(signal.SIGTERM) == 0


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
    nodes = []

    def make(name, arms=False):
        nodes.append(ros.create_node(name))
        came = []
        nodes[-1].create_subscription(Float64, COMMAND, lambda m: came.append(m.data), 100)
        if arms:
            nodes[-1].create_service(Trigger, '~/arm', lambda _, answer: answer)
        return nodes[-1], came

    yield make
    for each in nodes:
        each.destroy_node()


def test_effort_commands_are_not_played_to_a_bridge_unless_that_is_asked_for(commands, listener):
    there, came = listener('left_rig', True)
    with player(commands) as program:
        program.wait_for(f'/left_rig obeys {COMMAND}, which this bag holds: an armed rig would move; stop the bridge')
        assert program.process.wait(10) == 1
    assert not spin_until(there, lambda: came, 0.2)
    with player(commands, topics=f'[{COMMAND}]') as program:
        assert spin_until(there, lambda: len(came) == 50, 20.0), program.output
        assert program.process.wait(10) == 0


def test_effort_commands_are_played_to_others_until_a_bridge_comes(commands, listener):
    there, came = listener('plotter')
    with player(commands, rate=0.02) as program:
        assert spin_until(there, lambda: came, 20.0), program.output
        bridge, obeyed = listener('bridge')
        program.wait_for('/bridge obeys')
        assert program.process.wait(10) == 1
    assert not spin_until(bridge, lambda: obeyed, 0.2)
