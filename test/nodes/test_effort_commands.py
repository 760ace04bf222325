# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Two who command one rig: the bridge obeys one of them, refuses the other, and says who they are."""

import math

import pytest

from test.rig import ARMED

pytestmark = [pytest.mark.ros, pytest.mark.usefixtures('each_board')]
TOPIC = '/pendubot/effort_command'
#: In micro-N m, as the board's trace has them: what the driver wants, and the other.
DRIVER, OTHER = 100_000, 400_000
REFUSED = 'effort commands of /elsewhere/intruder are refused, for /listener drives; end one'


@pytest.fixture
def intruder(ros):
    node = ros.create_node('intruder', namespace='elsewhere')
    yield node
    node.destroy_node()


def both_until(rig, other, condition, torque=OTHER / 1e6):
    """Both command, the driver first each time, until a condition holds."""

    def command():
        rig.effort(DRIVER / 1e6)
        other.publish(rig.float64(data=torque))
        return condition()

    rig.until(command, 20.0)


def started(rig, timeout, other):
    rig.start_board()
    bridge = rig.start_bridge(f'command_timeout:={timeout}')
    rig.until_samples()
    rig.until(lambda: other.get_subscription_count() and rig.effort_publisher.get_subscription_count())
    return bridge


def test_only_the_driver_moves_the_motor_until_it_is_gone_and_the_other_is_named_once(rig, intruder):
    r = rig()
    other = intruder.create_publisher(r.float64, TOPIC, 1)
    # Even one that a busy machine holds up for long still drives.
    bridge = started(r, 600.0, other)
    assert r.call('arm').success
    r.drive_until(DRIVER / 1e6, lambda: r.samples[-1][6] == DRIVER / 1e6)
    both_until(r, other, lambda: sum(d.level == b'\x01' and REFUSED in d.message for d in r.diagnoses) >= 2)
    assert bridge.output.count(REFUSED) == 1, 'once while it lasts'
    # Nor does the other disarm by a command that would.
    r.diagnoses.clear()
    both_until(r, other, lambda: r.diagnosed(1, REFUSED), math.nan)
    values = r.fresh_values()
    assert int(values['refused']) > 0
    assert values['not_finite'] == '0'
    # Two of the same name are told apart.
    twin = r.node.create_publisher(r.float64, TOPIC, 1)
    r.until(twin.get_subscription_count)
    said = 'effort commands of another /listener are refused, for /listener drives'
    both_until(r, twin, lambda: r.diagnosed(1, said))
    assert set(r.trace()[:, 3]) == {0, DRIVER}
    assert r.trace()[-1, 4] == ARMED
    r.node.destroy_publisher(r.effort_publisher)
    r.until(lambda: other.publish(r.float64(data=OTHER / 1e6)) or r.samples[-1][6] == OTHER / 1e6)


def test_it_is_not_armed_while_two_command_and_another_drives_once_the_first_is_silent(rig, intruder):
    r = rig()
    other = intruder.create_publisher(r.float64, TOPIC, 1)
    started(r, 1.0, other)
    client = r.node.create_client(r.trigger, '/bridge/arm')
    assert client.wait_for_service(10)
    # The first from whom a command comes drives.
    r.drive_until(DRIVER / 1e6, lambda: r.diagnoses and int(r.values()['discarded']))
    both_until(r, other, lambda: r.diagnosed(1, REFUSED))
    asked = client.call_async(r.trigger.Request())
    both_until(r, other, asked.done)
    assert (asked.result().success, asked.result().message) == (False, REFUSED)
    assert not (r.trace()[:, 4] & ARMED).any()
    r.drive_until(DRIVER / 1e6, lambda: r.call('arm').success)
    r.drive_until(DRIVER / 1e6, lambda: r.samples[-1][6] == DRIVER / 1e6)
    r.until(lambda: other.publish(r.float64(data=OTHER / 1e6)) or r.samples[-1][6] == OTHER / 1e6)
