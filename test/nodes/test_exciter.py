# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The exciter with a real bridge and the virtual board: what the board applied is what was drawn."""

import csv
import signal
from itertools import pairwise

import pytest

from pendubot_identification.excitation.excitation import PulseTrain
from pendubot_identification.recordings.bag_reader import read_trajectory
from test.processes import Program, call, parameters, run_program, spin_until

pytestmark = pytest.mark.ros


@pytest.fixture
def rig(tmp_path):
    """A virtual board and a bridge that outlasts a machine's pauses; gives the trace of what the board did."""
    trace = tmp_path / 'trace.csv'
    with Program('virtual_board', '--link', tmp_path / 'board', '--trace', trace) as board:
        board.wait_for('virtual board on')
        with Program('bridge', *parameters(port=tmp_path / 'board', watchdog_ms=500, link_timeout=2.0)) as bridge:
            yield lambda: list(csv.DictReader(trace.open())), bridge


def torques(rows):
    return [int(row['torque']) for row in rows]


def test_excites_by_the_pulse_train_then_ends_disarmed(rig):
    trace, _ = rig
    pulses = {'period': 0.2, 'width': 0.5, 'amplitude_min': -0.3, 'amplitude_max': 0.4, 'hold': 0.02, 'seed': 7}
    with Program('exciter', *parameters(arm='true', duration=2.0, **pulses)) as exciter:
        exciter.wait_for('excitation done')
        assert exciter.process.wait(10) == 0
    applied = torques(trace())
    drawn = {round(1e6 * PulseTrain(**pulses).torque(k * 0.01)) for k in range(200)}
    assert set(applied) <= drawn | {0}
    assert len(set(applied)) > 20
    assert applied[-1] == 0
    assert int(trace()[-1]['status']) & 1 == 0, 'disarmed at the end'


