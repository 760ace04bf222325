# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The board's clock on the host's time line: delays only add, skew is followed, stamps never go back."""

import numpy as np
import pytest

from pendubot_identification.link.clock import BoardClock

#: Host time of the board's first sample [ns], and the delay of a sample that was not held up [s].
BEGUN, DELAY = 5 * 10**12, 1e-4


def stamp(clock, t_us, arrival_ns):
    return clock.stamp(clock.host_time(clock.observe(t_us, arrival_ns)))


def run(clock, t, late=0.0, skew_ppm=0.0, start_us=0):
    """Stamp samples at board times t [s] that come so much late [s]; return errors [us] against the true times.

    They come in order, as bytes do: a late one holds up those behind it.
    """
    true = np.round(t * 1e6) * (1 + skew_ppm * 1e-6)
    arrival = np.maximum.accumulate(1e3 * true + 1e9 * (DELAY + late)).astype(np.int64) + BEGUN
    board = (start_us + np.round(t * 1e6).astype(np.int64)) % 2**32
    stamps = np.array([stamp(clock, int(b), int(a)) for b, a in zip(board, arrival, strict=True)])
    assert (np.diff(stamps) > 0).all()
    return (stamps - BEGUN) / 1e3 - true - 1e6 * DELAY


def times(seconds, rate=1000):
    return np.arange(round(seconds * rate)) / rate


def jitter(t, mean_us=80.0, seed=1):
    return np.random.default_rng(seed).exponential(1e-6 * mean_us, len(t))


@pytest.mark.parametrize('start_us', [0, 2**32 - 2_000_000])
def test_jitter_does_not_reach_the_stamps_nor_does_the_counters_wrap(start_us):
    error = run(BoardClock(), t := times(20), jitter(t), start_us=start_us)
    assert np.abs(error[100:]).max() < 20


@pytest.mark.parametrize('skew', [-300.0, 50.0])
def test_skew_is_found_within_seconds_and_followed(skew):
    clock = BoardClock()
    run(clock, t := times(0.3), jitter(t), skew)
    assert clock.skew_ppm == 0, 'nobody knows it yet'
    error = run(clock := BoardClock(), t := times(90), jitter(t), skew)
    assert np.percentile(np.abs(error[:6000] - np.median(error[:6000])), 99) < 150
    assert np.abs(error[4000:20_000]).max() < 60
    assert np.percentile(np.abs(error[20_000:]), 99) < 50
    assert clock.skew_ppm == pytest.approx(skew, abs=1.0)


@pytest.mark.parametrize(('skew', 'wrong'), [(900.0, 0.0), (3000.0, 0.003), (-50_000.0, -0.05)])
def test_a_clock_that_no_crystal_explains_is_known_within_a_second_and_followed(skew, wrong):
    clock = BoardClock()
    run(clock, t := times(1), jitter(t), skew)
    assert clock.wrong_rate == pytest.approx(wrong, rel=0.1)
    error = run(BoardClock(), t := times(20), jitter(t), skew)
    assert np.abs(error[2000:]).max() < 100


@pytest.mark.parametrize('rate', [100, 1000])
@pytest.mark.parametrize('off_us', [65_536, 8000, -65_536, -30_000])
def test_one_wrong_time_moves_no_stamp(rate, off_us):
    """As of a timer of 16 bits that is read while it overflows."""
    right, wrong = BoardClock(), BoardClock()
    t = times(20, rate)
    arrivals = np.maximum.accumulate(1e9 * (t + jitter(t, 50))).astype(np.int64)
    for k, arrival in enumerate(arrivals.tolist()):
        t_us = round(1e6 * t[k])
        off = off_us if k and k % (7 * rate) == 0 else 0
        assert abs(stamp(right, t_us, arrival) - stamp(wrong, t_us + off, arrival)) < 1000
    assert (wrong.irregular, wrong.jumps, right.irregular) == (2, 0, 0)


@pytest.mark.parametrize('off_us', [40_000, -9000])
def test_a_clock_that_jumps_is_followed_and_told(off_us):
    clock = BoardClock()
    stamps = [stamp(clock, 1000 * k + off_us * (k >= 500), 10**12 + 10**6 * k) for k in range(1000)]
    assert set(np.diff(stamps)) == {10**6}
    assert (clock.jumps, clock.jump_us) == (1, off_us)


def test_a_sample_that_the_board_took_late_keeps_its_own_time():
    """And those that were due meanwhile are left out."""
    clock, t = BoardClock(), np.delete(times(0.2), [101, 102, 103])
    t[100] += 0.003
    assert np.ptp(run(clock, t)) == 0
    assert clock.irregular == 0


@pytest.mark.parametrize('seed', range(2))
def test_a_busy_minute_changes_no_skew_that_is_known(seed):
    clock, t = BoardClock(), times(180, 100)
    busy = 4e-3 * np.random.default_rng(seed).weibull(4, len(t))
    run(clock, t, np.where(t < 60, jitter(t, 50, seed), busy), 50.0)
    assert clock.skew_ppm == pytest.approx(50, abs=2)


def test_one_sample_that_came_early_moves_the_line_but_does_not_turn_it():
    clock, t = BoardClock(), times(100)
    late = 5e-4 + jitter(t, 50)
    late[70_000] = 0
    error = run(clock, t, late)
    assert abs(clock.skew_ppm) < 1
    assert np.ptp(error[70_000:]) < 50


@pytest.mark.parametrize('busy', [(1.0, 4.5), (0.6, 2.6), (7.0, 11.5)])
def test_a_busy_machine_is_not_taken_for_skew(busy):
    """For seconds every sample is held up by 3 ms: their own times must hardly suffer."""
    t = times(12)
    late = jitter(t, 50) + 3e-3 * ((t >= busy[0]) & (t < busy[1]))
    assert np.ptp(run(BoardClock(), t, late)[100:]) < 200


def test_a_burst_that_waited_keeps_its_own_times():
    t = times(1.5)
    assert np.ptp(run(BoardClock(), t, np.where(t < 1, 0, 1.5 - t))) == 0


def test_a_restart_takes_the_new_clock_and_stamps_still_increase():
    clock = BoardClock()
    before = [stamp(clock, 10**9 + 1000 * k, 10**12 + 10**6 * k) for k in range(100)]
    clock.restart()
    after = [stamp(clock, 1000 * k, 10**12 + 10**8 + 10**6 * k) for k in range(100)]
    assert after[0] > before[-1]
    assert after[-1] == 10**12 + 10**8 + 99 * 10**6
