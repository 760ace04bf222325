# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The balancer with a real bridge and the virtual board, each in its own process."""

import signal

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from pendubot_identification.model.parameters import BALANCE
from pendubot_identification.nodes.messages import LATCHED
from test.live import LiveRig
from test.nodes.observer import values
from test.processes import parameters
from test.rig import ARMED, PATIENT, WATCHDOG

EFFORT, PARAMS = '/pendubot/effort_command', '/pendubot/params'
#: Largest age of a sample [s] on a busy machine.
PATIENCE = 2.0


@pytest.fixture
def rig(ros, tmp_path):
    with LiveRig(tmp_path) as rig:
        yield rig


def patient(rig, *options):
    """Start a board, a bridge and a balancer with long timeouts; return the balancer."""
    rig.start_board(*options)
    rig.start_bridge(*PATIENT)
    return rig.start('balancer', *parameters(max_age=PATIENCE))


def begin_and_hold(rig):
    """Start balancing and wait until the rig was held for a moment."""
    rig.begin()
    rig.until(lambda: rig.held()[1] > 0.3, 60.0)


def stays_disarmed(rig):
    cut = len(rig.trace())
    rig.until(lambda: len(rig.trace()) > cut + 100)
    return not (rig.trace()[cut:, 4] & ARMED).any()


def test_it_waits_for_usable_parameters_and_publishes_torques_only_while_it_drives(rig):
    balancer = patient(rig, '--patient')
    rig.effort(0.0)  # another program, which drives no motor
    balancer.wait_for('waiting: no parameters were received on pendubot/params')
    rig.publish(level=2, message='useless')
    balancer.wait_for('level ERROR (useless)')
    rig.publish([1e300] * 7)
    balancer.wait_for('waiting: the parameters are unphysical')
    assert not rig.call('/balancer/start').success
    rig.publish()
    balancer.wait_for('prepared', 60.0)
    # An idle balancer does not keep another program from driving the motor.
    assert rig.node.count_publishers(EFFORT) == 1
    refused = rig.call('/balancer/start')
    assert not refused.success
    assert f'{EFFORT} has 1 publisher: /listener; only one program may publish there' in refused.message
    rig.node.destroy_publisher(vars(rig).pop('effort_publisher'))

    begin_and_hold(rig)
    # An exciter that starts while the balancer drives ends without disarming.
    cut = len(rig.trace())
    exciter = rig.start('exciter', *parameters(arm='true'))
    exciter.wait_for(f'{EFFORT} has 1 publisher: /balancer;')
    assert exciter.process.wait(10) == 1
    assert (rig.trace()[cut:, 4] & ARMED).all()
    rig.until(lambda: 'delay margin [s]' in values(rig.said()[-1]))
    assert float(values(rig.said()[-1])['delay margin [s]']) == pytest.approx(0.023, abs=0.001)
    rig.publish([1.02 * value for value in BALANCE.vector()])
    balancer.wait_for('prepared')
    rig.until(lambda: rig.held()[1] > 1.0, 60.0)
    assert np.abs(rig.motion()[2]).max() <= 2.0
    assert rig.call('/balancer/stop').success
    rig.until(lambda: not rig.node.count_publishers(EFFORT))
    rig.until(lambda: not rig.trace()[-1, 4] & ARMED)
    rig.begin()
    rig.publish([*BALANCE.vector()[:2], 0.02, *BALANCE.vector()[3:]])
    balancer.wait_for('stopped: the parameters are unphysical')
    rig.until(lambda: not rig.trace()[-1, 4] & ARMED)


