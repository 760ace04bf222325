# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Prediction errors, compared with an independent computation, and as a criterion: slopes, scales and prior."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pendubot_identification.criteria.likelihood import FilterData
from pendubot_identification.criteria.prediction_error import (
    ASSESSED,
    HORIZONS,
    STEP,
    STRIDE,
    Prediction,
    PredictionSettings,
    Simulations,
    predict,
    refine,
    state_scale,
)
from pendubot_identification.errors import TrajectoryError
from pendubot_identification.model.parameters import PAPER, default_bounds
from pendubot_identification.trajectories.motion import Motion
from test.criteria.test_likelihood import TRUE, motions
from test.virtual import exact_motion, integrated, recording, vector

SCALE = np.array([0.7, 1.5, 3.0, 8.0])
#: Index of the elbow's friction under load, which is not identifiable without a motor at the elbow.
UNKNOWN = 13


@pytest.fixture(scope='module')
def prepared():
    return motions((1, 2, 3))


def refined(prepared, theta=TRUE, prior=None, pull=None, bounds=None, delay=0.0, offset=(0.0, 0.0), **settings):
    """Return the fit, by default with a weak prior."""
    weak = np.diag(1e-3 / np.maximum(abs(TRUE), 1e-2) ** 2)
    return refine(
        prepared,
        theta,
        weak if prior is None else prior,
        np.zeros(14) if pull is None else pull,
        delay,
        np.array(offset),
        bounds or default_bounds(),
        FilterData.of(prepared),
        PredictionSettings(**settings),
    )


def off(theta):
    """Return the largest relative error of P1 to P5."""
    return abs(theta[:5] / TRUE[:5] - 1).max()


def test_slopes_and_information_agree_with_the_criterion(prepared):
    found = refined(prepared, 1.1 * TRUE, 1e4 * np.diag(1 / np.maximum(TRUE, 0.01) ** 2))
    settings, filter_data = PredictionSettings(), FilterData.of(prepared)
    simulations = Simulations.of(prepared, 1.1 * TRUE, 0.0, np.zeros(2), HORIZONS[:ASSESSED], STRIDE)
    number = simulations.recording
    block = np.concatenate([filter_data.block_of(k, simulations.t[number == k]) for k in range(3)])
    count = settings.weight * sum(m.end - m.start for m in prepared) / 0.5 / len(number)

    def cost(theta):
        z = simulations.errors(theta)[0] / found.scale[:, :, None] / found.factor[number]
        return count / 2 * np.bincount(block, (z**2).sum(axis=(0, 1)), minlength=len(filter_data.owner))

    size = np.sqrt(np.diagonal(found.informations.sum(axis=0)))
    for k, step in enumerate(np.diag(1e-5 * np.maximum(TRUE, 0.01))):
        expected = (cost(found.theta + step) - cost(found.theta - step)) / (2 * step[k])
        np.testing.assert_allclose(found.slopes[:, k], expected, rtol=1e-3, atol=1e-4 * size[k])
    rest = found.information - found.informations.sum(axis=0)
    np.testing.assert_allclose(rest, 1e4 * np.diag(1 / np.maximum(TRUE, 0.01) ** 2), rtol=1e-6, atol=1e-3)


def test_the_estimate_is_a_minimum_near_the_truth(prepared):
    theta = TRUE * np.where(np.arange(14) % 2, 0.9, 1.1)
    found = refined(prepared, theta)
    assert off(found.theta) < 0.01
    again = refined(prepared, found.theta)
    assert off(again.theta) < 0.01
    np.testing.assert_allclose(again.theta[:5], found.theta[:5], rtol=2e-3)


def test_the_simulation_includes_delay_and_offsets():
    late = motions(delay=0.01)
    shifted = [Motion.prepare(replace(m.recorded, q=m.recorded.q + np.array([0.02, -0.01])), 0.05) for m in late]
    right = refined(shifted, delay=0.01, offset=(0.02, -0.01))
    assert off(right.theta) < 0.01
    assert (right.scale < refined(shifted, delay=0.01).scale).all()
    assert (right.scale < refined(shifted, offset=(0.02, -0.01)).scale).all()


def test_a_disturbed_recording_changes_the_estimate_less_than_in_least_squares(prepared):
    """A hand pushes the rig in the third recording."""
    recorded = prepared[2].recorded
    hand = np.outer(np.sin(2.5 * recorded.t), [1.0, 0.0])
    pushed = [*prepared[:2], Motion.prepare(replace(recorded, tau=recorded.tau + hand), 0.05)]
    found, least_squares = refined(pushed), refined(pushed, shrinkage=1e12)
    np.testing.assert_allclose(least_squares.factor, 1, rtol=1e-6)
    assert found.factor[2] > 1.3 * found.factor[:2].max()
    assert off(found.theta) < 0.7 * off(least_squares.theta)


def test_the_prior_determines_parameters_without_information_in_the_errors(prepared):
    theta = TRUE.copy()
    theta[UNKNOWN] = 0.1
    prior, pull = np.diag(1e-3 / np.maximum(abs(TRUE), 1e-2) ** 2), np.zeros(14)
    found = refined(prepared, theta, prior)
    assert not found.informations[:, UNKNOWN].any()
    assert found.theta[UNKNOWN] == pytest.approx(0.1, abs=1e-9)
    prior[UNKNOWN, UNKNOWN], pull[UNKNOWN] = 1e3, -50.0
    assert refined(prepared, theta, prior, pull).theta[UNKNOWN] == pytest.approx(0.15, abs=2e-3)


