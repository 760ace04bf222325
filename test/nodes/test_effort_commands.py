# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Two who command one rig: the bridge obeys one of them, refuses the other, and says who they are."""

import math

import pytest

from test.rig import ARMED

pytestmark = pytest.mark.ros
#: In micro-N m, as the board's trace has them: what the driver wants, and the other.
DRIVER, OTHER = 100_000, 400_000


class Pair:
    """A rig that is armed and driven by the listener, and another node that commands, too."""

    def __init__(self, rig, ros, *parameters, name='intruder'):
        from std_msgs.msg import Float64

        self.rig, self.message = rig, Float64
        rig.start_board()
        self.bridge = rig.start_bridge(*parameters)
        rig.until_samples()
        self.node = ros.create_node(name, namespace='elsewhere')
        self.other = self.node.create_publisher(Float64, '/pendubot/effort_command', 1)
        rig.until(lambda: self.other.get_subscription_count() and rig.effort_publisher.get_subscription_count())

    def other_commands(self, torque=OTHER / 1e6):
        self.other.publish(self.message(data=torque))

    def both_until(self, condition, torque=OTHER / 1e6):
        """The driver first, each time."""

        def command():
            self.rig.effort(DRIVER / 1e6)
            self.other_commands(torque)
            return condition()

        self.rig.until(command, 20.0)

    def values(self):
        return {pair.key: pair.value for pair in self.rig.diagnoses[-1].values}


@pytest.fixture
def pair(rig, ros):
    pairs = []

    def make(*parameters):
        pairs.append(Pair(rig(), ros, *parameters))
        return pairs[-1]

    yield make
    for each in pairs:
        each.node.destroy_node()


#: A driver that a busy machine holds up for so long still drives.
PATIENT = 'command_timeout:=5.0'
REFUSED = 'effort commands of /elsewhere/intruder are refused, for /listener drives; end one'


def test_only_the_driver_moves_the_motor_and_the_other_is_named_once(pair):
    p = pair(PATIENT)
    r = p.rig
    assert r.call('arm').success
    r.drive_until(DRIVER / 1e6, lambda: r.samples[-1][6] == DRIVER / 1e6)
    p.both_until(lambda: sum(d.level == b'\x01' and REFUSED in d.message for d in r.diagnoses) >= 3)
    assert int(p.values()['refused']) > 0
    # Nor does the other disarm by a command that would.
    p.both_until(lambda: r.diagnoses.clear() or True, math.nan)
    p.both_until(lambda: any(REFUSED in d.message for d in r.diagnoses), math.nan)
    assert p.values()['not_finite'] == '0'
    assert set(r.trace()[:, 3]) == {0, DRIVER}
    assert r.trace()[-1, 4] == ARMED
    assert p.bridge.output.count(REFUSED) == 1, 'once while it lasts'


def test_it_is_not_armed_while_two_command(pair):
    p = pair(PATIENT)
    r = p.rig
    r.drive_until(DRIVER / 1e6, lambda: r.diagnoses and int(p.values()['discarded']))
    p.both_until(lambda: any(REFUSED in d.message for d in r.diagnoses))
    answer = r.call('arm')
    assert (answer.success, answer.message) == (False, REFUSED)
    assert not (r.trace()[:, 4] & ARMED).any()


def test_another_drives_once_the_first_is_silent(pair):
    p = pair('command_timeout:=0.3')
    r = p.rig
    assert r.call('arm').success
    r.drive_until(DRIVER / 1e6, lambda: r.samples[-1][6] == DRIVER / 1e6)
    r.until(lambda: p.other_commands() or r.samples[-1][6] == OTHER / 1e6)
    # Silent for so long, the first had lost its right: the torque was 0 in between.
    torques = list(dict.fromkeys(r.trace()[:, 3].tolist()[::-1]))[::-1]
    assert torques[-2:] == [0, OTHER] or torques == [0, DRIVER, OTHER]


def test_another_drives_as_soon_as_the_first_is_gone(pair):
    """Long before its last command is too old."""
    p = pair('command_timeout:=600.0')
    r = p.rig
    assert r.call('arm').success
    r.drive_until(DRIVER / 1e6, lambda: r.samples[-1][6] == DRIVER / 1e6)
    r.node.destroy_publisher(r.effort_publisher)
    r.until(lambda: p.other_commands() or r.samples[-1][6] == OTHER / 1e6)


def test_two_of_the_same_name_are_told_apart(pair):
    p = pair(PATIENT)
    r = p.rig
    p.other = r.node.create_publisher(p.message, '/pendubot/effort_command', 1)
    r.until(p.other.get_subscription_count)
    assert r.call('arm').success
    r.drive_until(DRIVER / 1e6, lambda: r.samples[-1][6] == DRIVER / 1e6)
    said = 'effort commands of another /listener are refused, for /listener drives'
    p.both_until(lambda: any(said in d.message for d in r.diagnoses))
    assert set(r.trace()[:, 3]) == {0, DRIVER}
