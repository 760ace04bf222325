# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The age of commands, with clocks that differ or are set, and with pauses."""

import pytest

from pendubot_identification.nodes.bridge import CommandAge

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
