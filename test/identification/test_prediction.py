# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Prediction errors, compared with an independent computation."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from pendubot_identification.criteria.prediction_error import HORIZONS, STEP, Prediction, predict, state_scale
from pendubot_identification.identification.validation import folds
from pendubot_identification.model.dynamics import forward_dynamics
from pendubot_identification.model.parameters import PAPER
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.trajectory import Trajectory
from test.virtual import exact_motion, recording, vector

SCALE = np.array([0.7, 1.5, 3.0, 8.0])
COUNT = len(HORIZONS)


@pytest.mark.parametrize(
    ('model', 'delay', 'parts'), [('viscous', 0, 1), ('coulomb', 3, 1), ('rotor', 0, 1), ('geared', -5, 2)]
)
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
    recorded = recording(160, strength=0.3)
    motion, theta, horizon = Motion.prepare(recorded, 0.02), PAPER.vector() * 1.2, 0.5
    errors, persistence = [], []
    for start in range(0, 160 - 50, 5):
        state = motion.smoothed(recorded.t[start])
        predicted = state
        for k in range(start, start + 50):
            predicted = solve_ivp(
                lambda _, s, k=k: [*s[2:], *forward_dynamics(theta, s[:2], s[2:], recorded.tau[k])],
                (0, 0.01),
                predicted,
                rtol=1e-9,
                atol=1e-10,
            ).y[:, -1]
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
@pytest.mark.parametrize('duration', [0.07, 0.3, 0.8])
def test_horizons_longer_than_the_motion_have_no_prediction_error(duration):
    motion = exact_motion(vector('viscous'), round(duration / 0.004) + 1)
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


@settings(max_examples=6)
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


def at_rest(samples, start, name):
    t = start + 0.01 * np.arange(samples)
    return Motion.prepare(Trajectory(t, np.zeros((samples, 2)), np.zeros((samples, 2)), name=name), 0.0)


@given(st.lists(st.integers(100, 900), min_size=1, max_size=6))
def test_folds_hold_out_every_time_exactly_once(lengths):
    motions = [at_rest(n, 3.0 * k, f'recording {k}') for k, n in enumerate(lengths)]
    found = folds(motions)
    for number, motion in enumerate(motions):
        held_out = sorted((f.held_out.start, f.held_out.end) for f in found if f.recording == number)
        edges = np.array(held_out).ravel()
        assert (edges[0], edges[-1]) == (motion.start, motion.end)
        np.testing.assert_array_equal(edges[1:-1:2], edges[2::2], 'each part begins where the previous one ends')
        assert (np.diff(edges)[::2] > 0).all()
    total = sum(m.end - m.start for m in motions)
    for fold in found:
        assert sum(m.end - m.start for m in (fold.held_out, *fold.rest)) == pytest.approx(total)
        own = [m for m in fold.rest if m.name == fold.held_out.name]
        assert all(m.end <= fold.held_out.start or m.start >= fold.held_out.end for m in own)
    if len(motions) >= 3:
        assert [f.held_out for f in found] == motions
    else:
        assert len(found) == (5, 6)[len(motions) - 1]
