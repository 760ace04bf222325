import dataclasses
import resource
import signal
import time

import pytest
import yaml
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from pendubot_identification.adapters.bag_reader import BagReader
from pendubot_identification.core.errors import BagError

from ..conftest import ROOT
from ..processes import Program, run_program

pytestmark = pytest.mark.ros


@pytest.fixture
def node(ros):
    node = ros.create_node('recorder_test')
    yield node
    node.destroy_node()


def recorder(output, *topics, **parameters):
    settings = {'output': output, 'topics': '[' + ','.join(topics) + ']', **parameters}
    return Program('recorder', '--ros-args', *(part for k, v in settings.items() for part in ('-p', f'{k}:={v}')))


def wait(condition, timeout=10.0):
    deadline = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < deadline, 'nothing happened'
        time.sleep(0.005)


def wait_for_subscriptions(*publishers):
    wait(lambda: all(publisher.get_subscription_count() for publisher in publishers))


def recorded(path):
    """Return the number of messages that a reader sees by now."""
    try:
        return BagReader(path).info.count
    except BagError:
        return 0


def joint_state(k):
    from builtin_interfaces.msg import Time
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Header

    return JointState(
        header=Header(stamp=Time(sec=1_700_000_000 + k, nanosec=k), frame_id=f'frame{k}'),
        name=['shoulder', 'elbow'][: k % 3],
        position=[0.1 * k, -1e300],
        velocity=[1.0] * (k % 5),
        effort=[float(k), 0.5],
    )


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
    info = BagReader(path).info
    assert info.closed
    assert {topic.name: topic.count for topic in info.topics}['/first'] == 50


def test_sigkill_while_recording_at_1_khz_loses_little(tmp_path, node):
    path = tmp_path / 'bag'
    with recorder(path, '/killed') as program:
        publisher = node.create_publisher(type(joint_state(0)), '/killed', 1000)
        wait_for_subscriptions(publisher)
        # The first message may come only with the publisher's next heartbeat, seconds later.
        publisher.publish(joint_state(0))
        wait(lambda: recorded(path) == 1)
        start = time.monotonic()
        for k in range(1, 1500):
            publisher.publish(joint_state(k))
            time.sleep(max(0.0, start + 0.001 * k - time.monotonic()))
        program.kill()
    info = BagReader(path).info
    assert not info.closed
    assert 'never closed' in info.note
    # A tenth of a second that was not flushed yet, and what was on its way.
    assert info.count > 1500 - 250


def test_a_full_disk_is_one_sentence_and_leaves_what_is_whole(tmp_path, node):
    path = tmp_path / 'bag'
    with recorder(path, '/too_much') as program:
        publisher = node.create_publisher(type(joint_state(0)), '/too_much', 1000)
        wait_for_subscriptions(publisher)
        # A limit on a file's size refuses a write as a full disk does.
        resource.prlimit(program.process.pid, resource.RLIMIT_FSIZE, (50_000, 50_000))
        k = 0
        while program.process.poll() is None:
            publisher.publish(joint_state(k))
            k += 1
            time.sleep(0.001)
        assert program.process.returncode == 1
    wait(lambda: 'is closed with all that was received before: the system limits files to 0.050 MB' in program.output)
    assert 'Traceback' not in program.output
    info = BagReader(path).info
    assert info.closed
    assert info.count > 50


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
    assert BagReader(tmp_path / 'bag').info.closed


def test_topics_that_nobody_publishes_are_named(tmp_path):
    with recorder(tmp_path / 'bag', '/nobody') as program:
        program.wait_for('nobody publishes /nobody yet')
        assert program.stop() == 0
    assert BagReader(tmp_path / 'bag').info.closed


@pytest.mark.parametrize(
    ('parameters', 'sentence'),
    [
        ({'output': '/dev/null/bag'}, 'cannot be written'),
        ({'output': '{taken}'}, 'exists already; give another name'),
        ({'topics': '["two words"]'}, 'a name such as /joint_states is expected'),
        ({'topics': '[""]'}, 'name at least one topic'),
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


def test_the_config_file_holds_every_parameter():
    from pendubot_identification.nodes.recorder import Recorder

    config = yaml.safe_load((ROOT / 'config' / 'recorder.yaml').read_text())
    assert config['recorder']['ros__parameters'] == {setting.name: setting.default for setting in Recorder.SETTINGS}
