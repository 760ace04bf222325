# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Levenberg-Marquardt with its segments condensed out, against the truth and an optimiser that knows nothing."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares

from pendubot_identification.criteria.levenberg_marquardt import levenberg_marquardt
from pendubot_identification.criteria.shooting import AgainstPositions, AgainstStates, Segments
from pendubot_identification.model.parameters import LARGEST_COUPLING, MODELS, NAMES, Bounds, default_bounds
from pendubot_identification.model.rollout import roll
from test.virtual import exact_motion, vector

SCALE = np.array([0.7, 1.5, 3.0, 8.0])
NOISE = np.array([1e-3, 1e-3])
DELAYS = (-0.02, 0.02)


def box(model):
    return default_bounds().of(MODELS[model])


def noisy(motion, seed=3):
    """The same motion with errors of 1 mrad and 10 mrad/s in what is known of it."""
    rng = np.random.default_rng(seed)
    q, v = (rng.normal(scale=scale, size=motion.recorded.q.shape) for scale in (1e-3, 1e-2))
    t = motion.recorded.t
    smoothed = CubicSpline(t, motion.smoothed(t) + np.column_stack([q, v]))
    return replace(motion, recorded=replace(motion.recorded, q=motion.recorded.q + q), smoothed=smoothed)


@pytest.fixture(scope='module')
def few():
    """Some short segments of a rig with viscous friction, that are read with noise."""
    return Segments.cut([noisy(exact_motion(vector('viscous'), 300, seed=6))], 0.2, 0.15, 0.025)


def of(against, segments):
    return AgainstStates(segments, SCALE) if against == 'states' else AgainstPositions(segments, NOISE)


@pytest.mark.parametrize(('model', 'against'), [*((model, 'states') for model in MODELS), ('viscous', 'positions')])
def test_reaches_the_truth_where_there_is_one(model, against):
    truth = vector(model)
    segments = Segments.cut([exact_motion(truth, 400, seed=s) for s in (1, 2)], 0.3, 0.3, 0.025)
    start = truth * np.random.default_rng(1).uniform(0.8, 1.25, len(truth))
    costs = []
    fit = levenberg_marquardt(
        of(against, segments), start, 0.004, box(model), DELAYS, iterations=100, progress=costs.append
    )
    assert fit.converged
    np.testing.assert_allclose(fit.theta, truth, rtol=1e-6)
    assert fit.delay == pytest.approx(0, abs=1e-8)
    assert fit.cost < 1e-12
    assert fit.free.all()
    assert fit.costs.shape == (len(segments),)
    assert len(costs) == fit.iterations
    assert (np.diff(costs) <= 0).all()
    assert costs[-1] == pytest.approx(fit.cost)


@pytest.mark.parametrize(('against', 'bound'), [('states', None), ('positions', None), ('positions', 0.2)])
def test_agrees_with_an_optimiser_that_knows_all_unknowns_alike(few, against, bound):
    """Also where the bound of P4, below what the data ask for, holds it."""
    comparison, count = of(against, few), len(few)
    bounds = box('viscous') if bound is None else box('viscous').replaced('P4', 0.0, bound)
    start = vector('viscous') * 0.9
    fit = levenberg_marquardt(comparison, start, 0.0, bounds, DELAYS, tolerance=1e-12, iterations=200)

    def parts(u):
        states = roll(u[:7], u[8:].reshape(4, count), few.tau, few.step)
        return states, comparison.residuals(states, u[7])

    def jacobian(u):
        states, residuals = parts(u)
        slope = comparison.jacobian(u[:7], states, u[7])
        whole = np.zeros((*residuals.shape, 8 + 4 * count))
        whole[:, :, :8] = slope[:, :, 4:-2]
        for k in range(count):
            whole[k, :, 8 + k :: count] = slope[k, :, :4]
        return whole.reshape(-1, whole.shape[2])

    free = np.full(4 * count, np.inf)
    expected = least_squares(
        lambda u: parts(u)[1].ravel(),
        np.concatenate([np.minimum(start, bounds.upper - 1e-3), [0.0], comparison.initial(0.0).ravel()]),
        jacobian,
        bounds=(np.concatenate([bounds.lower, DELAYS[:1], -free]), np.concatenate([bounds.upper, DELAYS[1:], free])),
        x_scale='jac',
        xtol=1e-12,
        ftol=1e-12,
        gtol=1e-12,
        max_nfev=100,
    )
    assert fit.converged
    assert fit.cost <= 2 * expected.cost * (1 + 1e-6)
    np.testing.assert_allclose(fit.theta, expected.x[:7], rtol=1e-3, atol=1e-9)
    assert fit.delay == pytest.approx(expected.x[7], abs=1e-5)
    np.testing.assert_allclose(fit.initial.ravel(), expected.x[8:], atol=1e-3)
    if bound is not None:
        assert fit.theta[3] == bound
    np.testing.assert_array_equal(np.flatnonzero(~fit.free), [] if bound is None else [3])


