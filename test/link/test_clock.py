# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The board's clock on the host's time line: delays only add, skew is followed, stamps never go back."""

import numpy as np
import pytest

from pendubot_identification.link.clock import BoardClock


def stamp(clock, t_us, arrival_ns):
    return clock.stamp(clock.host_time(clock.observe(t_us, arrival_ns)))


def run(clock, *, seconds, rate=1000, skew_ppm=0.0, start_us=0, seed=1, jitter_us=80.0, latency_us=100.0):
    """Stamp samples as a serial link would deliver them; return errors [us] against the true sampling times."""
    rng = np.random.default_rng(seed)
    n = int(seconds * rate)
    board_us = start_us + np.arange(n) * round(1e6 / rate)
    true_ns = 5e12 + (board_us - start_us) * 1e3 * (1 + skew_ppm * 1e-6)
    arrival = true_ns + 1e3 * (latency_us + rng.exponential(jitter_us, n))
    # In order, as bytes are: a late one holds up those behind it.
    arrival = np.maximum.accumulate(arrival).astype(np.int64)
    stamps = np.array([stamp(clock, int(b) % 2**32, int(a)) for b, a in zip(board_us, arrival, strict=True)])
    assert (np.diff(stamps) > 0).all()
    return (stamps - true_ns) / 1e3 - latency_us


@pytest.mark.parametrize('start_us', [0, 2**32 - 2_000_000])
def test_jitter_does_not_reach_the_stamps_nor_does_the_counters_wrap(start_us):
    error = run(BoardClock(), seconds=20, start_us=start_us)
    assert np.abs(error[100:]).max() < 20


@pytest.mark.parametrize('skew', [-300.0, 50.0])
def test_skew_is_found_within_seconds_and_followed(skew):
    clock = BoardClock()
    error = run(clock, seconds=90, skew_ppm=skew)
    assert np.abs(error[4000:20_000]).max() < 60
    assert np.percentile(np.abs(error[20_000:]), 99) < 50
    assert clock.skew_ppm == pytest.approx(skew, abs=1.0)


def test_skew_is_not_guessed_from_a_short_span():
    short = BoardClock()
    run(short, seconds=0.3, skew_ppm=200)
    assert short.skew_ppm == 0


@pytest.mark.parametrize(('skew', 'wrong'), [(900.0, 0.0), (3000.0, 0.003), (-50_000.0, -0.05)])
def test_a_clock_that_no_crystal_explains_is_known_within_a_second_and_followed(skew, wrong):
    clock = BoardClock()
    run(clock, seconds=1, skew_ppm=skew)
    assert clock.wrong_rate == pytest.approx(wrong, rel=0.1)
    clock = BoardClock()
    error = run(clock, seconds=20, skew_ppm=skew)
    assert np.abs(error[2000:]).max() < 100


@pytest.mark.parametrize('rate', [100, 1000])
@pytest.mark.parametrize('off_us', [65_536, 8000, -65_536, -30_000])
def test_one_wrong_time_moves_no_stamp(rate, off_us):
    """As of a timer of 16 bits that is read while it overflows."""
    right, wrong = BoardClock(), BoardClock()
    step, rng = round(1e6 / rate), np.random.default_rng(1)
    n = 20 * rate
    arrivals = np.arange(n) * step * 1000 + 10**12 + rng.exponential(50_000, n).astype(np.int64)
    for k, arrival in enumerate(np.maximum.accumulate(arrivals).tolist()):
        times = (step * k, step * k + (off_us if k and k % (7 * rate) == 0 else 0))
        a, b = (stamp(clock, t, arrival) for clock, t in zip((right, wrong), times, strict=True))
        assert abs(a - b) < 1000
    assert (wrong.irregular, wrong.jumps, right.irregular) == (2, 0, 0)


@pytest.mark.parametrize('off_us', [40_000, -9000])
def test_a_clock_that_jumps_is_followed_and_told(off_us):
    clock = BoardClock()
    stamps = [stamp(clock, 1000 * k + off_us * (k >= 500), 10**12 + 10**6 * k) for k in range(1000)]
    assert set(np.diff(stamps)) == {10**6}
    assert (clock.jumps, clock.jump_us) == (1, off_us)


