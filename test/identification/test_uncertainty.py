# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Standard errors compared with textbook formulas and with the spread of estimates; the parts that are held out."""

from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pendubot_identification.criteria.quadratic import Quadratic
from pendubot_identification.criteria.weak import residual_weights, weak_regression
from pendubot_identification.identification.estimate import (
    correlations,
    influence_covariance,
    regression_covariance,
    scaled_condition_number,
    student_quantile,
)
from pendubot_identification.identification.validation import folds
from pendubot_identification.model.parameters import default_bounds
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.trajectory import Trajectory
from test.virtual import recording

FREE = np.ones(3, dtype=bool)


def test_standard_errors_of_the_weak_criterion_agree_with_the_spread_over_recordings():
    estimates, errors, bounds = [], [], default_bounds().of(7)
    for seed in range(10):
        motion = Motion.prepare(recording(seed=seed), 0.02)
        weights = residual_weights([weak_regression(motion, 'viscous')], bounds)
        part = weak_regression(motion, 'viscous', weights=weights)
        estimates.append(Quadratic.reduce(part.phi, part.y).minimum(bounds))
        errors.append(regression_covariance([part], estimates[-1], np.ones(7, dtype=bool))[1])
    ratio = np.median(errors, axis=0) / np.std(estimates, axis=0, ddof=1)
    assert (ratio > 0.4).all()
    assert (ratio < 3).all()


def line(phi, y, owner, free=FREE, difference=0.0, *, exact=False):
    """Return the least-squares fit of B blocks, phi of shape (B, M, D), and its influence covariance."""
    theta = np.zeros(phi.shape[2])
    theta[free] = np.linalg.lstsq(phi[..., free].reshape(-1, free.sum()), y.ravel(), rcond=None)[0]
    slopes = np.einsum('bmi,bm->bi', phi, phi @ theta - y)
    informations = np.einsum('bmi,bmj->bij', phi, phi)
    given = informations.sum(axis=0), slopes, informations, owner, free, difference * np.ones(len(free))
    return theta, *influence_covariance(*given, exact=exact)


def clustered(seed, recordings, each=20):
    """Return rows of recordings; the blocks of a recording share an error."""
    rng, owner = np.random.default_rng(seed), np.repeat(np.arange(recordings), each)
    phi = rng.normal(size=(len(owner), 6, 3)) + rng.normal(size=(recordings, 1, 3))[owner]
    return phi, rng.normal(size=phi.shape[:2]) + 2 * rng.normal(size=recordings)[owner, None], owner


def test_standard_errors_of_an_exact_fit_are_at_least_those_of_the_curvature_in_any_units():
    phi, y, owner = clustered(1, 4)
    units = np.array([1, 1e-3, 1e4])
    _, covariance, std_error, freedom, words = line(phi * units, y, owner, exact=True)
    flat = (phi * units).reshape(-1, 3)
    np.testing.assert_allclose(std_error, np.sqrt(np.diag(covariance)))
    np.testing.assert_allclose(covariance * np.outer(units, units), line(phi, y, owner, exact=True)[1], rtol=1e-6)
    curvature = np.sqrt(np.diag(np.linalg.inv(flat.T @ flat)))
    assert (std_error * student_quantile(freedom) >= 0.999 * student_quantile(np.inf) * curvature).all()
    assert words == 'influence of 80 blocks of time and of 4 recordings'
    alike = np.random.default_rng(5).normal(size=y.shape)
    assert line(phi, alike, owner, exact=True)[-1] == 'influence of 80 blocks of time', 'recordings do not differ'


def test_the_difference_to_the_estimate_of_short_intervals_adds_to_the_standard_error():
    phi, y, owner = clustered(3, 4)
    _, _, before, freedom, _ = line(phi, y, owner)
    far = 2 * before * [1, 0, -1]
    _, covariance, std_error, same, words = line(phi, y, owner, difference=far)
    np.testing.assert_allclose(std_error, np.hypot(before, far), rtol=0.02)
    np.testing.assert_array_equal(freedom, same)
    assert covariance[0, 2] < 0, 'their errors are correlated'
    assert words.endswith('the difference to the estimate of the shortest interval')


