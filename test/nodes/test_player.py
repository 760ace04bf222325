# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

import signal
import struct
from dataclasses import replace

import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile
from rosbags.interfaces import QosDurability, QosLiveliness, QosTime
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, String

from pendubot_identification.model.parameters import PAPER
from pendubot_identification.model.simulation import simulate
from pendubot_identification.recordings.bag_writer import RELIABLE, BagWriter
from pendubot_identification.recordings.joint_states import (
    JOINT_STATE,
    decode_joint_state,
    encode_joint_state,
    write_trajectory,
)
from test.conftest import ROOT
from test.nodes.conftest import written
from test.processes import Program, parameters, spin_until
from test.recordings.independent import by_mcap

pytestmark = pytest.mark.ros

SAMPLE = ROOT / 'bags' / 'paper_experiment'
START = 1_700_000_000_000_000_000
MS = 1_000_000
FLOAT = 'std_msgs/msg/Float64'
TEXT = bytes([0, 1, 0, 0, 4, 0, 0, 0]) + b'abc\0'  #: A std_msgs/String.
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
def bag(tmp_path):
    """Two topics of 0.4 s in two files, one of them latched; a message of one between those of the other."""
    path = tmp_path / 'bag'
    path.mkdir()
    for part in range(2):
        with BagWriter(tmp_path / f'part{part}') as writer:
            states = writer.add_topic('/states', JOINT_STATE)
            latched = writer.add_topic('/latched', 'std_msgs/msg/String', LATCHED)
            for k in range(200 * part, 200 * part + 200):
                stamp = START + k * MS
                if k == 100:
                    writer.write(latched, TEXT, stamp)
                writer.write(states, encode_joint_state(stamp, ('a', 'b'), [k, 0], [], [0.5, 0]), stamp)
        writer.file.rename(path / f'bag_{part}.mcap')
    return path


def subscribe(node, topic):
    """What comes on /states or /latched, as bytes."""
    came = []
    latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    kind, qos = (JointState, 1000) if topic == '/states' else (String, latched)
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


def test_a_part_of_an_unclosed_bag_is_played_as_far_as_it_is_whole(bag, node):
    file = bag / 'bag_1.mcap'
    file.write_bytes(file.read_bytes()[:-3000])
    heard = subscribe(node, '/states')
    with player(f'{bag}@0.1:0.39', topics='[/states]') as program:
        program.wait_for('was never closed, or is truncated or damaged')
        assert spin_until(node, lambda: program.process.poll() is not None, 20.0)
        assert program.process.returncode == 0
    spin_until(node, lambda: False, 0.2)
    assert len(heard) > 100
    assert [int(decode_joint_state(data).position[0]) for data in heard] == list(range(100, 100 + len(heard)))


def test_the_pace_is_the_recordings_and_a_late_subscriber_hears_what_is_latched(bag, node):
    published = []
    node.create_subscription(JointState, '/states', lambda _, info: published.append(info['source_timestamp']), 1000)
    with player(f'{bag}@0.1:0.4', rate=0.02, wait=0.0) as program:
        assert spin_until(node, lambda: len(published) >= 20, 20.0)
        # However busy the machine: one may be late, but none too early.
        assert published[19] - published[0] > 900 * MS
        heard = subscribe(node, '/latched')
        assert spin_until(node, lambda: heard)
        assert heard == [TEXT]
        assert program.stop(signal.SIGTERM) == 0


def test_an_identified_rig_moves_beside_the_played_one_as_a_ghost(tmp_path, node):
    """By the recorded torque, from the recorded state on, for a second at a time."""

    def worst(parameters, bag=f'{SAMPLE}@0:3'):
        """Return the largest difference to the samples as played [rad] by joint."""
        found = {}, {}
        for topic, positions in zip(('joint_states', 'ghost/joint_states'), found, strict=True):
            node.create_subscription(
                JointState,
                f'/{topic}',
                lambda m, of=positions: of.update({(m.header.stamp.sec, m.header.stamp.nanosec): m.position[:2]}),
                1000,
            )
        ghost = written(tmp_path / 'rig.yaml', parameters)
        with player(bag, rate=2.0, topics='[/joint_states]', ghost=ghost) as program:
            assert spin_until(node, lambda: program.process.poll() == 0), program.output
        spin_until(node, lambda: len(found[1]) == len(found[0]), 1.0)
        played, simulated = found
        assert len(simulated) > 200
        return np.abs([np.subtract(q, played[stamp]) for stamp, q in simulated.items()]).max(axis=0)

    assert worst(PAPER).max() < 0.02
    t = np.arange(300) * 0.01
    write_trajectory(tmp_path / 'driven', simulate(PAPER, t, 0.002 * np.column_stack([0 * t, np.sin(5 * t)])))
    assert worst(PAPER, tmp_path / 'driven').max() < 0.002, 'the motor of the elbow, where there is one'
    assert worst(replace(PAPER, P4=2 * PAPER.P4)).max() > 0.05


def test_effort_commands_are_played_only_where_they_are_named_and_all_topics_within_the_namespace(tmp_path, node):
    """An armed rig would move; a bag of another rig is shown beside this one."""
    path = tmp_path / 'bag'
    with BagWriter(path) as writer:
        effort, other = (writer.add_topic(topic, FLOAT) for topic in (COMMAND, '/other'))
        for k in range(50):
            for topic in (effort, other):
                writer.write(topic, bytes([0, 1, 0, 0]) + struct.pack('<d', 1.0), START + 10 * k * MS)
        states = writer.add_topic('/states', JOINT_STATE)
        writer.write(states, encode_joint_state(START, ('a', 'b'), [0, 0], [], [0.5, 0]), START)
    came = {topic: [] for topic in (COMMAND, '/other', '/states', f'/lab1{COMMAND}', '/lab1/states')}
    for topic, messages in came.items():
        kind = JointState if topic.endswith('states') else Float64
        node.create_subscription(kind, topic, messages.append, 100, raw=True)

    def played(*words, **values):
        """Return how many messages came on each topic."""
        for messages in came.values():
            messages.clear()
        with Program('player', *parameters(bag=path, wait=10.0, **values), *words) as program:
            assert spin_until(node, lambda: program.process.poll() is not None, 20.0)
            assert program.process.returncode == 0, program.output
        spin_until(node, lambda: False, 0.2)
        return {topic: len(messages) for topic, messages in came.items() if messages}, program.output

    counts, output = played()
    assert counts == {'/states': 1}
    assert f'{COMMAND} would move an armed rig; name it in topics to play it' in output
    counts, _ = played('-r', '__ns:=/lab1', topics=f'[states, {COMMAND[1:]}]')
    assert counts == {'/lab1/states': 1, f'/lab1{COMMAND}': 50}
