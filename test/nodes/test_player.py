# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

import math
import signal
import struct
from dataclasses import replace

import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, String

from pendubot_identification.model.parameters import PAPER
from pendubot_identification.model.simulation import simulate
from pendubot_identification.recordings.bag_writer import BagWriter
from pendubot_identification.recordings.joint_states import JOINT_STATE, encode_joint_state, write_trajectory
from test.conftest import SAMPLE
from test.identified import written
from test.processes import Program, parameters, spin_until
from test.recordings.bags import LATCHED, START, samples, write
from test.recordings.independent import by_mcap

MS = 1_000_000
FLOAT = 'std_msgs/msg/Float64'
TEXT = bytes([0, 1, 0, 0, 4, 0, 0, 0]) + b'abc\0'  #: A std_msgs/String.
COMMAND = '/pendubot/effort_command'


@pytest.fixture
def bag(tmp_path):
    """A bag of 0.4 s in two files, with one latched message among the joint states."""
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
    """Return a growing list of the serialized messages on /states or /latched."""
    received = []
    latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    kind, qos = (JointState, 1000) if topic == '/states' else (String, latched)
    node.create_subscription(kind, topic, received.append, qos, raw=True)
    return received


def player(bag, **values):
    return Program('player', *parameters(**{'bag': bag, 'wait': 10.0, **values}))


def test_the_messages_of_a_window_are_played_as_recorded(bag, node):
    received = {topic: subscribe(node, topic) for topic in ('/states', '/latched')}
    with player(f'{bag}@0.1:0.39') as program:
        assert spin_until(node, lambda: sum(map(len, received.values())) == 291, 20.0)
        assert program.process.wait(10) == 0
        program.wait_for('291 messages played')
    sent = [each for each in by_mcap(bag) if 100 * MS <= each[1] - START < 390 * MS]
    for topic, messages in received.items():
        assert messages == [data for t, _, data in sent if t == topic]


def test_messages_are_played_at_the_recorded_rate_and_latched_ones_reach_late_subscribers(bag, node):
    published = []
    node.create_subscription(JointState, '/states', lambda _, info: published.append(info['source_timestamp']), 1000)
    with player(f'{bag}@0.1:0.4', rate=0.02, wait=0.0) as program:
        assert spin_until(node, lambda: len(published) >= 20, 20.0)
        # A message may be late on a busy machine, but never early.
        assert published[19] - published[0] > 900 * MS
        latched = subscribe(node, '/latched')
        assert spin_until(node, lambda: latched)
        assert latched == [TEXT]
        assert program.stop(signal.SIGTERM) == 0


def test_a_ghost_simulates_the_identified_rig_beside_the_recording(tmp_path, node):

    def worst(parameters, bag=f'{SAMPLE}@0:3'):
        """Return the largest difference to the samples as played [rad] by joint."""
        received = {}, {}
        for topic, positions in zip(('joint_states', 'ghost/joint_states'), received, strict=True):
            node.create_subscription(
                JointState,
                f'/{topic}',
                lambda m, of=positions: of.update({(m.header.stamp.sec, m.header.stamp.nanosec): m.position[:2]}),
                1000,
            )
        ghost = written(tmp_path / 'rig.yaml', parameters)
        with player(bag, rate=2.0, topics='[/joint_states]', ghost=ghost) as program:
            assert spin_until(node, lambda: program.process.poll() == 0), program.output
        spin_until(node, lambda: len(received[1]) == len(received[0]), 1.0)
        played, simulated = received
        assert len(simulated) > 200
        return np.abs([np.subtract(q, played[stamp]) for stamp, q in simulated.items()]).max(axis=0)

    assert worst(PAPER).max() < 0.02
    # Another rig, with a torque at its elbow.
    other, t = replace(PAPER, P4=2 * PAPER.P4), np.arange(300) * 0.01
    driven = simulate(other, t, 0.002 * np.column_stack([0 * t, np.sin(5 * t)]))
    write_trajectory(tmp_path / 'driven', driven)
    assert worst(other, tmp_path / 'driven').max() < 0.002
    unknown = samples(
        300, position=lambda k: driven.q[k], velocity=lambda k: (math.nan,) * 2, effort=lambda k: driven.tau[k]
    )
    assert worst(other, write(tmp_path / 'unknown speeds', unknown)).max() < 0.1


