# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Open-loop prediction errors as a criterion: its slopes, the scale of each recording, and its prior."""

from dataclasses import replace

import numpy as np
import pytest

from pendubot_identification.criteria.likelihood import FilterData
from pendubot_identification.criteria.prediction_error import PredictionSettings, Simulations, refine
from pendubot_identification.errors import TrajectoryError
from pendubot_identification.model.parameters import default_bounds
from pendubot_identification.trajectories.motion import Motion
from test.criteria.likelihoods import TRUE, motions

HORIZONS, STRIDE = (0.1, 0.25, 0.5), 0.05
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


def test_derivatives_agree_with_finite_differences_of_the_errors(prepared):
    theta = 1.05 * TRUE + 0.01
    simulations = Simulations.of(prepared, theta, 0.004, np.array([0.01, -0.02]), HORIZONS, STRIDE)
    errors, states = simulations.errors(theta)
    found = simulations.derivatives(theta, states)
    assert found.shape == (3, 4, 14, len(simulations.t))
    assert errors.shape == (3, 4, len(simulations.t))
    for k, step in enumerate(1e-6 * np.eye(14)):
        expected = (simulations.errors(theta + step)[0] - simulations.errors(theta - step)[0]) / 2e-6
        np.testing.assert_allclose(found[:, :, k], expected, rtol=1e-4, atol=1e-5 * abs(expected).max() + 1e-6)


@pytest.mark.parametrize(('delay', 'before', 'behind'), [(0.01, 0.01, 0.0), (-0.06, 0.0, 0.06), (0.0, 0.0, 0.0)])
def test_simulations_lie_within_their_recordings(prepared, delay, before, behind):
    parts = [prepared[0], prepared[1].part(1.0, 1.3), prepared[2].part(2.0, 4.0)]
    simulations = Simulations.of(parts, TRUE, delay, np.zeros(2), HORIZONS, STRIDE)
    assert set(simulations.recording) == {0, 2}
    for number in (0, 2):
        t = simulations.t[simulations.recording == number]
        assert t[0] == pytest.approx(parts[number].start + before)
        assert t[-1] + 0.5 + behind <= parts[number].end
        assert t[-1] + 0.5 + behind + STRIDE >= parts[number].end - 1e-9
        np.testing.assert_allclose(np.diff(t), STRIDE)


def test_slopes_and_information_agree_with_the_criterion(prepared):
    found = refined(prepared, 1.1 * TRUE, 1e4 * np.diag(1 / np.maximum(TRUE, 0.01) ** 2))
    settings, filter_data = PredictionSettings(), FilterData.of(prepared)
    simulations = Simulations.of(prepared, 1.1 * TRUE, 0.0, np.zeros(2), HORIZONS, STRIDE)
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
    assert found.theta[0] <= upper[0]
    assert found.theta[3] == upper[3]
    assert ((found.theta >= lower) & (found.theta <= upper)).all()


def test_recordings_that_are_shorter_than_the_longest_horizon_are_refused(prepared):
    short = [m.part(1.0, 1.4) for m in prepared]
    with pytest.raises(TrajectoryError, match=r'shorter than 0\.5 s; choose longer windows'):
        refined(short)
