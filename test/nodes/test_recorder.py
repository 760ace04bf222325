# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

import ctypes
import dataclasses
import os
import resource
import shutil
import signal
import struct
import subprocess
import sys
import time

import pytest
import yaml
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from pendubot_identification.recordings.bag_reader import BagReader
from test.recordings.independent import by_mcap, by_rosbags

from ..faults.recorder import disk_of_its_own, joint_state, kills, recorded, recorder, wait, wait_for_subscriptions
from ..processes import MODULES, Program, run_program, spin_until

pytestmark = pytest.mark.ros


@pytest.fixture
def node(ros):
    node = ros.create_node('recorder_test')
    yield node
    node.destroy_node()


def fields(message):
    """Return a message as plain nested values, whichever library made it."""
    if hasattr(message, 'get_fields_and_field_types'):
        return {name: fields(getattr(message, name)) for name in message.get_fields_and_field_types()}
    if dataclasses.is_dataclass(message):
        # rosbags counts constants, which are in capitals, and the type's name among the fields.
        names = [f.name for f in dataclasses.fields(message) if f.name.islower() and f.name != '__msgtype__']
        return {name: fields(getattr(message, name)) for name in names}
    if isinstance(message, bytes):
        return message[0]
    return message if isinstance(message, (str, int, float)) else [fields(value) for value in message]


def test_every_message_comes_back_field_for_field(tmp_path, node):
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
    from rclpy.serialization import deserialize_message
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64

    diagnostics = DiagnosticArray(
        status=[DiagnosticStatus(level=b'\x01', name='n', message='m', values=[KeyValue(key='k', value='ü')])]
    )
    published = {
        '/joint_states': [joint_state(k) for k in range(500)],
        '/effort': [Float64(data=0.1 * k) for k in range(300)],
        '/state': [diagnostics] * 20,
    }
    path = tmp_path / 'bag'
    started = time.time_ns()
    with recorder(path, *published) as program:
        publishers = {topic: node.create_publisher(type(ms[0]), topic, 1000) for topic, ms in published.items()}
        wait_for_subscriptions(*publishers.values())
        for topic, messages in published.items():
            for message in messages:
                publishers[topic].publish(message)
        wait(lambda: recorded(path) == 820)
        assert program.stop(signal.SIGINT) == 0
    assert f'recording to {path}' in program.output
    assert 'recording /effort [std_msgs/msg/Float64]' in program.output
    assert '/joint_states: 500 messages' in program.output

    classes = {'/joint_states': JointState, '/effort': Float64, '/state': DiagnosticArray}
    by_mcap = {topic: [] for topic in published}
    with (path / 'bag_0.mcap').open('rb') as file:
        for _, channel, message in make_reader(file).iter_messages(log_time_order=False):
            topic = channel.topic
            by_mcap[topic].append(deserialize_message(message.data, classes[topic]))
            assert message.sequence == len(by_mcap[topic])
            assert started <= message.publish_time <= message.log_time <= time.time_ns()
    assert by_mcap == published

    store = get_typestore(Stores.ROS2_JAZZY)
    by_rosbags = {topic: [] for topic in published}
    with Reader(path) as reader:
        for connection, _, data in reader.messages():
            by_rosbags[connection.topic].append(fields(store.deserialize_cdr(data, connection.msgtype)))
    expected = {topic: [fields(message) for message in messages] for topic, messages in published.items()}
    assert by_rosbags == expected

    information = yaml.safe_load((path / 'metadata.yaml').read_text())['rosbag2_bagfile_information']
    assert information['message_count'] == 820
    assert sorted(t['message_count'] for t in information['topics_with_message_count']) == [20, 300, 500]


def test_every_quality_of_service_is_heard(tmp_path, node):
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
    from std_msgs.msg import Float64

    latched = node.create_publisher(
        Float64, '/latched', QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    )
    latched.publish(Float64(data=7.0))
    best_effort = node.create_publisher(
        Float64, '/best_effort', QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    )
    path = tmp_path / 'bag'
    with recorder(path, '/latched', '/best_effort') as program:
        wait_for_subscriptions(best_effort, latched)
        best_effort.publish(Float64(data=8.0))
        wait(lambda: recorded(path) == 2)
        assert program.stop(signal.SIGTERM) == 0
    information = yaml.safe_load((path / 'metadata.yaml').read_text())['rosbag2_bagfile_information']
    offered = {
        topic['topic_metadata']['name']: topic['topic_metadata']['offered_qos_profiles'][0]
        for topic in information['topics_with_message_count']
    }
    assert (offered['/latched']['reliability'], offered['/latched']['durability']) == ('reliable', 'transient_local')
    assert (offered['/best_effort']['reliability'], offered['/best_effort']['durability']) == (
        'best_effort',
        'volatile',
    )