def test_a_sample_that_the_board_took_late_keeps_its_own_time():
    clock = BoardClock()
    late = [3000 * (k == 100) for k in range(200)]
    stamps = [
        stamp(clock, 1000 * k + us, 10**12 + 10**6 * k + 1000 * us)
        for k, us in enumerate(late)
        if k not in (101, 102, 103)
    ]
    assert stamps[100] - stamps[99] == 4 * 10**6
    assert clock.irregular == 0


@pytest.mark.parametrize('seed', range(3))
@pytest.mark.parametrize('skew', [-150.0, 60.0])
def test_skew_costs_little_before_it_is_known(skew, seed):
    error = run(BoardClock(), seconds=6, skew_ppm=skew, seed=seed, jitter_us=30)
    assert np.percentile(np.abs(error - np.median(error)), 99) < 50


@pytest.mark.parametrize('seed', range(2))
def test_a_busy_minute_changes_no_skew_that_is_known(seed):
    clock = BoardClock()
    rng = np.random.default_rng(seed)
    t = np.arange(0, 180, 1e-2)
    delay = 1e-4 + np.where(t < 60, rng.exponential(5e-5, len(t)), 4e-3 * rng.weibull(4, len(t)))
    for x, d in zip(t, delay, strict=True):
        stamp(clock, round(x * 1e6), round((x * (1 + 50e-6) + d) * 1e9))
    assert clock.skew_ppm == pytest.approx(50, abs=2)


def test_one_sample_that_came_early_moves_the_line_but_does_not_turn_it():
    clock = BoardClock()
    t = np.arange(0, 100, 1e-3)
    delay = 6e-4 + np.random.default_rng(1).exponential(5e-5, len(t))
    delay[70_000] = 1e-4
    stamps = [stamp(clock, round(x * 1e6), round((x + d) * 1e9)) for x, d in zip(t, delay, strict=True)]
    assert abs(clock.skew_ppm) < 1
    assert np.ptp((np.array(stamps) * 1e-9 - t)[70_000:]) < 5e-5


@pytest.mark.parametrize('busy', [(1.0, 4.5), (0.6, 2.6), (7.0, 11.5)])
def test_a_busy_machine_is_not_taken_for_skew(busy):
    """For seconds every sample is held up by 3 ms: their own times must hardly suffer."""
    clock = BoardClock()
    t = np.arange(0, 12, 1e-3)
    delay = 1e-4 + np.random.default_rng(1).exponential(5e-5, len(t))
    delay[(t >= busy[0]) & (t < busy[1])] += 3e-3
    stamps = [stamp(clock, round(x * 1e6), round((x + d) * 1e9)) for x, d in zip(t, delay, strict=True)]
    error = np.array(stamps) * 1e-9 - t
    assert np.ptp(error[100:]) < 2e-4


def test_a_burst_that_waited_keeps_its_own_times():
    clock = BoardClock()
    for k in range(1000):
        stamp(clock, 1000 * k, 10**9 + 10**6 * k)
    late = [stamp(clock, 1000 * k, 10**9 + 10**6 * 1500) for k in range(1000, 1500)]
    assert late == [10**9 + 10**6 * k for k in range(1000, 1500)]


def test_a_silence_longer_than_the_wrap_is_counted_by_the_host():
    clock = BoardClock()
    stamp(clock, 0, 0)
    silence_us = 3 * 2**32 + 17
    assert stamp(clock, silence_us % 2**32, silence_us * 1000) == pytest.approx(silence_us * 1000, abs=1000)


def test_a_restart_takes_the_new_clock_and_stamps_still_increase():
    clock = BoardClock()
    before = [stamp(clock, 10**9 + 1000 * k, 10**12 + 10**6 * k) for k in range(100)]
    clock.restart()
    after = [stamp(clock, 1000 * k, 10**12 + 10**8 + 10**6 * k) for k in range(100)]
    assert after[0] > before[-1]
    assert after[-1] == 10**12 + 10**8 + 99 * 10**6
