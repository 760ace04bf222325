# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The exciter with a real bridge and the virtual board."""

import re
import signal
import time

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from pendubot_identification.excitation.excitation import PulseTrain
from test.nodes.conftest import PULSES
from test.processes import Program, parameters, spin_until
from test.rig import ARMED, PATIENT, Rig

pytestmark = pytest.mark.ros
EFFORT = '/pendubot/effort_command'


@pytest.fixture(scope='module')
def shared(ros, tmp_path_factory):
    with Rig(tmp_path_factory.mktemp('rig'), 100) as rig:
        rig.start_board()
        rig.start_bridge(*PATIENT)
        yield rig


@pytest.fixture
def rig(shared):
    """A disarmed rig at rest; ``torques`` and ``armed`` cover this test alone."""
    assert shared.call('disarm').success
    shared.until(lambda: not shared.trace()[-1, 3:].any())
    begun = len(shared.trace())
    shared.torques = lambda: shared.trace()[begun:, 3]
    shared.armed = lambda: (shared.trace()[begun:, 4] & ARMED).astype(bool)
    return shared


def exciter(**values):
    return Program('exciter', *parameters(**values))


def test_the_board_applies_the_pulse_train_and_is_disarmed_at_its_end_or_at_a_signal(rig):
    pulses = {'period': 0.2, 'width': 0.5, 'amplitude_min': -0.3, 'amplitude_max': 0.4, 'hold': 0.02, 'seed': 7}
    with exciter(arm='true', duration=2.0, **pulses) as program:
        program.wait_for('excitation done')
        assert program.process.wait(10) == 0
    drawn = {round(1e6 * PulseTrain(**pulses).torque(k * 0.01)) for k in range(200)}
    assert set(rig.torques()) <= drawn | {0}
    assert len(set(rig.torques())) > 20
    assert rig.torques()[-1] == 0
    assert not rig.armed()[-1]
    with exciter(arm='true', **PULSES) as program:
        program.wait_for('exciting')
        rig.until(lambda: rig.torques()[-1])
        assert program.stop(signal.SIGTERM) == 0
    assert not rig.armed()[-1]
    assert rig.torques()[-1] == 0


def test_the_exciter_commands_nothing_before_arming_and_stops_at_disarming(rig):
    with exciter(**PULSES) as program:
        program.wait_for('waiting to be armed')
        assert not rig.torques().any()
        assert rig.call('arm').success
        program.wait_for('exciting')
        rig.until(lambda: rig.torques().any())
        assert rig.call('disarm').success
        program.wait_for('the bridge is no longer armed')
        assert program.process.wait(10) == 1


def test_the_exciter_does_not_arm_a_bridge_that_it_cannot_disarm(rig):
    with Program('exciter', *parameters(arm='true', **PULSES), '-r', 'bridge/disarm:=nobody/disarm') as program:
        program.wait_for('waiting for /nobody/disarm, which nobody serves')
        assert program.stop() == 0
    assert not rig.armed().any()


def ends_with_1(program):
    assert program.process.wait(10) == 1
    assert 'excitation done' not in program.output
    assert 'Traceback' not in program.output


@pytest.mark.parametrize(
    ('arm', 'kind', 'topic'),
    [('true', Float64, EFFORT), ('false', JointState, '/joint_states')],
    ids=['controller', 'second rig'],
)
def test_the_exciter_does_not_start_beside_another_publisher(rig, stranger, arm, kind, topic):
    publisher = stranger.create_publisher(kind, topic, 1)
    with exciter(arm=arm, **PULSES) as program:
        assert spin_until(stranger, lambda: publisher.publish(kind()) or program.process.poll() is not None)
        output = program.wait_for('only one program may publish there')
        # The stranger may be discovered before the exciter publishes, after it, or first by the bridge, without a name.
        named = re.search(rf'{topic} has [12] publishers?: [^;]*/elsewhere/stranger', output)
        assert named or f'the bridge did not arm: {topic} has 2 publishers: ' in output
        ends_with_1(program)
    # The bridge refuses a second controller, too; a second rig may be discovered only after arming.
    assert kind is JointState or not rig.armed().any()
    rig.until(lambda: not rig.armed()[-1])


def an_hour_later():
    """Return a sample with a time at which the excitation would be done."""
    message = JointState(name=['shoulder', 'elbow'], position=[0.0, 0.0], effort=[0.0, 0.0])
    message.header.stamp.sec = int(time.time()) + 3600
    return message


@pytest.mark.parametrize(
    ('topic', 'message', 'publishers'),
    [
        (EFFORT, lambda: Float64(data=0.4), '/elsewhere/stranger, /exciter'),
        ('/joint_states', an_hour_later, '/bridge, /elsewhere/stranger'),
    ],
    ids=['controller', 'second rig'],
)
def test_a_publisher_that_appears_during_excitation_ends_and_disarms_it(rig, stranger, topic, message, publishers):
    with exciter(arm='true', **PULSES | {'duration': 600.0}) as program:
        program.wait_for('exciting')
        rig.until(lambda: rig.torques().any())
        other = stranger.create_publisher(type(message()), topic, 10)
        assert spin_until(stranger, lambda: other.publish(message()) or program.process.poll() is not None)
        program.wait_for(f'{topic} has 2 publishers: {publishers}; only one program may publish there')
        ends_with_1(program)
    rig.until(lambda: not rig.armed()[-1])
    assert rig.torques().max() <= 200_000


def test_the_exciter_waits_for_the_first_sample_and_stops_when_samples_cease(ros):
    """One node stands in for two bridges in namespaces; the first is armed."""
    node, torques, arm_calls = ros.create_node('bridges'), [], []
    diagnostics = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
    status = [DiagnosticStatus(name='armed/bridge', values=[KeyValue(key='armed', value='True')])]
    status += [DiagnosticStatus(values=[KeyValue(key='/armed/joint_states rate [Hz]', value='unknown')])]
    node.create_timer(0.1, lambda: diagnostics.publish(DiagnosticArray(status=status)))
    node.create_service(Trigger, '/arming/bridge/arm', lambda _, answer: arm_calls.append(1) or answer)
    samples = {name: node.create_publisher(JointState, f'/{name}/joint_states', 10) for name in ('armed', 'arming')}
    node.create_subscription(Float64, '/armed/pendubot/effort_command', lambda m: torques.append(m.data), 100)
    bridge = ros.create_node('bridge', namespace='armed')
    bridge.create_subscription(Float64, 'pendubot/effort_command', print, 1)

    def started(name, **values):
        return Program('exciter', *parameters(duration=0.0, **values), '-r', f'__ns:=/{name}')

    with started('armed') as armed, started('arming', arm='true') as arming:
        # Logged every five seconds: by the second time the service has been discovered.
        waiting = 'waiting for /arming/joint_states'
        assert spin_until(node, lambda: arming.output.count(waiting) == 2, 20.0), arming.output
        assert node.count_clients('/arming/bridge/arm')
        assert not arm_calls
        armed.wait_for('stopped: no joint states for 4')
        assert not any(torques)
    with started('armed') as armed:
        assert spin_until(node, lambda: samples['armed'].publish(JointState()) or torques), armed.output
        assert spin_until(node, lambda: armed.process.poll() == 1, 20.0), armed.output
        armed.wait_for('stopped: no joint states for 2')
    bridge.destroy_node()
    node.destroy_node()