def test_it_ends_by_itself_after_max_messages_of_the_first_topic(tmp_path, node, monkeypatch):
    from std_msgs.msg import Float64

    monkeypatch.chdir(tmp_path)
    with Program('recorder', '--ros-args', '-p', 'topics:=[/first,/second]', '-p', 'max_messages:=50') as program:
        publishers = [node.create_publisher(Float64, topic, 1000) for topic in ('/second', '/first')]
        wait_for_subscriptions(*publishers)
        for publisher in publishers:
            for k in range(80):
                publisher.publish(Float64(data=float(k)))
        assert program.process.wait(10) == 0
    (path,) = tmp_path.glob('pendubot_20*T*Z')
    info = BagReader(path)
    assert info.closed
    assert info.topics['/first'] == ('std_msgs/msg/Float64', 50)


def values(message):
    """Return a status as level, text and values by name."""
    (status,) = message.status
    return status.level[0], status.message, {value.key: value.value for value in status.values}


@pytest.fixture
def diagnostics(node):
    """What the recorder says on /diagnostics."""
    from diagnostic_msgs.msg import DiagnosticArray

    said = []
    node.create_subscription(
        DiagnosticArray,
        '/diagnostics',
        lambda m: said.append(values(m)) if m.status[0].name == 'recorder' else None,
        10,
    )
    return said


def test_metadata_of_a_killed_recording_names_every_topic_and_counts(tmp_path, node):
    from std_msgs.msg import Float64

    path = tmp_path / 'bag'

    def described():
        try:
            content = yaml.safe_load((path / 'metadata.yaml').read_text())['rosbag2_bagfile_information']
        except FileNotFoundError:
            return {}
        counted = content['topics_with_message_count']
        assert content['message_count'] == sum(topic['message_count'] for topic in counted)
        return {topic['topic_metadata']['name']: topic['message_count'] for topic in counted}

    with recorder(path, '/early', '/late', '/never') as program:
        early = node.create_publisher(Float64, '/early', 1000)
        wait_for_subscriptions(early)
        wait(lambda: described() == {'/early': 0})
        for k in range(300):
            early.publish(Float64(data=float(k)))
        wait(lambda: described() == {'/early': 300})
        late = node.create_publisher(Float64, '/late', 1000)
        wait_for_subscriptions(late)
        late.publish(Float64(data=1.0))
        wait(lambda: described() == {'/early': 300, '/late': 1})
        program.kill()
    assert described() == {'/early': 300, '/late': 1}
    assert not BagReader(path).closed
    profiles = yaml.safe_load((path / 'metadata.yaml').read_text())['rosbag2_bagfile_information']
    (first, _) = profiles['topics_with_message_count']
    assert first['topic_metadata']['type'] == 'std_msgs/msg/Float64'
    assert first['topic_metadata']['offered_qos_profiles'][0]['reliability'] == 'reliable'


def test_diagnostics_say_how_it_is_doing(tmp_path, node, diagnostics):
    from std_msgs.msg import Float64

    with recorder(tmp_path / 'bag', '/said', reserve=1000) as program:
        publisher = node.create_publisher(Float64, '/said', 100)
        assert spin_until(node, lambda: diagnostics and 'nothing yet' in diagnostics[-1][1])
        wait_for_subscriptions(publisher)
        for k in range(50):
            publisher.publish(Float64(data=float(k)))
        assert spin_until(node, lambda: diagnostics[-1][2]['/said messages'] == '50')
        level, text, said = diagnostics[-1]
        assert (level, text, said['/said lost']) == (0, 'recording', '0')
        assert float(said['free [MB]']) > 0
        assert any(float(each[2]['/said rate [Hz]']) > 0 for each in diagnostics)
        assert program.stop() == 0