def test_what_it_says_of_its_minimum_is_the_schur_complement_of_all_unknowns(few):
    comparison = of('positions', few)
    fit = levenberg_marquardt(comparison, vector('viscous'), 0.0, box('viscous'), DELAYS, tolerance=1e-12)
    states = roll(fit.theta, fit.initial, few.tau, few.step)
    residuals = comparison.residuals(states, fit.delay)
    slope = comparison.jacobian(fit.theta, states, fit.delay)
    np.testing.assert_allclose((residuals**2).sum(axis=1), fit.costs)
    for k in range(len(few)):
        local, shared = slope[k, :, :4], slope[k, :, 4:]
        mixed = shared.T @ local
        expected = shared.T @ shared - mixed @ np.linalg.solve(local.T @ local, mixed.T)
        gradient = shared.T @ residuals[k] - mixed @ np.linalg.solve(local.T @ local, local.T @ residuals[k])
        scale = np.sqrt(np.diag(shared.T @ shared))
        np.testing.assert_allclose(
            fit.informations[k] / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-4
        )
        np.testing.assert_allclose(fit.slopes[k] / scale, gradient / scale, atol=1e-2)
    assert (np.abs(fit.slopes.sum(axis=0)) < 1e-2 * np.abs(fit.slopes).sum(axis=0))[:-2].all()


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_no_step_leaves_the_bounds_or_makes_the_mass_matrix_indefinite(few, seed, signed):
    """From anywhere, also from outside: what a run of so many iterations ends with is where a longer one passes."""
    rng = np.random.default_rng(seed)
    bounds = Bounds(vector('viscous') * rng.uniform(0, 0.9, 7), vector('viscous') * rng.uniform(1.1, 3, 7), NAMES[:7])
    if signed:
        bounds = bounds.replaced('P3', -1.0, 1.0)
    start = bounds.lower + (bounds.upper - bounds.lower) * rng.uniform(-0.2, 1.2, 7)
    comparison = of('states', few)
    costs = []
    for iterations in (0, 1, 2, 4):
        fit = levenberg_marquardt(comparison, start, 0.05, bounds, DELAYS, iterations=iterations, tolerance=0.0)
        tiny = 1e-12 * (bounds.upper - bounds.lower)
        limit = LARGEST_COUPLING * np.sqrt(fit.theta[0] * fit.theta[1])
        assert (fit.theta >= bounds.lower - tiny)[[0, 1, 3, 4, 5, 6]].all()
        assert (fit.theta <= bounds.upper + tiny).all()
        assert fit.theta[2] >= min(bounds.lower[2], limit) - tiny[2]
        assert abs(fit.theta[2]) <= limit * (1 + 1e-12)
        assert DELAYS[0] <= fit.delay <= DELAYS[1]
        costs.append(fit.cost)
    assert (np.diff(costs) <= 0).all()


def test_segments_that_something_else_has_moved_hardly_move_the_robust_estimate():
    """In one of twenty somebody has touched the rig."""
    truth = vector('viscous')
    segments = Segments.cut([noisy(exact_motion(truth, 1000, seed=s), s) for s in (1, 2)], 0.2, 0.1, 0.025)
    tau = segments.tau.copy()
    tau[:, 10:30, 5::20] += np.array([1.5, -1.0])[:, None, None]
    clean, kicked = (of('states', replace(segments, tau=torque)) for torque in (segments.tau, tau))
    fits = {
        robust: [levenberg_marquardt(c, truth, 0.0, box('viscous'), DELAYS, robust=robust) for c in (clean, kicked)]
        for robust in (False, True)
    }
    squared, robust = (np.abs(fits[r][1].theta - fits[False][0].theta) / truth for r in (False, True))
    assert squared.max() > 0.1
    assert robust.max() < squared.max() / 5
    assert np.median(robust) < np.median(squared) / 5
    np.testing.assert_allclose(fits[True][0].theta, fits[False][0].theta, rtol=0.03)


#: Friction too stiff to be simulated: the motions, or their sensitivities only, are beyond floats.
HOPELESS = {'endless': [1, 1, 1, 1, 1, 1e6, 1e6], 'stiff': [1, 1, 1, 1, 1, 1e4, 1e4]}


@pytest.mark.parametrize('what', HOPELESS)
@pytest.mark.parametrize(('against', 'robust'), [('states', True), ('positions', False)])
def test_a_hopeless_start_is_no_error_and_no_result(few, what, against, robust):
    wide = Bounds(np.zeros(7), np.full(7, 1e5), NAMES[:7])
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        fit = levenberg_marquardt(
            of(against, few), vector('viscous') * HOPELESS[what], 0.0, wide, DELAYS, robust=robust
        )
    assert not fit.converged
