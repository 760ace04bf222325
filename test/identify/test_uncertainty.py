# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Standard errors by the block bootstrap against textbooks, where these hold, and against the spread of estimates."""

import numpy as np

from pendubot_identification.criteria.energy import Regression
from pendubot_identification.criteria.quadratic import Quadratic
from pendubot_identification.criteria.weak import balance_weights, weak_regression
from pendubot_identification.identify.uncertainty import Blocks, bootstrap_covariance
from pendubot_identification.model.parameters import default_bounds
from pendubot_identification.trajectories.motion import Motion
from test.virtual import recording


def covariance_of(parts, *args, **options):
    return bootstrap_covariance(Blocks.of(parts), *args, **options)


FREE = np.ones(3, dtype=bool)


def white(seed, seconds=100.0, scale=(1.0, 10.0, 0.1)):
    """Residuals that do not hang together at all, where the textbook's covariance is right."""
    rng = np.random.default_rng(seed)
    phi = rng.normal(size=(int(20 * seconds), 3)) * scale
    return Regression(phi, rng.normal(size=len(phi)), np.linspace(0, seconds, len(phi)))


def test_of_independent_residuals_it_is_the_textbooks():
    """In the mean over recordings; that of one is made of fifty blocks, and as uncertain as that."""
    ratios = []
    for seed in range(20):
        part = white(seed)
        covariance = covariance_of([part], np.zeros(3), FREE, resamples=1000)
        assert (np.linalg.eigvalsh(covariance) > 0).all()
        ratios.append(np.diag(covariance) / np.diag(np.linalg.inv(part.phi.T @ part.phi)))
    np.testing.assert_allclose(np.mean(ratios, axis=0), 1, atol=0.2)


def test_residuals_that_repeat_tell_no_more():
    """Ten times the same row is one observation, not ten; a textbook would give sqrt(10) times smaller errors."""
    part = white(1)
    tenfold = Regression(*(np.repeat(values, 10, axis=0) for values in (part.phi, part.y, part.t)))
    once, ten = (np.diag(covariance_of([p], np.zeros(3), FREE)) for p in (part, tenfold))
    np.testing.assert_allclose(ten, once, rtol=0.1)


def test_units_do_not_matter():
    part, scale = white(7), np.array([1e-3, 1.0, 1e4])
    scaled = Regression(part.phi * scale, part.y, part.t)
    expected = covariance_of([part], np.zeros(3), FREE) / np.outer(scale, scale)
    np.testing.assert_allclose(covariance_of([scaled], np.zeros(3), FREE), expected, rtol=1e-6, atol=0)


def test_a_parameter_on_its_bound_has_no_variance_and_stays_where_it_is():
    part = white(2)
    free, theta = np.array([True, False, True]), np.array([0.0, 0.4, 0.0])
    covariance = covariance_of([part], theta, free)
    assert np.isnan(covariance[1]).all()
    assert np.isnan(covariance[:, 1]).all()
    rest = Regression(part.phi[:, free], part.y - part.phi[:, 1] * 0.4, part.t)
    alone = covariance_of([rest], theta[free], np.ones(2, dtype=bool))
    np.testing.assert_allclose(covariance[np.ix_(free, free)], alone)


def test_same_seed_same_result_and_recordings_share_the_blocks():
    part = white(3)
    halves = [Regression(part.phi[k], part.y[k], part.t[k]) for k in (slice(None, 1000), slice(1000, None))]
    first, again = (covariance_of(halves, np.zeros(3), FREE, seed=5) for _ in range(2))
    np.testing.assert_array_equal(first, again)
    whole = covariance_of([part], np.zeros(3), FREE, seed=5)
    np.testing.assert_allclose(np.diag(first), np.diag(whole), rtol=0.3)


def test_without_blocks_or_free_parameters_nothing_is_known():
    part = white(5)
    instant = Regression(part.phi[:3], part.y[:3], np.zeros(3))
    assert np.isnan(covariance_of([instant], np.zeros(3), FREE)).all()
    assert np.isnan(covariance_of([part], np.zeros(3), ~FREE)).all()


def test_of_the_weak_criterion_it_is_about_the_spread_over_recordings():
    estimates, errors, bounds = [], [], default_bounds().of(7)
    for seed in range(10):
        motion = Motion.prepare(recording(seed=seed), 0.02)
        weights = balance_weights([weak_regression(motion, 'viscous')], bounds)
        part = weak_regression(motion, 'viscous', weights=weights)
        estimates.append(Quadratic.reduce(part.phi, part.y).minimum(bounds))
        errors.append(np.sqrt(np.diag(covariance_of([part], estimates[-1], np.ones(7, dtype=bool)))))
    ratio = np.median(errors, axis=0) / np.std(estimates, axis=0, ddof=1)
    assert (ratio > 0.4).all()
    assert (ratio < 3).all()