@pytest.mark.parametrize('another', [False, True], ids=['alone', 'after another was there'])
def test_messages_that_were_lost_are_counted(tmp_path, node, diagnostics, another):
    from rclpy.qos import QoSProfile, ReliabilityPolicy
    from std_msgs.msg import Float64

    path = tmp_path / 'bag'
    with recorder(path, '/lost') as program:
        # It keeps ten for a recorder that does not answer.
        publisher = node.create_publisher(Float64, '/lost', 10)
        wait_for_subscriptions(publisher)
        publisher.publish(Float64(data=0.0))
        wait(lambda: recorded(path) == 1)
        if another:
            # One that is not heard: of such a one the recorder says when it comes, and no more when it went.
            poor = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
            passing = node.create_publisher(Float64, '/lost', poor)
            assert spin_until(node, lambda: diagnostics and 'not heard' in diagnostics[-1][1])
            node.destroy_publisher(passing)
            assert spin_until(node, lambda: 'not heard' not in diagnostics[-1][1])
        program.process.send_signal(signal.SIGSTOP)
        for k in range(1, 20_000):
            publisher.publish(Float64(data=float(k)))
        program.process.send_signal(signal.SIGCONT)
        assert spin_until(node, lambda: diagnostics and int(diagnostics[-1][2]['/lost lost']) > 0, 20.0)
        publisher.publish(Float64(data=-1.0))
        wait(lambda: struct.unpack('<d', whole_messages(path)[-1][4:])[0] == -1.0)
        assert spin_until(
            node,
            lambda: int(diagnostics[-1][2]['/lost lost']) + int(diagnostics[-1][2]['/lost messages']) == 20_001,
        )
        assert diagnostics[-1][0] == 1
        assert 'messages lost' in diagnostics[-1][1]
        assert program.stop() == 0


def whole_messages(path):
    return [message.data for messages in BagReader(path).messages(['/lost']) for message in messages]


def test_publishers_that_offer_less_are_heard_once_they_are_alone(tmp_path, node, diagnostics):
    from rclpy.qos import QoSProfile, ReliabilityPolicy
    from std_msgs.msg import Float64

    path = tmp_path / 'bag'
    with recorder(path, '/qos') as program:
        reliable = node.create_publisher(Float64, '/qos', 10)
        wait_for_subscriptions(reliable)
        reliable.publish(Float64(data=1.0))
        wait(lambda: recorded(path) == 1)
        poor = node.create_publisher(Float64, '/qos', QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT))
        program.wait_for('/qos: 1 of 2 publishers offer less and are not heard')
        assert spin_until(node, lambda: diagnostics and 'are not heard' in diagnostics[-1][1])
        node.destroy_publisher(reliable)
        wait_for_subscriptions(poor)
        poor.publish(Float64(data=2.0))
        wait(lambda: recorded(path) == 2)
        assert program.stop() == 0
    assert BagReader(path).closed


def test_sigkill_while_recording_at_1_khz_loses_at_most_a_tenth_of_a_second(tmp_path, node):
    # Twenty of them are in test/faults. A machine that is busy may fail one, not all three.
    losses = [killed.sent - killed.read for killed in kills(node, tmp_path, 3)]
    assert min(losses) <= 100, losses


def test_a_full_disk_is_one_sentence_and_leaves_what_is_whole(tmp_path, node, diagnostics):
    path = tmp_path / 'bag'
    with recorder(path, '/too_much') as program:
        publisher = node.create_publisher(type(joint_state(0)), '/too_much', 1000)
        wait_for_subscriptions(publisher)
        assert spin_until(node, lambda: diagnostics)
        # A limit on a file's size refuses a write as a full disk does.
        resource.prlimit(program.process.pid, resource.RLIMIT_FSIZE, (50_000, 50_000))
        k = 0
        while program.process.poll() is None:
            publisher.publish(joint_state(k))
            k += 1
            time.sleep(0.001)
        assert program.process.returncode == 1
    said = 'is closed with all that was received before: the system limits files to 0.050 MB'
    wait(lambda: said in program.output)
    assert 'Traceback' not in program.output
    assert spin_until(node, lambda: diagnostics[-1][0] == 2 and said in diagnostics[-1][1])
    info = BagReader(path)
    assert info.closed
    assert info.count > 50


