# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Standard errors against the spread of what they belong to: the virtual rig's estimates, and those of lines."""

import warnings

import numpy as np
import pytest
from scipy.stats import t as student

from pendubot_identification.criteria.levenberg_marquardt import Fit
from pendubot_identification.criteria.trajectory_fit import TrajectoryFit, fit_positions
from pendubot_identification.identify.covariance import (
    correlations,
    estimated_zeros,
    scaled_condition_number,
    trajectory_covariance,
)
from pendubot_identification.model.parameters import PAPER, default_bounds
from pendubot_identification.trajectories.motion import Motion
from test.virtual import C1, CHAOTIC, recording

TRUTH = np.append(PAPER.vector(), 0.0)
BOX = default_bounds().of(7)


def line(phi, y, group, start, *, white=False, free=None, by_zeros=(0.0, 0.0)):
    """The fit of y = phi theta over segments, shapes (L, M, G) and (L, M): where the criterion is a parabola.

    What is not free stays zero. ``by_zeros``, shape (2,) or (M, 2): how residuals depend on the recording's zeros.
    """
    free = np.ones(phi.shape[2], dtype=bool) if free is None else free
    theta = np.zeros(phi.shape[2])
    theta[free] = np.linalg.lstsq(phi[..., free].reshape(-1, free.sum()), y.ravel(), rcond=None)[0]
    residuals = phi @ theta - y
    costs = (residuals**2).sum(axis=1)
    everything = np.concatenate([phi, np.broadcast_to(by_zeros, (*y.shape, 2))], axis=2)
    fit = Fit(
        theta=theta[:-1],
        delay=float(theta[-1]),
        initial=np.zeros((4, len(phi))),
        costs=costs,
        free=free,
        informations=np.einsum('lmi,lmj->lij', everything, everything),
        slopes=np.einsum('lmi,lm->li', everything, residuals),
        iterations=1,
        converged=True,
    )
    variance = float(costs.sum() / (y.size - free.sum()))
    return TrajectoryFit(fit, 'positions' if white else 'states', 0.5, group, start, variance, white), theta


def clustered(rng, recordings, each=8):
    """Segments of recordings, each with an error of its own that all of its segments share."""
    group = np.repeat(np.arange(recordings), each)
    phi = rng.normal(size=(len(group), 6, 3)) + rng.normal(size=(recordings, 1, 3))[group]
    common = rng.normal(size=recordings)[group, None]
    return phi, 0.3 * rng.normal(size=phi.shape[:2]) + common, group, np.tile(0.5 * np.arange(each), recordings)


def test_of_a_line_with_white_residuals_it_is_the_textbooks():
    rng = np.random.default_rng(1)
    phi, _, group, start = clustered(rng, 5)
    y = 0.2 * rng.normal(size=phi.shape[:2])
    found, _ = line(phi * [1, 1e-3, 1e4], y, group, start, white=True)
    covariance, std_error, words = trajectory_covariance(found)
    whole = (phi * [1, 1e-3, 1e4]).reshape(-1, 3)
    np.testing.assert_allclose(covariance, found.variance * np.linalg.inv(whole.T @ whole), rtol=1e-6)
    np.testing.assert_allclose(std_error, np.sqrt(np.diag(covariance)))
    assert f'{found.variance:.2f} times' in words


def test_of_a_line_it_is_the_jackknife_that_leaves_one_recording_out():
    phi, y, group, start = clustered(np.random.default_rng(2), 6)
    found, _ = line(phi, y, group, start)
    covariance, _, words = trajectory_covariance(found)
    without = [line(phi[group != k], y[group != k], group[group != k], start[group != k])[1] for k in range(6)]
    moves = without - np.mean(without, axis=0)
    quantile = student.ppf(0.975, 5) / 1.96
    np.testing.assert_allclose(covariance, quantile**2 * 5 / 6 * moves.T @ moves, rtol=1e-6)
    assert words == 'cluster jackknife over 6 recordings; Student quantile 2.57 included'


