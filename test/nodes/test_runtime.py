# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What every node shares, in real processes: parameters that there are not, and signals at every moment."""

import signal
import subprocess
import sys
import time
from contextlib import ExitStack, suppress

import pytest
import yaml

from test.conftest import ROOT
from test.processes import Program, parameters, run_program, spin_until

pytestmark = pytest.mark.ros
#: As the console scripts start a node, said when it is about to import ROS.
STARTED = """
import sys
from pendubot_identification import programs
class Tell:
    def find_spec(self, name, *_):
        if name == 'rclpy':
            print('importing', flush=True)
sys.meta_path.insert(0, Tell())
sys.exit(programs.bridge())
"""


@pytest.mark.parametrize(
    ('program', 'name', 'meant'),
    [('bridge', 'prt', 'port'), ('exciter', 'amplitude_maximum', 'amplitude_max'), ('recorder', 'quite_else', None)],
)
def test_a_parameter_that_there_is_not_is_refused_and_the_one_that_is_meant_is_named(program, name, meant):
    ended = run_program(program, *parameters(**{name: 1.0}))
    assert ended.returncode == 1
    (sentence,) = ended.stderr.splitlines()
    asked = f'is {meant} meant' if meant else 'which is meant'
    assert sentence == f'{program}: {program} has no parameter {name}; {asked}? --help lists them all'


def test_degrees_are_no_radians():
    ended = run_program('bridge', *parameters(zero='[-90.0, 0.0]'))
    assert ended.returncode == 1
    assert ended.stderr == (
        'bridge: zero is -90.0; a list of numbers with decimal points from -7 to 7 rad is expected\n'
    )


def test_the_same_in_a_parameter_file(tmp_path):
    file = tmp_path / 'mine.yaml'
    file.write_text('bridge:\n  ros__parameters:\n    torque_limt: 0.1\n')
    ended = run_program('bridge', '--ros-args', '--params-file', file)
    assert ended.returncode == 1
    assert 'has no parameter torque_limt; is torque_limit meant' in ended.stderr


def test_parameters_that_ros_itself_knows_are_none_of_these(tmp_path):
    with Program('bridge', *parameters(port=tmp_path / 'board', use_sim_time='false')) as bridge:
        bridge.wait_for('missing')
        assert bridge.stop() == 0


def dump(node, client):
    """The parameters of a node as ``ros2 param dump`` writes them."""
    from rclpy.parameter import parameter_value_to_python

    def answer(future):
        assert spin_until(node, future.done)
        return future.result()

    names = answer(client.list_parameters()).result.names
    values = map(parameter_value_to_python, answer(client.get_parameters(names)).values)
    return yaml.dump({'/identifier': {'ros__parameters': dict(zip(names, values, strict=True))}})


def test_a_node_takes_back_the_parameters_that_ros2_dumped_and_numbers_as_they_are_typed(ros, tmp_path):
    """ROS's own tools hand on a number without a dot, 1e-09, as text."""
    from rcl_interfaces.msg import Parameter as ParameterMessage
    from rclpy.parameter import Parameter, get_parameter_value, parameter_dict_from_yaml_file
    from rclpy.parameter_client import AsyncParameterClient

    file, node = tmp_path / 'dump.yaml', ros.create_node('operator')
    bounds = {'lower_bounds': [0.0, 1e-9, *[0.0] * 5], 'upper_bounds': [1.0] * 7}
    try:
        with Program('identifier', *parameters(model='viscous', **bounds)):
            client = AsyncParameterClient(node, '/identifier')
            assert client.wait_for_services(20.0)
            file.write_text(dump(node, client))
            assert 'spread: 1.0e-09' in file.read_text()
            loaded = client.load_parameter_file(str(file), True)
            assert spin_until(node, loaded.done)
            answers = zip(parameter_dict_from_yaml_file(str(file), True), loaded.result().results, strict=True)
            # That one is ROS's own, and of no node can it be set.
            refused = {name: r.reason for name, r in answers if not r.successful} | {
                'start_type_description_service': ''
            }
            assert refused == {'start_type_description_service': ''}
            for text, taken in (('1e-8', True), ('.nan', False), ('many', False), ('[1e-8]', False)):
                typed = Parameter.from_parameter_msg(ParameterMessage(name='spread', value=get_parameter_value(text)))
                asked = client.set_parameters([typed])
                assert spin_until(node, asked.done)
                assert asked.result().results[0].successful == taken, text
            assert 'spread: 1.0e-08' in dump(node, client)
    finally:
        node.destroy_node()


def test_diagnostics_are_stamped_while_nobody_publishes_a_clock_and_by_the_clock_then(ros, tmp_path):
    from diagnostic_msgs.msg import DiagnosticArray
    from rosgraph_msgs.msg import Clock

    node, stamps = ros.create_node('operator'), {}
    node.create_subscription(
        DiagnosticArray,
        '/diagnostics',
        lambda array: stamps.update({status.name: array.header.stamp.sec for status in array.status}),
        10,
    )
    clock = node.create_publisher(Clock, '/clock', 1)
    message = Clock()
    message.clock.sec = 1000
    named = {'bridge': {'port': tmp_path / 'board'}, 'recorder': {'output': tmp_path / 'bag'}, 'identifier': {}}
    begin = int(time.time())
    try:
        with ExitStack() as programs:
            for program, values in named.items():
                programs.enter_context(Program(program, *parameters(use_sim_time='true', **values)))
            assert spin_until(node, lambda: len(stamps) == 3, 30.0)
            assert all(stamp >= begin for stamp in stamps.values()), stamps
            told = lambda: clock.publish(message) or set(stamps.values()) == {1000}  # noqa: E731
            assert spin_until(node, told), stamps
    finally:
        node.destroy_node()


@pytest.mark.parametrize('second', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_more_signals_than_one_change_no_exit_status(tmp_path, second):
    with Program('bridge', *parameters(port=tmp_path / 'board')) as bridge:
        bridge.wait_for('missing')
        bridge.process.send_signal(signal.SIGINT)
        while bridge.process.poll() is None:
            with suppress(subprocess.TimeoutExpired):
                bridge.process.wait(0.003)
            bridge.process.send_signal(second)
        assert bridge.process.returncode == 0
        assert 'Traceback' not in bridge.output


def test_a_closed_terminal_is_nothing_to_who_was_started_by_nohup(tmp_path):
    options = parameters(port=tmp_path / 'board')
    with Program('bridge', *options, before=('nohup',)) as bridge:
        bridge.wait_for('missing')
        bridge.process.send_signal(signal.SIGHUP)
        with pytest.raises(subprocess.TimeoutExpired):
            bridge.process.wait(1.0)
        assert bridge.stop(signal.SIGTERM) == 0


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_it_starts_is_no_failure(number):
    process = subprocess.Popen(
        [sys.executable, '-c', STARTED], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == 'importing\n'
    process.send_signal(number)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 0
    assert said == ''
