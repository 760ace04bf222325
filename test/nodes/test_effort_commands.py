# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The motor has one owner: the bridge disarms at a second publisher of effort commands."""

import math

import pytest
from sensor_msgs.msg import JointState

from pendubot_identification.nodes.bridge import CommandAge
from test.processes import Program, parameters
from test.rig import ARMED, WATCHDOG

TOPIC, JOINT_TOPIC = '/pendubot/effort_command', '/pendubot/joint_commands'
#: [micro-N m], as in the board's trace.
OWN, OTHER = 100_000, 400_000
RIVALS = f'{TOPIC} has 2 publishers: /elsewhere/stranger, /listener; only one program may publish there: end the others'
#: Fast DDS removes a killed program after 3 s.
LEASE = """
<dds xmlns="http://www.eprosima.com"><profiles>
  <participant profile_name="short" is_default_profile="true"><rtps><builtin><discovery_config>
    <leaseDuration><sec>3</sec></leaseDuration>
    <leaseAnnouncement><sec>0</sec><nanosec>200000000</nanosec></leaseAnnouncement>
  </discovery_config></builtin></rtps></participant>
</profiles></dds>
"""


def arm_and_drive(rig):
    assert rig.call('arm').success
    rig.drive_until(OWN / 1e6, lambda: rig.samples[-1][6] == OWN / 1e6)


def test_a_second_publisher_disarms_and_both_are_named_until_one_is_gone(shared_rig, stranger):
    r = shared_rig
    bridge = r.programs[-1]
    arm_and_drive(r)
    other = stranger.create_publisher(r.float64, TOPIC, 1)
    r.until(lambda: not r.trace()[-1, 4] & ARMED)
    r.until(lambda: r.diagnosed(2, f'{TOPIC} has 2 publishers: '))
    # Every diagnosis names both; the log names them once.
    r.until(lambda: sum(d.level == b'\2' and RIVALS in d.message for d in r.diagnoses) >= 3)
    assert bridge.output.count(RIVALS) == 1
    answer = r.call('arm')
    assert not answer.success
    assert answer.message.startswith(RIVALS)
    stranger.destroy_publisher(other)
    reason = 'disarmed: a second publisher of effort commands appeared; arm again'
    r.until(lambda: (d := r.diagnoses[-1]).level == b'\1' and d.message.startswith(reason))
    # The bridge does not arm again by itself.
    end = len(r.trace()) + 50
    r.drive_until(OWN / 1e6, lambda: len(r.trace()) > end)
    assert not r.trace()[-50:, 4].any()
    arm_and_drive(r)
    other = stranger.create_publisher(r.float64, TOPIC, 1)
    r.until(lambda: other.publish(r.float64(data=OTHER / 1e6)) or not r.trace()[-1, 4] & ARMED)
    assert set(r.trace()[:, 3]) == {0, OWN}
    assert not (r.trace()[:, 4] & WATCHDOG).any(), 'by command, not by the watchdog'


def test_a_second_publisher_of_joint_states_prevents_arming(shared_rig, stranger):
    """Otherwise one call to arm, and one controller, would move both rigs."""
    r = shared_rig
    other = stranger.create_publisher(JointState, '/joint_states', 1)
    answers = []
    r.until(lambda: answers.append(r.call('arm')) or not answers[-1].success)
    assert '/joint_states has 2 publishers: ' in answers[-1].message
    assert r.call('confirm_zeros').message.startswith('/joint_states has 2 publishers: ')
    r.until(lambda: not r.trace()[-1, 4] & ARMED)
    stranger.destroy_publisher(other)
    r.until(lambda: r.call('arm').success)


def test_a_killed_publisher_counts_until_its_lease_ends(shared_rig, tmp_path):
    profile = tmp_path / 'short.xml'
    profile.write_text(LEASE)
    r = shared_rig
    env = {'FASTRTPS_DEFAULT_PROFILES_FILE': str(profile), 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}
    with Program('exciter', *parameters(), env=env) as exciter:
        exciter.wait_for('waiting to be armed')
        r.until(lambda: r.node.count_publishers(TOPIC) == 1)
        exciter.kill()
    r.until(r.effort_publisher.get_subscription_count)
    # The bridge may discover a publisher before the name of its node.
    r.until(lambda: '2 publishers: /exciter, /listener;' in r.call('arm').message)
    answer = r.call('arm')
    assert not answer.success
    assert 'a killed program counts until its DDS lease ends' in answer.message
    r.until(lambda: r.call('arm').success, 30.0)


class Ros2Control:
    """Publishes like joint_state_topic_hardware_interface 1.0.0: both names, and an effort per command interface.

    The effort is NaN before a controller is active.
    """

    def __init__(self, node, rig):
        self.node, self.rig, self.publisher = node, rig, node.create_publisher(JointState, JOINT_TOPIC, 1)

    def until(self, condition, *efforts, names=('shoulder', 'elbow')):
        """Repeat a command until a condition is true."""

        def commanded():
            message = JointState(name=names, effort=efforts)
            message.header.stamp = self.node.get_clock().now().to_msg()
            self.publisher.publish(message)
            return condition()

        self.rig.until(commanded)


