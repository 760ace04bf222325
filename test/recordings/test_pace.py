import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pendubot_identification.recordings.pace import SECOND, Pace

RATES = st.floats(0.01, 100.0)
TIMES = st.integers(0, 10**12)


@given(RATES, TIMES, st.integers(1, 10**12))
def test_what_is_waited_for_is_due_then_and_not_before(rate, now, ahead):
    pace = Pace(5 * SECOND, rate, now)
    seconds = pace.wait(5 * SECOND + ahead, now)
    assert seconds == pytest.approx(ahead / rate / SECOND)
    assert pace.position(now + round(seconds * SECOND)) == pytest.approx(5 * SECOND + ahead, abs=rate + 1)
    assert pace.wait(5 * SECOND, now) == 0


@given(st.lists(st.tuples(st.sampled_from(['pause', 'resume', 'rate']), RATES, st.integers(0, 10**10)), max_size=20))
def test_the_position_is_the_sum_of_what_was_played(steps):
    now = position = 0
    rate, paused = 1.0, False
    pace = Pace(0, rate, now)
    for action, new_rate, elapsed in steps:
        if action == 'rate':
            rate = new_rate
            pace.set_rate(rate, now)
        else:
            paused = action == 'pause'
            pace.pause(paused, now)
        now += elapsed
        position += 0 if paused else rate * elapsed
        assert pace.position(now) == pytest.approx(position, rel=1e-9, abs=2 * len(steps))


def test_nothing_is_due_while_paused():
    pace = Pace(0, 1.0, 0)
    pace.pause(True, SECOND)
    assert pace.wait(2 * SECOND, 100 * SECOND) == math.inf
    assert pace.wait(0, 100 * SECOND) == math.inf
    pace.jump(7, 100 * SECOND)
    assert pace.position(200 * SECOND) == 7
