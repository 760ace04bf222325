# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Two rigs on one network, each in its namespace, without interference."""

import csv
from contextlib import ExitStack

import pytest
import yaml

from pendubot_identification.resources import resource
from test.nodes.conftest import FAST
from test.nodes.observer import Observer
from test.processes import Program, parameters

PULSES = {'arm': 'true', 'width': 0.5, 'amplitude_min': 0.05, 'amplitude_max': 0.1}
LAB1, LAB2 = ('-r', '__ns:=/lab1'), ('-r', '__ns:=/lab2')


@pytest.fixture(scope='module')
def traces(tmp_path_factory):
    """Virtual rigs in /lab1, with a parameter file, and in /lab2, with a renamed bridge; yields their traces."""
    folder = tmp_path_factory.mktemp('rigs')
    file = folder / 'bridge.yaml'
    file.write_text(resource('config/bridge.yaml').read_text().replace('torque_limit: 2.0', 'torque_limit: 0.123'))
    with ExitStack() as programs:

        def start(name, *options):
            link, trace = folder / name, folder / f'{name}.csv'
            board = Program('virtual_board', '--link', link, '--trace', trace)
            programs.enter_context(board).wait_for('virtual board on')
            # The last value of a parameter takes precedence.
            own = parameters(port=link, confirm_zeros='false', link_timeout=2.0, watchdog_ms=500)[1:]
            bridge = Program('bridge', '--ros-args', *options, *own)
            programs.enter_context(bridge).wait_for('counts per turn')
            return lambda: list(csv.DictReader(trace.open()))

        yield start('lab1', *LAB1, '--params-file', file), start('lab2', *LAB2, '-r', '__node:=my_bridge')


@pytest.fixture
def observer(ros):
    with Observer(ros, '/lab1') as observer:
        yield observer


def armed_or_moved(rows):
    return any(int(row['torque']) or int(row['status']) & 1 for row in rows)


def test_programs_move_record_and_identify_only_the_rig_of_their_namespace(traces, observer, tmp_path):
    first, second = traces
    bag = tmp_path / 'bag'

    with (
        Program('recorder', *parameters(output=bag), *LAB1) as recorder,
        Program('exciter', *parameters(duration=3.0, recorded='true', **PULSES), *LAB1) as exciter,
    ):
        recorder.wait_for('recording /lab1/joint_states')
        exciter.wait_for('exciting')
        observer.until(lambda: observer.reported('lab1/bridge').get('armed') == 'True')
        assert observer.reported('lab1/bridge')['torque limit [N m]'] == '0.123', 'the parameter file was ignored'
        # The other rig's diagnostics, always disarmed, must not stop this exciter.
        observer.until(lambda: exciter.process.poll() is not None)
        assert exciter.process.returncode == 0, exciter.output
        assert 'excitation done' in exciter.output
        assert recorder.stop() == 0
    assert armed_or_moved(first())
    assert not armed_or_moved(second())
    assert observer.reported('lab2/my_bridge')['armed'] == 'False'
    assert observer.reported('lab2/my_bridge')['discarded'] == '0', 'it received an effort command of the other rig'
    assert observer.reported('lab1/recorder')
    recorded = yaml.safe_load((bag / 'metadata.yaml').read_text())['rosbag2_bagfile_information']
    names = {entry['topic_metadata']['name'] for entry in recorded['topics_with_message_count']}
    assert names == {'/lab1/joint_states', '/lab1/pendubot/effort_command'}
    with Program('identifier', *parameters(bags=f"['{bag}']", **FAST), *LAB1):
        observer.until(lambda: observer.params, 60.0)
        assert not observer.node.count_publishers('/pendubot/params')
        observer.until(lambda: observer.status('lab1/identifier: progress'))


def test_a_renamed_bridge_is_driven_after_its_services_are_remapped(traces):
    _, trace = traces
    remapped = [f'bridge/{service}:=my_bridge/{service}' for service in ('arm', 'disarm')]
    options = [*parameters(duration=1.0, **PULSES), *LAB2, *(word for rule in remapped for word in ('-r', rule))]
    with Program('exciter', *options, '-r', 'pendubot/effort_command:=u') as exciter:
        exciter.wait_for('waiting: /lab2/my_bridge does not subscribe to /lab2/u: remap pendubot/effort_command as')
    assert not armed_or_moved(trace()), 'it must not arm a bridge that does not receive its commands'
    with Program('exciter', *options) as exciter:
        exciter.wait_for('excitation done')
        assert exciter.process.wait(10) == 0
    assert armed_or_moved(trace())
    assert int(trace()[-1]['status']) & 1 == 0