@pytest.mark.parametrize(('recordings', 'stronger'), [(2, 1), (2, 8), (3, 8), (12, 1)])
def test_intervals_cover_the_truth_if_each_recording_has_its_own_error(recordings, stronger):
    """The textbook's intervals for white residuals cover it half of the time; the first recording is ``stronger``."""
    covered, naive = [], []
    for seed in range(150):
        phi, y, owner = clustered(100 + seed, recordings)
        phi[owner == 0] *= stronger
        theta, _, std_error, freedom, words = line(phi, y, owner)
        assert words == f'influence of {recordings} recordings'
        covered.append(np.abs(theta) < student_quantile(freedom) * std_error)
        naive.append(np.abs(theta) < 1.96 * np.sqrt(np.diag(np.linalg.inv(np.einsum('bmi,bmj->ij', phi, phi)))))
    assert 0.88 < np.mean(covered) < 0.99
    assert np.mean(naive) < np.mean(covered) - 0.1


def test_parameters_on_a_bound_have_a_standard_error_and_unidentifiable_ones_affect_no_other():
    phi, y, owner = clustered(3, 8)
    free = np.array([True, False, True])
    _, covariance, std_error, *_ = line(phi, y, owner, free)
    assert np.isnan(covariance[1]).all()
    assert np.isnan(covariance[:, 1]).all()
    alone = line(phi[..., free], y, owner, FREE[:2])[2]
    np.testing.assert_allclose(std_error[free], alone)
    assert 0.2 < std_error[1] / line(phi, y, owner)[2][1] < 5, 'near the standard error without the bound'
    phi[..., 1] = 0.0
    unidentifiable = line(phi, y, owner)[2]
    np.testing.assert_allclose(unidentifiable[free], alone, rtol=0.01)
    assert unidentifiable[1] == np.inf


def test_indistinguishable_parameters_have_infinite_standard_errors():
    phi, y, owner = clustered(4, 6)
    phi[..., 1] = 0.3 * phi[..., 0]
    assert np.isinf(line(phi, y, owner)[2]).tolist() == [True, True, False]
    assert np.isfinite(line(phi, y, owner, np.array([True, False, True]))[2]).all()


def test_correlations_and_condition_number_are_computed_for_columns_of_unit_norm():
    flat = clustered(5, 3)[0].reshape(-1, 3)
    flat[:, 2] = flat[:, 0] + 0.01 * flat[:, 2]
    information = flat.T @ flat * np.outer([1, 1e-3, 1e4], [1, 1e-3, 1e4])
    covariance = np.linalg.inv(flat.T @ flat)
    deviation = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(correlations(information, FREE), covariance / np.outer(deviation, deviation), atol=1e-6)
    scaled = flat / np.linalg.norm(flat, axis=0)
    assert scaled_condition_number(information, FREE) == pytest.approx(np.linalg.cond(scaled), rel=1e-4)
    held = np.array([True, True, False])
    assert scaled_condition_number(information, held) == pytest.approx(np.linalg.cond(scaled[:, held]), rel=1e-4)


def extent(parts):
    """Return the ends of parts of recordings, without the ends at which two of them meet, and their duration."""
    ends = Counter(time for part in parts for time in (part.start, part.end))
    return {time for time, count in ends.items() if count % 2}, pytest.approx(sum(p.end - p.start for p in parts))


@given(st.lists(st.integers(100, 900), min_size=1, max_size=6))
def test_folds_hold_out_every_time_exactly_once(lengths):
    motions = []
    for k, samples in enumerate(lengths):
        t, none = 10.0 * k + 0.01 * np.arange(samples), np.zeros((samples, 2))
        motions.append(Motion.prepare(Trajectory(t, none, none), 0.0))
    found = folds(motions)
    assert len(found) == {1: 5, 2: 6}.get(len(motions), len(motions))
    for parts in ([f.held_out for f in found], *((f.held_out, *f.rest) for f in found)):
        assert extent(parts) == extent(motions)
