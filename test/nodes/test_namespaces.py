# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Two rigs on one network, each in its namespace: nobody hears, moves or records the other's."""

import csv
from contextlib import ExitStack

import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from pendubot_identification.model.parameters import PAPER
from pendubot_identification.nodes.messages import LATCHED
from pendubot_identification.resources import resource
from test.processes import Program, call, parameters, run_program, spin_until

pytestmark = pytest.mark.ros
PULSES = {'arm': 'true', 'width': 0.5, 'amplitude_min': 0.05, 'amplitude_max': 0.1}


@pytest.fixture(scope='module')
def traces(tmp_path_factory):
    """Virtual rigs in /lab1, by a file, and in /lab2, by a bridge of another name; gives what their boards did."""
    folder = tmp_path_factory.mktemp('rigs')
    file = folder / 'bridge.yaml'
    file.write_text(resource('config/bridge.yaml').read_text().replace('torque_limit: 2.0', 'torque_limit: 0.123'))
    with ExitStack() as programs:

        def start(name, *options):
            link, trace = folder / name, folder / f'{name}.csv'
            board = Program('virtual_board', '--link', link, '--trace', trace)
            programs.enter_context(board).wait_for('virtual board on')
            # Of two values of a parameter the later one counts.
            named = [
                '--ros-args',
                '-r',
                f'__ns:=/{name}',
                *options,
                '-p',
                f'port:={link}',
                '-p',
                'confirm_zeros:=false',
            ]
            programs.enter_context(Program('bridge', *named)).wait_for('counts per turn')
            return lambda: list(csv.DictReader(trace.open()))

        yield start('lab1', '--params-file', file), start('lab2', '-r', '__node:=my_bridge')


class Heard:
    """A node that hears what all programs say on /diagnostics: the last values of each status, by its name."""

    def __init__(self, ros):
        self.node, self.statuses = ros.create_node('listener'), {}
        self.node.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 10)

    def _on_diagnostics(self, array):
        for status in array.status:
            self.statuses[status.name] = {pair.key: pair.value for pair in status.values}

    def until(self, condition, timeout=20.0):
        assert spin_until(self.node, condition, timeout), self.statuses


@pytest.fixture
def heard(ros):
    heard = Heard(ros)
    yield heard
    heard.node.destroy_node()


def armed_or_moved(rows):
    return any(int(row['torque']) or int(row['status']) & 1 for row in rows)


def test_programs_move_record_and_identify_the_rig_of_their_own_namespace_alone(traces, heard, tmp_path):
    first, second = traces
    bag = tmp_path / 'bag'
    with (
        Program('recorder', *parameters(output=bag), '-r', '__ns:=/lab1') as recorder,
        Program('exciter', *parameters(duration=3.0, **PULSES), '-r', '__ns:=/lab1') as exciter,
    ):
        recorder.wait_for('recording /lab1/joint_states')
        exciter.wait_for('exciting')
        heard.until(lambda: heard.statuses.get('lab1/bridge', {}).get('armed') == 'True')
        assert heard.statuses['lab1/bridge']['torque limit [N m]'] == '0.123', "not the file's"
        # The other rig says the whole time that it is disarmed: that is not said of this one.
        heard.until(lambda: exciter.process.poll() is not None)
        assert exciter.process.returncode == 0, exciter.output
        assert 'excitation done' in exciter.output
        assert recorder.stop() == 0
    assert armed_or_moved(first())
    assert not armed_or_moved(second())
    assert heard.statuses['lab2/my_bridge']['armed'] == 'False'
    assert heard.statuses['lab2/my_bridge']['discarded'] == '0', 'it heard no effort command'
    assert 'lab1/recorder' in heard.statuses
    recorded = yaml.safe_load((bag / 'metadata.yaml').read_text())['rosbag2_bagfile_information']
    names = {entry['topic_metadata']['name'] for entry in recorded['topics_with_message_count']}
    assert names == {'/lab1/joint_states', '/lab1/pendubot/effort_command'}
    # The identifier reads the topic of its namespace, and publishes there.
    params = []
    heard.node.create_subscription(Float64MultiArray, '/lab1/pendubot/params', params.append, LATCHED)
    quick = {'criterion': 'energy', 'optimizer': 'lsq', 'model': 'viscous'}
    with Program('identifier', *parameters(bags=f"['{bag}']", **quick), '-r', '__ns:=/lab1'):
        heard.until(lambda: params)
        assert not heard.node.count_publishers('/pendubot/params')
        heard.until(lambda: 'lab1/identifier: progress' in heard.statuses)


def test_a_balancer_is_ready_by_the_parameters_and_samples_of_its_namespace(traces, heard):
    """What it says of the parameters shows that it has taken them; the other rig's are no rig's."""
    own = heard.node.create_publisher(Float64MultiArray, '/lab2/pendubot/params', LATCHED)
    others = heard.node.create_publisher(Float64MultiArray, '/lab1/pendubot/params', LATCHED)
    own.publish(Float64MultiArray(data=PAPER.vector().tolist()))
    others.publish(Float64MultiArray(data=[-1.0] * 7))
    with Program('balancer', '--ros-args', '-r', '__ns:=/lab2') as balancer:
        balancer.wait_for('nothing on pendubot/identification says how good the parameters on pendubot/params are')
        heard.until(lambda: 'lab2/balancer' in heard.statuses)
        client = heard.node.create_client(Trigger, '/lab2/balancer/start')
        assert not call(heard.node, client, Trigger.Request()).success
    assert 'no rig has' not in balancer.output


def test_a_bridge_of_another_name_is_asked_for_and_driven_once_its_services_are_remapped(traces):
    _, trace = traces
    options = [*parameters(duration=1.0, **PULSES), '-r', '__ns:=/lab2']
    with Program('exciter', *options) as exciter:
        exciter.wait_for(
            'waiting for /lab2/bridge/arm, which nobody serves: start the bridge or, if its node has another name, '
            'remap bridge/arm and bridge/disarm'
        )
    assert not armed_or_moved(trace())
    remapped = [f'bridge/{service}:=my_bridge/{service}' for service in ('arm', 'disarm')]
    with Program('exciter', *options, *(word for rule in remapped for word in ('-r', rule))) as exciter:
        exciter.wait_for('excitation done')
        assert exciter.process.wait(10) == 0
    assert armed_or_moved(trace())
    assert int(trace()[-1]['status']) & 1 == 0


def test_a_parameter_file_for_another_namespace_ends_the_node(tmp_path):
    file = tmp_path / 'mine.yaml'
    file.write_text('bridge:\n  ros__parameters:\n    torque_limit: 0.1\n')
    ended = run_program('bridge', '--ros-args', '-r', '__ns:=/lab1', '--params-file', file)
    assert (ended.returncode, ended.stderr) == (
        1,
        f'bridge: nothing is taken from {file}: it holds parameters of /bridge, and none of /lab1/bridge; name '
        '/lab1/bridge in it, or /**/bridge for every namespace\n',
    )
