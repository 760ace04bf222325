# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The board's clock in host time: delays are positive, skew is estimated, timestamps increase."""

import numpy as np
import pytest

from pendubot_identification.link.clock import BoardClock

#: Host time of the board's first sample [ns], and the least latency of a sample [s].
BEGUN, DELAY = 5 * 10**12, 1e-4


def stamp(clock, t_us, arrival_ns):
    return clock.stamp(clock.host_time(clock.observe(t_us, arrival_ns)))


def run(clock, t, late=0.0, skew_ppm=0.0, start_us=0):
    """Stamp samples of board times t [s] with additional latencies [s]; return the errors of the timestamps [us].

    Samples arrive in order: a late one delays its successors.
    """
    true = np.round(t * 1e6) * (1 + skew_ppm * 1e-6)
    arrival = np.maximum.accumulate(1e3 * true + 1e9 * (DELAY + late)).astype(np.int64) + BEGUN
    board = (start_us + np.round(t * 1e6).astype(np.int64)) % 2**32
    stamps = np.array([stamp(clock, int(b), int(a)) for b, a in zip(board, arrival, strict=True)])
    assert (np.diff(stamps) > 0).all()
    return (stamps - BEGUN) / 1e3 - true - 1e6 * DELAY


def times(seconds, rate=1000):
    return np.arange(round(seconds * rate)) / rate


def jitter(t, mean_us=80.0):
    return np.random.default_rng(1).exponential(1e-6 * mean_us, len(t))


def test_timestamps_are_free_of_jitter_and_of_the_counters_wrap():
    error = run(BoardClock(), t := times(5), jitter(t), start_us=2**32 - 2_000_000)
    assert np.abs(error[100:]).max() < 20


def test_skew_is_estimated_within_seconds_and_tracked():
    clock = BoardClock()
    run(clock, t := times(0.3), jitter(t), -300.0)
    assert clock.skew_ppm == 0, 'no estimate within 0.3 s'
    error = run(clock := BoardClock(), t := times(60, 250), jitter(t), -300.0)
    assert np.percentile(np.abs(error[:1500] - np.median(error[:1500])), 99) < 150
    assert np.abs(error[1000:5000]).max() < 60
    assert np.percentile(np.abs(error[5000:]), 99) < 50
    assert clock.skew_ppm == pytest.approx(-300, abs=1.0)


@pytest.mark.parametrize(('skew', 'wrong'), [(900.0, 0.0), (-3000.0, -0.003)])
def test_a_rate_error_beyond_any_crystals_is_detected_within_a_second_and_tracked(skew, wrong):
    clock = BoardClock()
    run(clock, t := times(1), jitter(t), skew)
    assert clock.wrong_rate == pytest.approx(wrong, rel=0.1)
    error = run(BoardClock(), t := times(5), jitter(t), skew)
    assert np.abs(error[2000:]).max() < 100


@pytest.mark.parametrize(('rate', 'off_us'), [(1000, 8000), (100, -65_536)])
def test_one_wrong_board_time_changes_no_timestamp(rate, off_us):
    """A 16-bit timer that is read during its overflow causes such times."""
    right, wrong, irregular = BoardClock(), BoardClock(), []
    t = times(5, rate)
    arrivals = np.maximum.accumulate(1e9 * (t + jitter(t, 50))).astype(np.int64)
    for k, arrival in enumerate(arrivals.tolist()):
        t_us = round(1e6 * t[k])
        off = off_us if k and k % (2 * rate) == 0 else 0
        assert abs(stamp(right, t_us, arrival) - stamp(wrong, t_us + off, arrival)) < 1000
        irregular += [k] * wrong.irregular
        assert not right.irregular
        assert not wrong.jump_us
    assert irregular == [2 * rate, 4 * rate]


@pytest.mark.parametrize('off_us', [40_000, -9000])
def test_a_step_of_the_boards_clock_is_compensated_and_counted(off_us):
    clock, stamps, jumps = BoardClock(), [], []
    for k in range(1000):
        stamps.append(stamp(clock, 1000 * k + off_us * (k >= 500), 10**12 + 10**6 * k))
        jumps += [clock.jump_us] * (clock.jump_us != 0)
    assert set(np.diff(stamps)) == {10**6}
    assert jumps == [off_us]


def test_a_sample_that_the_board_took_late_keeps_its_own_time_and_missed_samples_are_left_out():
    clock, t = BoardClock(), np.delete(times(0.2), [101, 102, 103])
    t[100] += 0.003
    assert np.ptp(run(clock, t)) == 0


def test_a_busy_minute_does_not_change_the_estimated_skew():
    clock, t = BoardClock(), times(120, 100)
    busy = 4e-3 * np.random.default_rng(1).weibull(4, len(t))
    run(clock, t, np.where(t < 60, jitter(t, 50), busy), 50.0)
    assert clock.skew_ppm == pytest.approx(50, abs=2)


def test_one_early_sample_changes_the_offset_but_not_the_skew():
    clock, t = BoardClock(), times(60, 100)
    late = 5e-4 + jitter(t, 50)
    late[4000] = 0
    error = run(clock, t, late)
    assert abs(clock.skew_ppm) < 1
    assert np.ptp(error[4000:]) < 50


@pytest.mark.parametrize(
    ('t', 'waited', 'largest_us'),
    [
        *((times(12), busy, 200) for busy in ((1.0, 4.5), (0.6, 2.6), (7.0, 11.5))),
        (times(1.5), (1.0, 1.5), 0),
    ],
)
def test_latency_of_a_busy_machine_and_buffering_are_not_mistaken_for_skew(t, waited, largest_us):
    """Every sample of seconds arrives 3 ms late, or all together at their end."""
    now = (t >= waited[0]) & (t < waited[1])
    late = jitter(t, 50) + 3e-3 * now if largest_us else np.where(now, waited[1] - t, 0)
    assert np.ptp(run(BoardClock(), t, late)[100:]) <= largest_us


def test_after_a_restart_timestamps_follow_the_new_clock_and_still_increase():
    clock = BoardClock()
    before = [stamp(clock, 10**9 + 1000 * k, 10**12 + 10**6 * k) for k in range(100)]
    clock = BoardClock(clock.last_stamp)
    after = [stamp(clock, 1000 * k, 10**12 + 10**8 + 10**6 * k) for k in range(100)]
    assert after[0] > before[-1]
    assert after[-1] == 10**12 + 10**8 + 99 * 10**6