@pytest.mark.parametrize('recordings', [4, 12])
def test_intervals_hold_the_truth_however_few_the_recordings(recordings):
    """Of residuals that hang together within a recording; what takes them for white holds it half of the time."""
    rng, held, naive, errors = np.random.default_rng(3), [], [], []
    for _ in range(200):
        found, theta = line(*clustered(rng, recordings))
        _, std_error, _ = trajectory_covariance(found)
        errors.append([theta, std_error])
        held.append(np.abs(theta) < 1.96 * std_error)
        white = np.sqrt(found.variance * np.diag(np.linalg.inv(found.fit.informations.sum(axis=0)[:3, :3])))
        naive.append(np.abs(theta) < 1.96 * white)
    assert np.mean(held) > 0.9
    assert np.mean(naive) < np.mean(held) - 0.05
    theta, std_error = np.moveaxis(errors, 1, 0)
    ratio = np.median(std_error, axis=0) / theta.std(axis=0)
    assert (ratio > 0.7).all()
    assert (ratio < 3).all()


@pytest.mark.parametrize('recordings', [1, 2])
def test_one_or_two_recordings_are_cut_into_blocks_of_time(recordings):
    """Their errors hang together over a second or so, and the blocks are longer than that."""
    rng, held, errors = np.random.default_rng(4), [], []
    start = np.tile(np.arange(0, 60, 0.5), recordings)
    group = np.repeat(np.arange(recordings), 120)
    for _ in range(100):
        phi = np.repeat(rng.normal(size=(len(start) // 2, 6, 3)), 2, axis=0)
        shared = np.repeat(rng.normal(size=(len(start) // 2, 6)), 2, axis=0)
        found, theta = line(phi, shared, group, start + 17.3)
        _, std_error, words = trajectory_covariance(found)
        held.append(np.abs(theta) < 1.96 * std_error)
        errors.append(theta / std_error)
    assert f'over {15 * recordings} blocks of 4 s' in words
    assert 0.9 < np.mean(held) < 0.99
    assert 0.7 < np.std(errors) < 1.2


def offset(rng, recordings, sizes=(0.05, 0.1), each=40):
    """Segments of recordings, whose zeros are off."""
    group = np.repeat(np.arange(recordings), each)
    by_zeros = 2 * rng.normal(size=(6, 2))
    phi = rng.normal(size=(len(group), 6, 3)) + 0.3 * by_zeros @ rng.normal(size=(2, 3))
    angles = rng.normal(size=(recordings, 2)) * sizes
    y = 0.02 * rng.normal(size=phi.shape[:2]) + angles[group] @ by_zeros.T
    return line(phi, y, group, np.tile(0.25 * np.arange(each), recordings), by_zeros=by_zeros), angles.T


def test_zeros_of_a_line_are_told_with_their_errors():
    rng, z = np.random.default_rng(8), []
    for _ in range(20):
        (found, _), angles = offset(rng, 3)
        off, std_error = estimated_zeros(found, 4)
        assert np.isnan(off[:, 3]).all(), 'a recording without segments'
        assert np.isnan(std_error[:, 3]).all()
        np.testing.assert_allclose(off[:, :3], angles, atol=0.04)
        z.append((off[:, :3] - angles) / std_error[:, :3])
    assert 0.88 < (np.abs(z) < 1.96).mean() < 0.99


def test_intervals_of_a_recording_know_of_its_zeros():
    rng, z = np.random.default_rng(9), []
    for _ in range(60):
        (found, theta), _ = offset(rng, 1)
        _, std_error, words = trajectory_covariance(found)
        z.append(np.abs(theta) / std_error)
    assert 'zeros too' in words
    assert np.mean(np.array(z) < 1.96) > 0.95


@pytest.mark.parametrize('white', [True, False])
def test_what_a_bound_holds_has_no_covariance_but_a_standard_error(white):
    phi, y, group, start = clustered(np.random.default_rng(6), 8)
    free = np.array([True, False, True])
    covariance, std_error, _ = trajectory_covariance(line(phi, y, group, start, white=white, free=free)[0])
    assert np.isnan(covariance[1]).all()
    assert np.isnan(covariance[:, 1]).all()
    alone, _, _ = trajectory_covariance(line(phi[..., free], y, group, start, white=white)[0])
    np.testing.assert_allclose(covariance[np.ix_(free, free)], alone)
    np.testing.assert_allclose(std_error[free], np.sqrt(np.diag(alone)))
    loose = trajectory_covariance(line(phi, y, group, start, white=white)[0])[1]
    assert 0.3 < std_error[1] / loose[1] < 3, 'about what it would have without'


@pytest.mark.parametrize('white', [True, False])
def test_what_nothing_tells_has_an_infinite_error_and_spoils_no_other(white):
    phi, y, group, start = clustered(np.random.default_rng(7), 8)
    phi[..., 1] = 0.0
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        found, _ = line(phi, y, group, start, white=white)
        covariance, std_error, _ = trajectory_covariance(found)
    assert std_error[1] == np.inf
    told = np.array([True, False, True])
    alone, _, _ = trajectory_covariance(line(phi[..., told], y, group, start, white=white)[0])
    np.testing.assert_allclose(covariance[np.ix_(told, told)], alone, rtol=0.01)
    assert scaled_condition_number(found) == np.inf


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('white', [False, True])
def test_what_cannot_be_told_apart_has_infinite_errors_and_no_warning(white):
    phi, y, group, start = clustered(np.random.default_rng(1), 6)
    phi[:, :, 1] = 0.3 * phi[:, :, 0]
    covariance, std_error, _ = trajectory_covariance(line(phi, y, group, start, white=white)[0])
    assert np.isinf(std_error).tolist() == [True, True, False]
    assert np.isfinite(covariance[2, 2])
    # A bound that holds one of the two leaves the other told.
    held = line(phi, y, group, start, white=white, free=np.array([True, False, True]))[0]
    assert np.isfinite(trajectory_covariance(held)[1]).all()


def test_correlations_are_those_of_the_information_of_what_is_free_and_told():
    phi, _, _, _ = clustered(np.random.default_rng(9), 3)
    columns = phi.reshape(-1, 3) * [1, 1e-3, 1e4]
    everything = np.concatenate([columns, columns[:, :1] + columns[:, 1:2], np.zeros((len(columns), 1))], axis=1)
    free = np.array([True, True, True, False, True])
    found = correlations(everything.T @ everything, free)
    covariance = np.linalg.inv(columns.T @ columns)
    deviation = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(found[:3, :3], covariance / np.outer(deviation, deviation), atol=1e-8)
    assert np.isnan(found[3:]).all()
    assert np.isnan(found[:, 3:]).all()


def test_the_condition_number_is_that_of_the_columns_scaled_to_one():
    phi, y, group, start = clustered(np.random.default_rng(8), 5)
    phi[..., 2] = phi[..., 0] + 0.01 * phi[..., 2]
    found, _ = line(phi * [1, 1e-5, 1e3], y, group, start)
    flat = phi.reshape(-1, 3)
    expected = np.linalg.cond(flat / np.linalg.norm(flat, axis=0))
    assert scaled_condition_number(found) == pytest.approx(expected, rel=1e-6)
    held = np.array([True, True, False])
    found, _ = line(phi, y, group, start, free=held)
    expected = np.linalg.cond((flat / np.linalg.norm(flat, axis=0))[:, held])
    assert scaled_condition_number(found) == pytest.approx(expected, rel=1e-6)


def test_of_the_virtual_rig_they_are_the_spread_over_recordings_and_hold_the_truth():
    errors = []
    for seed in range(12):
        found = fit_positions([Motion.prepare(recording(200, seed=seed), 0.02)], TRUTH[:-1], 0.0, BOX, (-0.1, 0.1))
        assert found.white
        errors.append([np.append(found.fit.theta, found.fit.delay) - TRUTH, trajectory_covariance(found)[1]])
    error, std_error = np.moveaxis(errors, 1, 0)
    assert 0.88 <= (np.abs(error) < 1.96 * std_error).mean() <= 0.99
    z = np.sqrt(((error / std_error) ** 2).mean(axis=0))
    assert (z > 0.5).all()
    assert (z < 1.7).all()


@pytest.mark.parametrize('counts', [0, 4000])
def test_of_exact_data_in_chaotic_motion_they_hold_the_truth(counts):
    """What is left of positions that are not rounded is the simulation's own error, and anything but white."""
    z, truth = [], C1.vector('rotor')
    for seed in range(1, 4):
        motion = Motion.prepare(recording(600, seed=seed, counts=counts, **CHAOTIC), 0.02)
        found = fit_positions([motion], truth, 0.0, default_bounds().of(len(truth)), (-0.1, 0.1))
        assert found.white == bool(counts)
        _, std_error, words = trajectory_covariance(found)
        assert ('segments of' in words) != bool(counts)
        z.append((found.fit.theta - truth) / std_error[:-1])
    assert (np.abs(z) < 1.96).mean() > 0.85
    assert np.abs(z).max() < 4
