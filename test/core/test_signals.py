import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pendubot_identification.core.errors import TrajectoryError
from pendubot_identification.core.signals import differentiate, held, resample
from pendubot_identification.core.trajectory import Trajectory


def wave(t):
    return np.column_stack([np.sin(3 * t), np.cos(5 * t)]), np.column_stack([3 * np.cos(3 * t), -5 * np.sin(5 * t)])


@given(st.lists(st.floats(-2, 2), min_size=4, max_size=4), st.sampled_from([0.02, 0.05, 0.1]))
def test_cubics_are_differentiated_exactly(coefficients, window):
    t = np.arange(200) * 0.002
    q = np.column_stack([np.polyval(coefficients, t)] * 2)
    smooth, qd = differentiate(q, 0.002, window)
    np.testing.assert_allclose(smooth, q, atol=1e-9)
    np.testing.assert_allclose(qd[:, 0], np.polyval(np.polyder(coefficients), t), atol=1e-8)


@pytest.mark.parametrize('window', [0.0, 0.02, 0.06])
def test_no_phase_shift_either_way(window):
    t = np.arange(1000) * 0.002
    q, qd = wave(t)
    np.testing.assert_allclose(differentiate(q, 0.002, window)[1][20:-20], qd[20:-20], atol=5e-3)
    backwards = differentiate(q[::-1].copy(), 0.002, window)[1]
    np.testing.assert_allclose(backwards[::-1], -differentiate(q, 0.002, window)[1], atol=1e-9)


def test_a_window_under_five_samples_means_central_differences():
    t = np.arange(50) * 0.01
    q, _ = wave(t)
    same, qd = differentiate(q, 0.01, 0.02)
    np.testing.assert_array_equal(same, q)
    np.testing.assert_allclose(qd[1:-1], (q[2:] - q[:-2]) / 0.02)


def test_smoothing_lowers_the_noise_of_encoder_counts():
    t = np.arange(2000) * 0.001
    q, qd = wave(t)
    counts = np.round(q * 4000 / (2 * np.pi)) * 2 * np.pi / 4000
    rough, smooth = (np.std(differentiate(counts, 0.001, w)[1] - qd) for w in (0.0, 0.02))
    assert smooth < rough / 5


def test_stamps_that_hardly_jitter_are_moved_onto_the_grid_and_nothing_else_changes():
    t = np.arange(900) * 0.010001 + np.random.default_rng(1).uniform(-4e-4, 4e-4, 900)
    motion = Trajectory(t, wave(t)[0], np.arange(1800.0).reshape(900, 2))
    even = resample(motion)
    np.testing.assert_allclose(np.diff(even.t), even.interval, rtol=1e-9)
    np.testing.assert_array_equal(even.q, motion.q)
    np.testing.assert_array_equal(even.tau, motion.tau)


def test_jittering_stamps_are_resampled():
    t = np.arange(300) * 0.01
    jittered = np.sort(t + np.random.default_rng(1).uniform(-0.003, 0.003, 300))
    tau = np.arange(600.0).reshape(300, 2)
    grid = resample(Trajectory(jittered, wave(jittered)[0], tau, wave(jittered)[1]))
    np.testing.assert_allclose(np.diff(grid.t), grid.interval, rtol=1e-9)
    np.testing.assert_allclose(grid.q[2:-2], wave(grid.t)[0][2:-2], atol=1e-5)
    np.testing.assert_allclose(grid.qd[2:-2], wave(grid.t)[1][2:-2], atol=1e-4)
    assert set(grid.tau[:, 0]) <= set(tau[:, 0]), 'torques are held, not interpolated'


@given(st.integers(0, 10**6))
def test_a_held_torque_is_the_one_that_was_applied(seed):
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(0.005, 0.015, 80))
    at = rng.uniform(t[0], t[-1], 50)
    k = held(t, at)
    tolerance = 0.1 * np.median(np.diff(t)) + 1e-12
    assert (t[k] <= at + tolerance).all()
    assert (at[k < 79] < t[np.minimum(k + 1, 79)][k < 79]).all()


def test_a_long_gap_is_named():
    t = np.r_[np.arange(100), np.arange(150, 250)] * 0.01
    with pytest.raises(TrajectoryError, match=r'0\.510 s without a sample begin at 0.990 s'):
        resample(Trajectory(t, *[wave(t)[0]] * 2))


def test_samples_far_apart_are_refused():
    t = np.arange(100) * 10.0
    with pytest.raises(TrajectoryError, match=r'10 s apart and at most 0\.1 s is expected; are its stamps in seconds'):
        resample(Trajectory(t, *[wave(t)[0]] * 2))


def test_a_smoothing_window_of_any_length_is_answered():
    with pytest.raises(TrajectoryError, match=r'100 samples, 1 s, are fewer than the smoothing window of 1e\+300 s'):
        differentiate(np.zeros((100, 2)), 0.01, 1e300)
