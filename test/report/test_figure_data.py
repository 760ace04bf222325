# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Figure data against the criteria and independent formulas."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from pendubot_identification.criteria.prediction_error import STEP
from pendubot_identification.identification.prediction import state_scale
from pendubot_identification.identification.settings import Settings
from pendubot_identification.model.parameters import PAPER
from pendubot_identification.model.rollout import roll
from pendubot_identification.report.figure_data import SHOWN, excitation, residuals, simulate_beside
from pendubot_identification.results.provenance import Answer
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.trajectory import Trajectory
from test.identified import identified
from test.virtual import exact_motion, recording, vector

THETA = PAPER.vector()


def answer(theta=THETA, criterion='likelihood', model='viscous', delay=0.0):
    return Answer(criterion, model, np.array(theta), delay)


@pytest.fixture(scope='module')
def found():
    """A real result with what it was made of."""
    from pendubot_identification.recordings.bag_reader import read_trajectory
    from test.identified import SAMPLE

    result = identified()
    motion = Motion.prepare(read_trajectory(SAMPLE).trajectory[:400], result.smoothing)
    return result, [motion]


@pytest.mark.parametrize('criterion', ['energy', 'weak'])
def test_the_mean_square_of_the_residuals_is_J(found, criterion):
    result, motions = found
    estimate = next(e for e in result.estimates if e.criterion == criterion)
    given = answer(estimate.theta, criterion, delay=estimate.effort.delay)
    left = residuals(motions, given, result.settings)
    everything = np.concatenate([values for _, _, values in left.parts])
    assert everything.size == estimate.residuals
    np.testing.assert_allclose((everything**2).mean(), estimate.J, rtol=1e-6)
    assert all(np.diff(t).min() > 0 for _, t, _ in left.parts)


def test_innovations_of_the_likelihood_are_white_and_of_unit_variance():
    motion = Motion.prepare(recording(900), 0.02)
    left = residuals([motion], answer(), Settings(hold='zero'))
    ((_, t, values),) = left.parts
    assert left.unit == 'standard deviations'
    np.testing.assert_allclose(np.diff(t), 0.05)
    np.testing.assert_allclose((values**2).mean(axis=0), 1, atol=0.35)
    assert (np.abs(left.autocorrelation[1:]) < 1.5 * left.band).mean() > 0.85


def test_the_simulation_of_an_exact_motion_is_exact():
    theta = vector('viscous')
    motion = exact_motion(theta, 1500, 0.005)
    shown = simulate_beside([motion], answer(theta), state_scale([motion]))
    assert shown.complete
    assert shown.ahead == 1.0
    size, _, count = shown.simulated.shape
    expected = motion.states(shown.t[np.arange(size)[:, None] + (size - 1) * np.arange(count)])
    np.testing.assert_allclose(np.moveaxis(shown.simulated, 1, 0), expected, atol=1e-6)
    np.testing.assert_allclose(shown.measured, motion.states(shown.t))
    # The torques of the grid move the rig from each start as the simulations do.
    states = roll(theta, shown.simulated[0, :, :1], shown.tau[:, :200, None], STEP)
    np.testing.assert_allclose(states[:, :, 0], shown.simulated[:, :, 0], rtol=1e-9)


def test_the_worst_part_of_long_recordings_is_shown():
    good = recording(4000, name='a')
    t = good.t
    # For two seconds the recorded torque is not the one that acted.
    tau = good.tau + np.outer((t > 25) & (t < 27), [0.05, 0.0])
    motion = Motion.prepare(replace(good, tau=tau), 0.02)
    shown = simulate_beside([Motion.prepare(recording(800, seed=2, name='b'), 0.02), motion], answer(), np.ones(4))
    assert shown.name == 'a'
    assert not shown.complete
    assert shown.t[0] < 25 < 27 < shown.t[-1]
    assert shown.t[-1] - shown.t[0] <= SHOWN


def test_a_diverged_simulation_is_nan_without_a_warning():
    motion = Motion.prepare(recording(600), 0.02)
    lost = THETA.copy()
    lost[5:] = -10.0
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        shown = simulate_beside([motion], answer(lost), state_scale([motion]))
    assert np.isnan(shown.simulated).any()
    assert not np.isinf(shown.simulated).any()


def test_a_parameter_of_a_resting_joint_has_no_part_of_its_own():
    motion = Motion.prepare(recording(900), 0.02)
    moving = excitation([motion], answer())
    t = np.arange(900) * 0.01
    q = np.column_stack([-np.pi / 2 + 0.3 * np.sin(2 * np.pi * t), 1e-6 * np.sin(9 * t)])
    still = excitation([Motion.prepare(Trajectory(t, q, np.zeros_like(q)), 0.02)], answer())
    b2, (term, own, _), (others, alone, _) = 6, moving, still
    assert others[b2].max() < 1e-3 * term[b2].max()
    # With the elbow held, the two links are one pendulum: P1, P2 and P3 say the same of the shoulder.
    assert (alone[:3, 0] < 1e-2 * others[:3, 0]).all()
    assert (own[:3, 0] > 1e-2 * term[:3, 0]).all()
    for shown, part in ((term, own), (others, alone)):
        assert (part <= shown).all()
        assert shown[0, 1] == part[0, 1] == 0.0, "P1 has no part in the elbow's equation"


def test_parameters_without_effect_are_zero():
    """Of a link 2 without mass or friction all of the elbow's equation is 0."""
    motion = Motion.prepare(recording(300), 0.02)
    term, own, _ = excitation([motion], answer(THETA * [1, 0, 0, 1, 0, 1, 0]))
    assert (term[:, 1] == 0).all()
    assert (own[:, 1] == 0).all()
    assert (term[[0, 3], 0] > 0).all()