def test_ros2_control_drives_the_motor_by_joint_commands_and_nan_is_no_command(shared_rig, stranger):
    r, controller = shared_rig, Ros2Control(stranger, shared_rig)
    controller.until(controller.publisher.get_subscription_count, math.nan)
    assert r.call('arm').success
    controller.until(lambda: r.samples[-1][6] == OWN / 1e6, OWN / 1e6)
    # An effort per name, zero for the elbow, is equivalent.
    controller.until(lambda: r.samples[-1][6] == OTHER / 1e6, 0.0, OTHER / 1e6, names=('elbow', 'shoulder'))
    # After deactivation of the controller the torque ends with the timeout, and the motor stays armed.
    controller.until(lambda: r.samples[-1][6] == 0, math.nan)
    assert r.trace()[-1, 4] & ARMED
    assert not (r.trace()[:, 4] & WATCHDOG).any()
    for efforts, names, warning in (
        ((), ('shoulder', 'elbow'), '0 efforts for the joints shoulder, elbow; the effort of shoulder is expected'),
        ((0.1,), ('elbow',), 'it has 1 efforts for the joints elbow; the effort of shoulder is expected'),
        ((0.1, 0.1), ('shoulder', 'elbow'), 'it has an effort for elbow, and only shoulder has a motor'),
    ):
        controller.until(lambda warning=warning: warning in r.programs[-1].output, *efforts, names=names)
    assert set(r.trace()[:, 3]) == {0, OWN, OTHER}


def test_joint_commands_and_effort_commands_together_have_one_publisher(shared_rig, stranger):
    r = shared_rig
    arm_and_drive(r)
    controller = Ros2Control(stranger, r)
    controller.until(lambda: not r.trace()[-1, 4] & ARMED, OTHER / 1e6)
    assert not (r.trace()[:, 4] & WATCHDOG).any()
    assert set(r.trace()[:, 3]) == {0, OWN}
    both = f'{TOPIC} and {JOINT_TOPIC} have 2 publishers: /elsewhere/stranger, /listener; only one program may publish'
    r.until(lambda: r.call('arm').message.startswith(both))


def test_the_torque_limit_may_be_lowered_while_it_runs_and_raised_only_while_disarmed(shared_rig):
    r = shared_rig

    def limited(value):
        answer = r.set('/bridge', torque_limit=value)
        return answer.successful or answer.reason

    assert limited(0.5) is True
    assert r.call('arm').success
    r.drive_until(1.0, lambda: r.samples[-1][6] == 0.5)
    assert limited(0.2) is True
    r.drive_until(1.0, lambda: r.samples[-1][6] == 0.2)
    assert 'is not raised while the motor is armed; call ~/disarm first' in limited(0.3)
    r.disarm()
    assert limited(0.3) is True
    assert r.call('arm').success
    r.drive_until(1.0, lambda: r.samples[-1][6] == 0.3)
    assert set(r.trace()[:, 3]) == {0, 200_000, 300_000, 500_000}
    r.disarm()
    assert limited(2.0) is True


MS, SECOND = 10**6, 10**9
START = 1_700_000_000 * SECOND


def send(age, seconds, start=START, offset=0):
    """Return the age [s] of commands at 100 Hz from ``start``, by the receiver's clock, with a latency of 2 ms."""
    return [age.measure(t - 2 * MS + offset, t) for t in range(start, start + round(seconds * SECOND), 10 * MS)]


@pytest.mark.parametrize('offset', [0, 3600 * SECOND, -3600 * SECOND])
@pytest.mark.parametrize('pause', [0.3, 7.0, 3600.0])
def test_the_age_of_a_command_is_its_delay_beyond_the_least_latency_for_any_offset_of_clocks(offset, pause):
    age = CommandAge()
    assert max(send(age, 20.0, offset=offset)) < 1e-6
    sent = START + 20 * SECOND
    assert age.measure(sent + offset, sent + round(pause * 1e9)) == pytest.approx(pause - 0.002)
    assert max(send(age, 20.0, sent + round(pause * 1e9), offset)) < 1e-6


@pytest.mark.parametrize('step', [3600, -3600, 1, -1])
def test_after_a_publishers_clock_is_set_its_commands_are_rejected_for_ten_seconds_at_most(step):
    # A publisher's clock that is set forward makes no command old. On one machine both clocks are set at once.
    age, both = CommandAge(), CommandAge()
    send(age, 7.0)
    ages = send(age, 20.0, START + 7 * SECOND, step * SECOND)
    assert max(ages[1000:]) < 0.1
    assert (max(ages) > 0.1) == (step < 0)
    send(both, 7.0)
    assert max(send(both, 20.0, START + (7 + step) * SECOND)) < 1e-6