@pytest.mark.parametrize('number', [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_leaves_zero_torque_and_a_disarmed_board(rig, number):
    trace, _ = rig
    with Program('exciter', *parameters(arm='true', duration=0.0, width=1.0, amplitude_min=0.1)) as exciter:
        exciter.wait_for('exciting')
        assert exciter.stop(number) == 0
    rows = trace()
    assert torques(rows)[-1] == 0
    assert int(rows[-1]['status']) & 1 == 0


def test_moves_nothing_before_it_is_armed(rig, ros):
    from std_srvs.srv import Trigger

    trace, _ = rig
    node = ros.create_node('operator')
    try:
        client = node.create_client(Trigger, '/bridge/arm')
        with Program('exciter', *parameters(duration=60.0, width=1.0, amplitude_min=0.1)) as exciter:
            exciter.wait_for('waiting to be armed')
            assert set(torques(trace())) == {0}
            assert call(node, client, Trigger.Request()).success
            exciter.wait_for('exciting')
            assert spin_until(node, lambda: any(torques(trace())))
    finally:
        node.destroy_node()


def test_moves_nothing_that_is_not_recorded(rig, ros, tmp_path):
    """By itself it arms only when a recorder writes; one that has nothing to write to is none."""
    trace, _ = rig
    node = ros.create_node('operator')
    (tmp_path / 'taken').mkdir()
    pulses = {'duration': 0.0, 'width': 1.0, 'amplitude_min': 0.1, 'amplitude_max': 0.2}
    with Program('exciter', *parameters(arm='true', recorded='true', **pulses)) as exciter:
        exciter.wait_for('waiting for a recorder of /joint_states')
        assert run_program('recorder', *parameters(output=tmp_path / 'taken')).returncode == 1
        # It says so every five seconds.
        exciter.wait_for('waiting for a recorder of /joint_states')
        assert not any(int(row['status']) & 1 for row in trace())
        with Program('recorder', *parameters(output=tmp_path / 'bag')) as recorder:
            exciter.wait_for('exciting')
            begun = len(trace())
            assert spin_until(node, lambda: len(trace()) > begun + 50)
            recorder.kill()
            exciter.wait_for('stopped: nothing was recorded for 5 s; look at the recorder')
            assert exciter.process.wait(10) == 1
    node.destroy_node()
    assert int(trace()[-1]['status']) & 1 == 0
    torque = read_trajectory(tmp_path / 'bag').trajectory.tau[:, 0]
    assert torque[0] == 0.0, 'it moved before it was recorded'
    assert torque.any()


def test_moves_nothing_that_is_not_recorded_whoever_arms(rig, ros, tmp_path):
    from std_srvs.srv import Trigger

    trace, _ = rig
    node = ros.create_node('operator')
    try:
        with Program('exciter', *parameters(recorded='true', width=1.0, amplitude_min=0.1, duration=0.0)) as exciter:
            exciter.wait_for('waiting for a recorder')
            assert call(node, node.create_client(Trigger, '/bridge/arm'), Trigger.Request()).success
            exciter.wait_for('waiting for a recorder')
            assert set(torques(trace())) == {0}
            with Program('recorder', *parameters(output=tmp_path / 'bag')):
                exciter.wait_for('exciting')
    finally:
        node.destroy_node()


def test_arms_only_once_joint_states_come(ros):
    from sensor_msgs.msg import JointState
    from std_srvs.srv import Trigger

    node, asked = ros.create_node('bridge'), []
    try:
        node.create_service(Trigger, '~/arm', lambda _, answer: asked.append(1) or answer)
        joint_states = node.create_publisher(JointState, '/joint_states', 10)
        with Program('exciter', *parameters(arm='true')) as exciter:
            # It says so every five seconds: at the second time it has long found the service.
            assert spin_until(node, lambda: exciter.output.count('waiting for /joint_states') == 2, 20.0)
            assert node.count_clients('/bridge/arm')
            assert not asked
            assert spin_until(node, lambda: joint_states.publish(JointState()) or asked)
            exciter.wait_for('the bridge did not arm')
    finally:
        node.destroy_node()


def test_stops_when_the_motor_is_disarmed(rig, ros):
    from std_srvs.srv import Trigger

    node = ros.create_node('operator')
    try:
        client = node.create_client(Trigger, '/bridge/disarm')
        with Program('exciter', *parameters(arm='true', duration=0.0)) as exciter:
            exciter.wait_for('exciting')
            assert call(node, client, Trigger.Request()).success
            exciter.wait_for('the bridge is no longer armed')
            assert exciter.process.wait(10) == 1
    finally:
        node.destroy_node()


@pytest.fixture
def armed_bridge(ros):
    """A node in the bridge's place that says it is armed, and publishes joint states when told to."""
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64

    node, torques = ros.create_node('bridge'), []
    diagnostics = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
    joint_states = node.create_publisher(JointState, '/joint_states', 10)
    node.create_subscription(Float64, '/pendubot/effort_command', lambda m: torques.append(m.data), 100)
    armed = DiagnosticStatus(name='bridge', values=[KeyValue(key='armed', value='True')])
    node.create_timer(0.1, lambda: diagnostics.publish(DiagnosticArray(status=[armed])))
    yield node, lambda: joint_states.publish(JointState()), torques
    node.destroy_node()


def test_waits_for_the_first_sample_of_an_armed_bridge(armed_bridge):
    """It may hear that the bridge is armed before it hears a joint state."""
    node, publish, torques = armed_bridge
    with Program('exciter', *parameters(duration=0.0)) as exciter:
        assert not spin_until(node, lambda: exciter.process.poll() is not None, 5.5), exciter.output
        assert spin_until(node, lambda: publish() or torques), exciter.output
        exciter.wait_for('exciting for inf s')
        assert spin_until(node, lambda: exciter.process.poll() == 1), 'the samples ended'
        exciter.wait_for('stopped: no joint states for 2')


def test_says_how_long_it_waited_for_a_first_sample_that_never_came(armed_bridge):
    node, _, torques = armed_bridge
    with Program('exciter', *parameters(duration=0.0)) as exciter:
        assert spin_until(node, lambda: exciter.process.poll() == 1, 20.0), exciter.output
        exciter.wait_for('stopped: no joint states for 4')
    assert not any(torques)


def test_refuses_where_another_drives_the_rig(rig, ros):
    from std_msgs.msg import Float64

    trace, _ = rig
    pulses = {'duration': 0.0, 'width': 1.0, 'amplitude_min': 0.1, 'amplitude_max': 0.2}
    with Program('exciter', *parameters(arm='true', **pulses)) as first:
        first.wait_for('exciting')
        with Program('exciter', *parameters(arm='true', duration=0.0, amplitude_max=0.9)) as second:
            second.wait_for('/exciter drives this rig, too; end it')
            assert second.process.wait(10) == 1
        assert first.process.poll() is None, 'the first goes on'
        assert first.stop() == 0
    armed = [int(row['status']) & 1 for row in trace()]
    assert sum(a != b for a, b in pairwise(armed)) == 2, 'armed once, and till the end'
    assert max(torques(trace())) <= 200_000
    balancer = ros.create_node('balancer', namespace='lab')
    try:
        balancer.create_publisher(Float64, '/pendubot/effort_command', 1)
        # It does not arm: so it looks around for longer than a busy machine takes to show it who is there.
        with Program('exciter') as exciter:
            exciter.wait_for('/lab/balancer drives this rig, too')
    finally:
        balancer.destroy_node()


def test_leaves_the_rig_to_a_balancer_that_moves_and_to_no_idle_one(rig, ros):
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
    from std_msgs.msg import Float64

    trace, _ = rig
    pulses = {'duration': 0.0, 'width': 1.0, 'amplitude_min': 0.1, 'amplitude_max': 0.2}
    with Program('exciter', *parameters(arm='true', **pulses)) as exciter:
        exciter.wait_for('exciting')
        balancer = ros.create_node('balancer')
        try:
            balancer.create_publisher(Float64, '/pendubot/effort_command', 1)
            diagnostics = balancer.create_publisher(DiagnosticArray, '/diagnostics', 10)

            def say(phase):
                values = [KeyValue(key='phase', value=phase)]
                diagnostics.publish(DiagnosticArray(status=[DiagnosticStatus(name='balancer', values=values)]))

            assert spin_until(balancer, lambda: diagnostics.get_subscription_count() == 1)
            cut = len(trace())
            assert spin_until(balancer, lambda: say('idle') or len(trace()) > cut + 100)
            assert exciter.process.poll() is None
            assert spin_until(balancer, lambda: say('running') or exciter.process.poll() is not None)
            assert exciter.process.returncode == 1
            exciter.wait_for('/balancer drives this rig, too')
        finally:
            balancer.destroy_node()
    assert int(trace()[-1]['status']) & 1, 'it would fall'


def test_stops_when_the_bridge_is_gone(rig):
    _, bridge = rig
    with Program('exciter', *parameters(arm='true', duration=0.0)) as exciter:
        exciter.wait_for('exciting')
        bridge.kill()
        exciter.wait_for('no joint states for')
        assert exciter.process.wait(10) == 1


def test_says_why_the_bridge_did_not_arm(tmp_path):
    link = tmp_path / 'board'
    with Program('virtual_board', '--link', link, '--fault', 'emergency_stop_at=0') as board:
        board.wait_for('virtual board on')
        with (
            Program('bridge', *parameters(port=link)),
            Program('exciter', *parameters(arm='true')) as exciter,
        ):
            exciter.wait_for('the bridge did not arm')
            assert exciter.process.wait(10) == 1


@pytest.mark.parametrize(
    ('values', 'sentence'),
    [
        ({'amplitude_min': 1.0, 'amplitude_max': -1.0}, 'amplitude_min 1 is not below amplitude_max -1'),
        ({'width': 2.0}, 'width is 2.0; a number with a decimal point from 0.001 to 1 is expected'),
        ({'period': 'soon'}, 'period is soon'),
        ({'period': '.nan'}, 'period is nan'),
    ],
)
def test_settings_without_sense_are_refused_in_a_sentence(values, sentence):
    refused = run_program('exciter', *parameters(**values))
    assert refused.returncode == 1
    assert sentence in refused.stderr
    assert refused.stderr.count('\n') == 1