def test_a_ghost_needs_the_joint_states_of_its_rig(bag, tmp_path, node):
    ghosts = []
    node.create_subscription(JointState, '/ghost/joint_states', ghosts.append, 1000)
    node.create_subscription(JointState, '/states', lambda _: None, 1000)
    given = parameters(
        bag=bag, topics='[states]', ghost=written(tmp_path / 'rig.yaml', PAPER), joint_names='[a, b]', wait=10.0
    )
    with Program('player', *given) as program:
        assert program.process.wait(30) == 1
        program.wait_for('ghost follows /joint_states, which is not among the played topics /states; name its topic by')
    with Program('player', *given, '-r', 'joint_states:=/states'):
        assert spin_until(node, lambda: ghosts)


def test_effort_commands_are_played_only_on_request_and_all_topics_in_the_namespace(tmp_path, node):
    path = tmp_path / 'bag'
    with BagWriter(path) as writer:
        effort, other = (writer.add_topic(topic, FLOAT) for topic in (COMMAND, '/other'))
        for k in range(50):
            for topic in (effort, other):
                writer.write(topic, bytes([0, 1, 0, 0]) + struct.pack('<d', 1.0), START + 10 * k * MS)
        states = writer.add_topic('/states', JOINT_STATE)
        writer.write(states, encode_joint_state(START, ('a', 'b'), [0, 0], [], [0.5, 0]), START)
    received = {topic: [] for topic in (COMMAND, '/other', '/states', f'/lab1{COMMAND}', '/lab1/states')}
    for topic, messages in received.items():
        kind = JointState if topic.endswith('states') else Float64
        node.create_subscription(kind, topic, messages.append, 100, raw=True)

    def played(*words, **values):
        """Return the number of messages on each topic, and the output of the player."""
        for messages in received.values():
            messages.clear()
        with Program('player', *parameters(bag=path, wait=10.0, **values), *words) as program:
            assert spin_until(node, lambda: program.process.poll() is not None, 20.0)
            assert program.process.returncode == 0, program.output
        spin_until(node, lambda: False, 0.2)
        return {topic: len(messages) for topic, messages in received.items() if messages}, program.output

    counts, output = played()
    assert counts == {'/states': 1}
    assert f'{COMMAND} would move an armed rig; name it in topics to play it' in output
    counts, _ = played('-r', '__ns:=/lab1', topics=f'[states, {COMMAND[1:]}]')
    assert counts == {'/lab1/states': 1, f'/lab1{COMMAND}': 50}


def test_topics_of_two_rigs_with_the_same_name_in_the_namespace_are_not_mixed(tmp_path, node):
    path, received = tmp_path / 'bag', []
    with BagWriter(path) as writer:
        for k, topic in enumerate(('/states', '/lab1/states')):
            state = encode_joint_state(START, ('a', 'b'), [k, 0], [], [0.5, 0])
            writer.write(writer.add_topic(topic, JOINT_STATE), state, START)
    node.create_subscription(JointState, '/lab1/states', lambda m: received.append(m.position[0]), 100)
    for topics, positions in (([''], []), (['/states'], [0]), (['states'], [1]), (['/lab1/states'], [1])):
        received.clear()
        with Program('player', *parameters(bag=path, wait=10.0, topics=topics), '-r', '__ns:=/lab1') as program:
            assert spin_until(node, lambda: program.process.poll() is not None, 20.0)
            spin_until(node, lambda: received, 0.5)
            assert received == positions, program.output
        if not positions:
            program.wait_for('/lab1/states and /states would both be played as /lab1/states; name one of them in')
