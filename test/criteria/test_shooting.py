# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""How recordings are cut into segments, and what simulated ones are compared with."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline

from pendubot_identification.criteria.shooting import LONGEST_STEP, AgainstPositions, AgainstStates, Segments
from pendubot_identification.errors import TrajectoryError
from pendubot_identification.model.parameters import MODELS
from pendubot_identification.model.rollout import roll
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.trajectory import Trajectory
from test.virtual import GEARED, exact_motion, vector

RATES = (100, 250, 333, 500, 665, 1000)
SCALE = np.array([0.7, 1.5, 3.0, 8.0])
NOISE = np.array([1e-3, 2e-3])


def motion(rate, samples, start=0.0):
    """Torques that tell at what time they were recorded."""
    t = start + np.arange(samples) / rate
    return Motion.prepare(Trajectory(t, np.zeros((samples, 2)), np.column_stack([t, -t]), name=f'{rate} Hz'), 0.0)


recordings = st.lists(
    st.builds(motion, st.sampled_from(RATES), st.integers(50, 400), st.sampled_from([0.0, 3.7, -20.0])),
    min_size=1,
    max_size=3,
)


@settings(max_examples=100)
@given(recordings, st.floats(0.005, 1.0), st.floats(0.001, 1.0), st.sampled_from([0.0, 1e-9, 0.0041, 0.05, 0.100001]))
@example([motion(100, 101)], 0.5, 0.0126, 0.0)
@example([motion(100, 100)], 0.5, 0.1, 0.0041)
def test_segments_begin_on_samples_and_lie_within_their_recording(motions, length, stride, margin):
    try:
        segments = Segments.cut(motions, length, stride, margin)
    except TrajectoryError:
        longest = max(m.end - m.start - 2 * margin - m.interval for m in motions)
        assert longest < length or length < LONGEST_STEP + 0.001
        return
    assert 0 < segments.step <= 1.1 * LONGEST_STEP
    assert segments.steps * segments.step == pytest.approx(length, abs=segments.step)
    assert segments.tau.shape == (2, segments.steps, len(segments))
    assert (np.diff(segments.group) >= 0).all()
    for number, m in enumerate(motions):
        starts = segments.start[segments.group == number]
        samples = (starts - m.start) / m.interval
        np.testing.assert_allclose(samples, np.rint(samples), atol=1e-6)
        end = starts + segments.steps * segments.step
        little = 0.02 * m.interval
        assert (starts >= m.start + margin - little).all()
        assert (end <= m.end - margin + little).all()
        if len(starts):
            np.testing.assert_allclose(np.diff(starts), stride, atol=m.interval * (1 + 1e-6))
            assert starts[0] - m.start - margin < m.interval
            assert m.end - margin - end[-1] < stride + 3 * m.interval, 'to the end'
        else:
            assert m.end - m.start - 2 * margin < segments.steps * segments.step + 2 * m.interval


@pytest.mark.parametrize(
    ('length', 'sentence'),
    [(0.001, 'too short'), (1.1, '100 Hz: 0.990 s are shorter than a simulated segment of 1.1 s')],
)
def test_segments_without_a_step_or_longer_than_all_recordings_are_refused(length, sentence):
    with pytest.raises(TrajectoryError, match=sentence):
        Segments.cut([motion(100, 100), motion(100, 50)], length, 0.1, 0.0)


def comparisons(segments, delay):
    return AgainstStates(segments, SCALE), AgainstPositions(segments, NOISE, delay)