def test_a_failure_of_bridge_board_or_balancer_stops_the_motor_for_good(rig):
    balancer = patient(rig)
    board, bridge, _ = rig.programs
    rig.publish()
    balancer.wait_for('prepared', 60.0)
    board.stop()  # the rig has fallen until the balancer is ready
    board = rig.start_board()
    begin_and_hold(rig)
    # A halted bridge forwards neither samples nor commands: the board's watchdog stops the motor.
    bridge.halt()
    rig.until(lambda: rig.trace()[-1, 4] & WATCHDOG, 30.0)
    tripped = len(rig.trace())
    balancer.wait_for('stopped: ')
    bridge.process.send_signal(signal.SIGCONT)
    assert stays_disarmed(rig)
    assert not rig.trace()[tripped:, 3].any()
    rig.until(lambda: rig.said()[-1].level == b'\x02')

    board.stop()
    board = rig.start_board(seed=2)
    begin_and_hold(rig)
    board.kill()
    rig.port.unlink()  # another program may get the same pseudo-terminal
    balancer.wait_for('stopped: ')
    rig.start_board(seed=3)
    assert stays_disarmed(rig)

    begin_and_hold(rig)
    balancer.kill()
    # The motor is still armed when the command timeout sets its torque to zero.
    rig.until(lambda: not rig.trace()[-200:, 3].any())
    assert rig.trace()[np.flatnonzero(rig.trace()[:, 3])[-1] + 1, 4] & ARMED
    rig.disarm()
    rig.publish()
    rig.start('balancer').wait_for('prepared')
    assert stays_disarmed(rig), 'a restarted balancer must not arm by itself'


def test_a_start_without_an_answer_of_the_bridge_is_refused_and_a_late_answer_moves_nothing(rig):
    rig.start_board()
    bridge = rig.start_bridge(*PATIENT)
    # The clock of ROS stands still.
    rig.start('balancer', *parameters(max_age=10.0, use_sim_time='true')).wait_for('waiting')
    rig.publish()
    rig.programs[-1].wait_for('prepared', 60.0)
    client = rig.node.create_client(rig.trigger, '/balancer/start')
    assert client.wait_for_service(30.0)
    bridge.halt()
    answer = rig.wait(client.call_async(rig.trigger.Request()))
    assert not answer.success
    assert answer.message == 'the bridge did not answer within 3 s whether it is armed; start again'
    rig.until(lambda: rig.said() and rig.said()[-1].message == f'stopped: {answer.message}')
    bridge.process.send_signal(signal.SIGCONT)
    # The request to arm was received first, and then the request to disarm.
    rig.until(lambda: stays_disarmed(rig))
    rig.until(lambda: not rig.node.count_publishers(EFFORT))
    assert not rig.trace()[:, 3].any()


def test_inputs_with_two_publishers_are_ignored_and_a_second_publisher_of_joint_states_stops_it(rig, stranger):
    def foreign_parameters():
        publisher = stranger.create_publisher(Float64MultiArray, PARAMS, LATCHED)
        publisher.publish(Float64MultiArray(data=[3.0 * value for value in BALANCE.vector()]))
        return publisher

    def refuses_to_start(topic, own):
        names = ', '.join(sorted([own, '/elsewhere/stranger']))
        rivals = f'{topic} has 2 publishers: {names}; only one program may publish there'
        rig.until(lambda: any(each.level == b'\2' and rivals in each.message for each in rig.said()))
        answer = rig.call('/balancer/start')
        return not answer.success and answer.message.startswith(rivals)

    foreign = foreign_parameters()
    rig.publish()
    balancer = patient(rig, '--patient')
    balancer.wait_for(f'a message was ignored: {PARAMS} has 2 publishers: /elsewhere/stranger, /listener; only one')
    assert refuses_to_start(PARAMS, '/listener')
    stranger.destroy_publisher(foreign)
    balancer.wait_for('prepared', 60.0)
    for kind, topic, own in (
        (DiagnosticArray, '/pendubot/identification', '/listener'),
        (JointState, '/joint_states', '/bridge'),
    ):
        second = stranger.create_publisher(kind, topic, LATCHED)
        assert refuses_to_start(topic, own)
        stranger.destroy_publisher(second)
    begin_and_hold(rig)
    # While the balancer drives, parameters of a second publisher have no effect.
    prepared = balancer.output.count('prepared')
    foreign_parameters()
    balancer.wait_for('a message was ignored: /pendubot/params has 2 publishers')
    cut = len(rig.trace())
    rig.until(lambda: len(rig.trace()) > cut + 200)
    assert balancer.output.count('prepared') == prepared
    stranger.create_publisher(JointState, '/joint_states', 1)
    balancer.wait_for('stopped: /joint_states has 2 publishers: ')
    rig.until(lambda: not rig.trace()[-1, 4] & ARMED)
    rig.until(lambda: rig.said()[-1].level == b'\2' and '/joint_states has 2 publishers' in rig.said()[-1].message)
