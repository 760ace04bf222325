# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The exciter with a real bridge and the virtual board."""

import re
import signal
import time

import pytest
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from pendubot_identification.excitation.excitation import PulseTrain
from test.nodes.conftest import PULSES
from test.processes import Program, parameters, spin_until
from test.rig import ARMED

EFFORT, COMMANDS = '/pendubot/effort_command', '/pendubot/joint_commands'


@pytest.fixture
def rig(shared_rig):
    """The rig; ``torques`` and ``armed`` are of its trace."""
    shared_rig.torques = lambda: shared_rig.trace()[:, 3]
    shared_rig.armed = lambda: (shared_rig.trace()[:, 4] & ARMED).astype(bool)
    return shared_rig


def exciter(env=None, **values):
    return Program('exciter', *parameters(**values), env=env)


def test_the_board_applies_the_pulse_train_and_is_disarmed_at_its_end_or_at_a_signal(rig):
    pulses = {'period': 0.2, 'width': 0.5, 'amplitude_min': -0.3, 'amplitude_max': 0.4, 'hold': 0.02, 'seed': 7}
    with exciter({'PYTHONPROFILEIMPORTTIME': '1'}, arm='true', duration=2.0, **pulses) as program:
        program.wait_for('excitation done')
        assert program.process.wait(10) == 0
    moving = program.output.partition('exciting for')[2]
    assert 'import time:' not in moving, 'an import delays the torques until the bridge commands 0'
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
        rig.disarm()
        program.wait_for('the bridge is no longer armed')
        assert program.process.wait(10) == 1


def test_the_exciter_does_not_arm_a_bridge_that_it_cannot_disarm(rig):
    with Program('exciter', *parameters(arm='true', **PULSES), '-r', 'bridge/disarm:=nobody/disarm') as program:
        program.wait_for('waiting: nobody serves /nobody/disarm; start the bridge or, if its node has')
        assert program.stop() == 0
    assert not rig.armed().any()


def ends_with_1(program):
    assert program.process.wait(10) == 1
    assert 'excitation done' not in program.output
    assert 'Traceback' not in program.output


def test_the_exciter_does_not_start_beside_another_program(rig, stranger):
    """Another controller, here of ros2_control."""
    publisher = stranger.create_publisher(JointState, COMMANDS, 1)
    with exciter(arm='true', **PULSES) as program:
        assert spin_until(stranger, lambda: publisher.publish(JointState()) or program.process.poll() is not None)
        output = program.wait_for('only one program may publish there')
        # The exciter may publish by then, and the bridge may refuse first.
        assert re.search(f'{COMMANDS} ha(s|ve) [12] publishers?: ', output)
        ends_with_1(program)
    assert not rig.armed().any()


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


def test_the_exciter_stops_when_samples_cease(rig):
    with exciter(arm='true', **PULSES) as program:
        program.wait_for('exciting')
        bridge = rig.programs[-1]
        bridge.halt()
        program.wait_for('stopped: no joint states for 2')
        bridge.process.send_signal(signal.SIGCONT)
        ends_with_1(program)
    rig.until(lambda: not rig.armed()[-1])


def test_the_exciter_does_not_arm_before_the_first_sample(node):
    calls = []
    node.create_service(Trigger, '/silent/bridge/arm', lambda _, answer: calls.append(1) or answer)
    with Program('exciter', *parameters(arm='true'), '-r', '__ns:=/silent') as program:
        # Logged every five seconds: by the second time the service has been discovered.
        waiting = 'waiting for /silent/joint_states: start the bridge'
        assert spin_until(node, lambda: program.output.count(waiting) == 2, 20.0), program.output
        assert node.count_clients('/silent/bridge/arm')
    assert not calls