def test_bounds_are_kept(prepared):
    box = default_bounds()
    lower, upper = box.lower.copy(), box.upper.copy()
    upper[0] = 0.97 * TRUE[0]
    lower[3] = upper[3] = 1.02 * TRUE[3]
    theta = np.clip(TRUE, lower, upper)
    found = refined(prepared, theta, bounds=replace(box, lower=lower, upper=upper))
    assert found.theta[3] == upper[3]
    assert ((found.theta >= lower) & (found.theta <= upper)).all()


def test_recordings_that_are_shorter_than_the_longest_horizon_are_refused(prepared):
    short = [m.part(1.0, 1.4) for m in prepared]
    with pytest.raises(TrajectoryError, match=r'shorter than 0\.5 s; choose longer windows'):
        refined(short)


@pytest.mark.parametrize(('model', 'delay', 'parts'), [('viscous', 3, 1), ('geared', -5, 4)])
def test_the_true_parameters_predict_exactly_and_others_do_not(model, delay, parts):
    step = STEP / parts
    motions = [exact_motion(vector(model), 450 * parts, step, seed=seed, start=seed, delay=delay) for seed in (1, 2)]
    scale = state_scale(motions)
    prediction = predict(motions, vector(model), step * delay, scale)
    np.testing.assert_allclose(prediction.errors, 0, atol=1e-6)
    np.testing.assert_allclose(prediction.fit, 100, atol=1e-3)
    assert (prediction.starts > 20).all()
    assert (predict(motions, vector(model), step * delay + 0.02, scale).error > 0.005).all()
    assert (predict(motions, vector(model) * 1.5, step * delay, scale).error[1:] > 0.001).all()
    assert (prediction.persistence > 0.05).all()


def test_prediction_errors_agree_with_an_independent_integration():
    """Every 50 ms, predict the state after 0.5 s from the smoothed state, with the torque held."""
    recorded = recording(80, strength=0.3)
    motion, theta, horizon = Motion.prepare(recorded, 0.02), PAPER.vector() * 1.2, 0.5
    errors, persistence = [], []
    for start in range(0, 80 - 50, 5):
        state = motion.smoothed(recorded.t[start])
        predicted = integrated(theta, state, recorded.tau[start : start + 50], 0.01)
        truth = motion.smoothed(recorded.t[start] + horizon)
        errors.append((predicted - truth) / SCALE)
        persistence.append((state - truth) / SCALE)
    prediction = predict([motion], theta, 0.0, SCALE)
    row = HORIZONS.index(horizon)
    assert prediction.starts[row] == len(errors)
    np.testing.assert_allclose(prediction.errors[row], np.sqrt(np.mean(np.square(errors), axis=0)), rtol=1e-4)
    np.testing.assert_allclose(prediction.still[row], np.sqrt(np.mean(np.square(persistence), axis=0)), rtol=1e-4)
    np.testing.assert_allclose(prediction.error[row], np.sqrt(np.mean(np.square(errors))), rtol=1e-4)
    np.testing.assert_allclose(prediction.persistence[row], np.sqrt(np.mean(np.square(persistence))), rtol=1e-4)


@pytest.mark.filterwarnings('error')
def test_horizons_longer_than_the_motion_have_no_prediction_error():
    motion, duration = exact_motion(vector('viscous'), 76), 0.3
    prediction = predict([motion], vector('viscous'), 0.0, SCALE)
    longer = np.array(HORIZONS) >= duration
    np.testing.assert_array_equal(np.isnan(prediction.errors).all(axis=1), longer)
    np.testing.assert_array_equal(np.isnan(prediction.still).any(axis=1), longer)
    np.testing.assert_array_equal(prediction.starts == 0, longer)


@pytest.mark.filterwarnings('error')
def test_the_errors_of_a_diverging_simulation_are_clipped_without_a_warning():
    motion = exact_motion(vector('viscous'), 300)
    prediction = predict([motion], vector('viscous') * [1, 1, 1, 1, 1, -1e4, 1], 0.0, SCALE)
    assert np.isfinite(prediction.errors).all()
    assert prediction.errors.max() == 1e3


@settings(max_examples=3)
@given(st.integers(0, 10**6), st.permutations([1.6, 0.4, 0.6]))
def test_pooled_predictions_equal_the_prediction_of_all_motions_at_once(seed, durations):
    motions = [
        exact_motion(vector('viscous'), round(duration / 0.004), seed=seed + k) for k, duration in enumerate(durations)
    ]
    theta = vector('viscous') * np.random.default_rng(seed).uniform(0.7, 1.4, 7)
    together = predict(motions, theta, 0.0, SCALE)
    pooled = Prediction.pool([predict([motion], theta, 0.0, SCALE) for motion in motions])
    np.testing.assert_array_equal(pooled.starts, together.starts)
    np.testing.assert_allclose(pooled.errors, together.errors)
    np.testing.assert_allclose(pooled.still, together.still)
    again = Prediction.pool([pooled, Prediction.none()])
    np.testing.assert_allclose(again.errors, pooled.errors)
