# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The age of commands, with clocks that differ, are set, or pause."""

import pytest

from pendubot_identification.nodes.bridge import CommandAge

MS, SECOND = 10**6, 10**9
START = 1_700_000_000 * SECOND


def send(age, seconds, start=START, offset=0, latency=0.002):
    """Commands at 100 Hz from ``start`` on by the taker's clock; returns when [s] each was taken and its age [s]."""
    taken = [start + k * 10 * MS for k in range(round(100 * seconds))]
    return [(t - start) / 1e9 for t in taken], [age.measure(t - round(latency * 1e9) + offset, t) for t in taken]


@pytest.mark.parametrize('offset', [0, 3600 * SECOND, -3600 * SECOND])
@pytest.mark.parametrize('pause', [0.3, 7.0, 3600.0])
def test_a_command_is_as_old_as_it_waited_longer_than_the_fastest_whatever_its_publishers_clock(offset, pause):
    age = CommandAge()
    assert max(send(age, 20.0, offset=offset)[1]) < 1e-6
    sent = START + 20 * SECOND
    assert age.measure(sent + offset, sent + round(pause * 1e9)) == pytest.approx(pause - 0.002)
    assert max(send(age, 20.0, sent + round(pause * 1e9), offset)[1]) < 1e-6


@pytest.mark.parametrize('step', [3600.0, -3600.0, 1.0, -1.0])
def test_a_clock_that_was_set_keeps_commands_out_for_ten_seconds_at_most(step):
    age = CommandAge()
    send(age, 7.0)
    taken, ages = send(age, 20.0, START + 7 * SECOND, round(step * 1e9))
    late = [t for t, each in zip(taken, ages, strict=True) if each > 0.1]
    assert not late or max(late) <= 10.0
    assert bool(late) == (step < 0), 'a clock that runs ahead makes nothing old'


@pytest.mark.parametrize('step', [3600, -3600])
def test_the_takers_own_clock_may_be_set_too(step):
    age = CommandAge()
    send(age, 7.0)
    # On the same machine both clocks are set at once.
    assert max(send(age, 20.0, START + (7 + step) * SECOND)[1]) < 1e-6