@pytest.mark.parametrize('model', MODELS)
@pytest.mark.parametrize('delay', [0, 3, -5])
def test_the_truth_leaves_no_residual(model, delay):
    """Not even where the effort comes by some samples late, or early."""
    theta = vector(model)
    motions = [exact_motion(theta, seed=seed, start=seed, delay=delay) for seed in (1, 2)]
    segments = Segments.cut(motions, 0.4, 0.3, 0.02)
    for comparison in comparisons(segments, 0.004 * delay):
        x = comparison.initial(0.004 * delay)
        states = roll(theta, x, segments.tau, segments.step)
        residuals = comparison.residuals(states, 0.004 * delay)
        assert residuals.shape == (len(segments), residuals.shape[1])
        np.testing.assert_allclose(residuals, 0, atol=1e-6)
        assert np.abs(comparison.residuals(states, 0.004 * delay + 0.01)).max() > 1e-3
        wrong = roll(theta * [1.1, *[1] * (len(theta) - 1)], x, segments.tau, segments.step)
        assert np.abs(comparison.residuals(wrong, 0.004 * delay)).max() > 1e-3


@settings(max_examples=15)
@given(st.sampled_from(list(MODELS)), st.integers(0, 2**32 - 1), st.floats(-0.045, 0.045))
def test_the_jacobian_is_the_slope_of_the_residuals(model, seed, delay):
    rng = np.random.default_rng(seed)
    theta = vector(model) * rng.uniform(0.8, 1.2, MODELS[model])
    segments = Segments.cut([exact_motion(vector(model), 100), exact_motion(GEARED, 90, seed=2)], 0.15, 0.1, 0.05)
    for comparison in comparisons(segments, delay):
        x = comparison.initial(delay) + rng.normal(scale=0.02, size=(4, len(segments)))

        def residuals(unknowns, comparison=comparison, x=x):
            states = roll(theta + unknowns[4:-1], x + unknowns[:4, None], segments.tau, segments.step)
            return comparison.residuals(states, delay + unknowns[-1])

        states = roll(theta, x, segments.tau, segments.step)
        jacobian = comparison.jacobian(theta, states, delay)[:, :, :-2]
        assert jacobian.shape == (*residuals(np.zeros(len(theta) + 5)).shape, len(theta) + 5)
        for k, size in enumerate([*[1e-6] * 4, *(3e-5 * theta), 1e-7]):
            move = size * np.eye(len(theta) + 5)[k]
            expected = (residuals(move) - residuals(-move)) / (2 * size)
            np.testing.assert_allclose(jacobian[:, :, k], expected, rtol=1e-3, atol=1e-3 * np.abs(expected).max())


def test_positions_of_all_of_a_segment_are_compared_whatever_the_rates():
    """One recording at 100 Hz beside one at 500 Hz: as many samples of each, the second's from all of its segment."""
    theta = vector('viscous')
    slow, fast = exact_motion(theta, 101, 0.01), exact_motion(theta, 501, 0.002, seed=2)
    segments = Segments.cut([slow, fast], 0.5, 0.5, 0.0)
    comparison = AgainstPositions(segments, NOISE)
    at_rest = np.zeros((segments.steps + 1, 4, len(segments)))
    moved = at_rest.copy()
    moved[-20:] += 1.0
    differs = comparison.residuals(moved, 0.0) != comparison.residuals(at_rest, 0.0)
    share = differs.mean(axis=1)
    np.testing.assert_allclose(share, 20 / segments.steps, atol=0.05)


def test_positions_read_from_wrong_zeros_add_to_the_residuals_what_by_zeros_says():
    angles = np.array([0.05, -0.03])
    right = exact_motion(vector('rotor'), 100)
    t = right.recorded.t
    read = replace(right.recorded, q=right.recorded.q + angles)
    off = replace(right, recorded=read, smoothed=CubicSpline(t, right.smoothed(t) + np.append(angles, [0, 0])))
    for good, bad in zip(*(comparisons(Segments.cut([m], 0.2, 0.1, 0.05), 0.0) for m in (right, off)), strict=True):
        states = np.random.default_rng(1).normal(size=(good.segments.steps + 1, 4, len(good.segments)))
        found = bad.residuals(states, 0.01) + bad.by_zeros @ angles
        np.testing.assert_allclose(found, good.residuals(states, 0.01), atol=1e-9)