def test_a_disk_that_fills_ends_the_bag_before_the_reserve_is_gone(tmp_path, node, diagnostics):
    from std_msgs.msg import String

    with disk_of_its_own(tmp_path) as folder:
        path = folder / 'bag'
        reserve = shutil.disk_usage(folder).free - 20_000_000
        with recorder(path, '/much', reserve=reserve) as program:
            publisher = node.create_publisher(String, '/much', 10)
            wait_for_subscriptions(publisher)
            message = String(data='x' * 500_000)
            k = 0
            while program.process.poll() is None:
                publisher.publish(message)
                k += 1
                wait(lambda k=k: program.process.poll() is not None or recorded(path) >= k - 5)
            assert program.process.returncode == 1
        wait(lambda: 'is closed with all that was received before: its disk has' in program.output)
        assert 'Traceback' not in program.output
        assert shutil.disk_usage(folder).free >= reserve
        info = BagReader(path)
        assert info.closed
        assert by_rosbags(path) == by_mcap(path)
        assert info.count >= 1


def respect_permissions():
    """Take from root, in a child before its program starts, the right to write where its permissions forbid it."""
    PR_CAPBSET_DROP, CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH = 24, 1, 2
    for capability in (CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH):
        ctypes.CDLL(None).prctl(PR_CAPBSET_DROP, capability, 0, 0, 0)


def test_a_folder_that_may_not_be_written_to_is_one_sentence(tmp_path):
    folder = tmp_path / 'read only'
    folder.mkdir(mode=0o555)
    ended = subprocess.run(
        [sys.executable, '-m', MODULES['recorder'], '--ros-args', '-p', f'output:={folder}/bag'],
        capture_output=True,
        text=True,
        timeout=60,
        preexec_fn=respect_permissions if os.geteuid() == 0 else None,
    )
    assert ended.returncode == 1
    assert ended.stderr == (
        f'recorder: {folder}/bag cannot be written (Permission denied); free some space or choose another place\n'
    )
    assert not list(folder.iterdir())


def test_a_topic_of_two_types_is_one_sentence(tmp_path, node, ros):
    from std_msgs.msg import Float64, String

    # One context holds a topic to one type.
    context = ros.Context()
    ros.init(context=context)
    other = ros.create_node('other', context=context)
    try:
        publishers = [node.create_publisher(Float64, '/both', 1), other.create_publisher(String, '/both', 1)]
        wait(lambda: len(node.get_publishers_info_by_topic('/both')) == len(publishers))
        with recorder(tmp_path / 'bag', '/both') as program:
            program.wait_for('/both is published as std_msgs/msg/Float64 and as std_msgs/msg/String')
            assert program.process.wait(10) == 1
    finally:
        other.destroy_node()
        ros.shutdown(context=context)
    assert BagReader(tmp_path / 'bag').closed


def test_topics_that_nobody_publishes_are_named(tmp_path):
    with recorder(tmp_path / 'bag', '/nobody') as program:
        program.wait_for('nobody publishes /nobody yet')
        assert program.stop() == 0
    assert BagReader(tmp_path / 'bag').closed


@pytest.mark.parametrize(
    ('parameters', 'sentence'),
    [
        ({'output': '/dev/null/bag'}, 'cannot be written'),
        ({'output': '{taken}'}, 'exists already; give another name'),
        ({'topics': '["two words"]'}, 'a name such as joint_states is expected'),
        ({'topics': '[""]'}, 'name at least one topic'),
        ({'reserve': 2**60}, 'is not begun: its disk has'),
        ({'max_messages': -1}, 'a whole number of at least 0 is expected'),
    ],
)
def test_settings_that_make_no_sense_are_one_sentence(tmp_path, parameters, sentence):
    arguments = [part for k, v in parameters.items() for part in ('-p', f'{k}:={v}'.format(taken=tmp_path))]
    ended = run_program('recorder', '--ros-args', '-p', f'output:={tmp_path}/bag', *arguments)
    assert ended.returncode == 1
    assert sentence in ended.stderr
    assert len(ended.stderr.splitlines()) == 1
    assert not (tmp_path / 'bag').exists()
