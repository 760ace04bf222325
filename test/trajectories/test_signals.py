# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import savgol_filter

from pendubot_identification.errors import TrajectoryError
from pendubot_identification.trajectories.signals import (
    SETTINGS,
    choose_smoothing,
    differentiate,
    encoder_step,
    held,
    resample,
)
from pendubot_identification.trajectories.trajectory import Trajectory


def wave(t):
    return np.column_stack([np.sin(3 * t), np.cos(5 * t)]), np.column_stack([3 * np.cos(3 * t), -5 * np.sin(5 * t)])


@pytest.mark.parametrize('size', [4e-4, 3e-3])
def test_small_jitter_of_stamps_is_rounded_to_the_grid_and_larger_jitter_is_resampled(size):
    t = np.arange(300) * 0.01
    jittered = np.sort(t + np.random.default_rng(1).uniform(-size, size, 300))
    tau = np.arange(600.0).reshape(300, 2)
    grid = resample(Trajectory(jittered, wave(jittered)[0], tau, wave(jittered)[1]))
    np.testing.assert_allclose(np.diff(grid.t), grid.interval, rtol=1e-9)
    if size < 1e-3:
        np.testing.assert_array_equal(grid.q, wave(jittered)[0])
    else:
        np.testing.assert_allclose(grid.q[2:-2], wave(grid.t)[0][2:-2], atol=1e-5)
        np.testing.assert_allclose(grid.qd[2:-2], wave(grid.t)[1][2:-2], atol=1e-4)
    assert set(grid.tau[:, 0]) <= set(tau[:, 0]), 'torques are held, not interpolated'


@given(st.integers(0, 10**6))
def test_the_zero_order_hold_gives_the_applied_torque(seed):
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(0.005, 0.015, 80))
    at = rng.uniform(t[0], t[-1], 50)
    k = held(t, at)
    tolerance = 0.1 * np.median(np.diff(t)) + 1e-12
    assert (t[k] <= at + tolerance).all()
    assert (at[k < 79] < t[np.minimum(k + 1, 79)][k < 79]).all()


@given(st.integers(15, 80), st.integers(2, 7), st.floats(1e-4, 0.1))
def test_positions_and_velocities_are_those_of_a_savitzky_golay_filter(samples, half, interval):
    q = np.random.default_rng(samples).normal(size=(samples, 2))
    smooth, rates = differentiate(q, interval, 2 * half * interval)
    filtered = [savgol_filter(q, 2 * half + 1, 3, k, interval, axis=0) for k in (0, 1)]
    np.testing.assert_allclose(smooth, filtered[0], atol=1e-12)
    np.testing.assert_allclose(rates * interval, filtered[1] * interval, atol=1e-12)


def swing(duration, rate, seed):
    """Return times, a smooth motion of both joints, and its velocity."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(duration * rate)) / rate
    size, pace, phase = rng.uniform(0.2, 1, (3, 2)), rng.uniform(1, 12, (3, 2)), rng.uniform(0, 6, (3, 2))
    angle = pace * t[:, None, None] + phase
    return t, (size * np.sin(angle)).sum(axis=1), (size * pace * np.cos(angle)).sum(axis=1)


def read(q, counts):
    return np.round(q * counts / (2 * np.pi)) * (2 * np.pi / counts)


@given(st.integers(100, 1 << 15), st.sampled_from([100, 500, 1000]), st.integers(0, 10**6), st.floats(-3, 3))
def test_the_encoder_step_is_estimated(counts, rate, seed, zero):
    _, q, _ = swing(5, rate, seed)
    np.testing.assert_allclose(encoder_step(read(q, counts) + zero), 2 * np.pi / counts, rtol=1e-6)


@given(st.integers(3, 1 << 24), st.integers(3, 1 << 24), st.integers(0, 10**6))
def test_the_estimated_encoder_step_is_right_or_unknown(first, second, seed):
    """It is unknown, 0, if it is too coarse or too fine for the motion."""
    _, q, _ = swing(2, 200, seed)
    found = encoder_step(np.column_stack([read(q[:, 0], first), read(q[:, 1], second)]))
    for step, counts in zip(found, (first, second), strict=True):
        assert step == 0 or step == pytest.approx(2 * np.pi / counts, rel=1e-6)


@settings(max_examples=25)
@given(st.sampled_from([100, 200, 500, 1000]), st.sampled_from([None, 500, 2000, 20000]), st.integers(0, 10**6))
def test_the_chosen_smoothing_keeps_the_motion_and_removes_noise(rate, counts, seed):
    t, q, qd = swing(4, rate, seed)
    q = q if counts is None else read(q, counts)
    window = choose_smoothing([Trajectory(t, q, np.zeros_like(q))])
    assert window in SETTINGS.windows
    inner = slice(rate // 5, -rate // 5)
    chosen, rough = (np.std((differentiate(q, 1 / rate, w)[1] - qd)[inner], axis=0) for w in (window, 0.0))
    assert (chosen < 1.05 * rough + 0.01).all()
    smooth, _ = differentiate(q, 1 / rate, window)
    step = 0 if counts is None else 2 * np.pi / counts
    assert np.abs(smooth - q)[inner].max() < 3 * step + 5e-3


def motion(t=None, n=100, **changes):
    t = np.arange(n) * 0.01 if t is None else np.asarray(t, dtype=float)
    values = {'q': np.zeros((len(t), 2)), 'tau': np.zeros((len(t), 2)), 'name': 'swing'} | changes
    return Trajectory(t, **values)


UNKNOWN = np.where(np.arange(200).reshape(100, 2) == 61, np.nan, 0.0)


@pytest.mark.parametrize(
    ('changes', 'sentence'),
    [
        ({'t': 4 + np.arange(100) * 0.01, 'q': UNKNOWN}, 'the first at 4.300 s'),
        ({'t': [0, 1, 1, 2]}, 'sample 2 repeats'),
        ({'t': [0, 1, 0.5, 2]}, r'sample 2 runs backwards by 0.5 s'),
        ({'q': np.zeros((99, 2))}, r'q has shape \(99, 2\)'),
        ({'t': [0, np.inf]}, 'a stamp is not a finite number'),
        *(
            ({name: values}, rf'a {name} that is not a number below 1e\+150, the first at 0.300 s')
            for name in ('q', 'tau', 'qd')
            for values in (UNKNOWN, -1e300 * np.isnan(UNKNOWN))
        ),
    ],
)
def test_invalid_samples_are_refused(changes, sentence):
    with pytest.raises(TrajectoryError, match=sentence):
        motion(**changes)
