# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The trajectory criterion's minimum on the virtual rig: from bad starts, from none, and with the wrong model."""

from dataclasses import replace

import numpy as np
import pytest

from pendubot_identification.criteria.trajectory_fit import fit_positions, fit_states, search, segment_cost
from pendubot_identification.identify.covariance import trajectory_covariance
from pendubot_identification.identify.prediction import state_scale
from pendubot_identification.model.parameters import MODELS, PAPER, default_bounds
from pendubot_identification.optimizers.mde import MDESettings
from pendubot_identification.trajectories.motion import Motion
from test.virtual import C1, CHAOTIC, recording

TRUTH = PAPER.vector()
DELAYS = (-0.1, 0.1)


def prepared(*recordings):
    motions = [Motion.prepare(r, 0.02) for r in recordings]
    return motions, state_scale(motions)


def box(model='viscous'):
    return default_bounds().of(MODELS[model])


def wrong(found):
    """The worst relative error of any parameter."""
    return np.abs(found.fit.theta / TRUTH - 1).max()


def test_finds_the_virtual_rig_from_parameters_wrong_by_a_factor_of_three():
    motions, scale = prepared(recording(seed=5))
    start = TRUTH * 3.0 ** np.random.default_rng(5).choice([-1, 1], 7)
    costs = []
    rough = fit_states(motions, start, 0.0, box(), DELAYS, scale, progress=costs.append)
    assert costs
    assert rough.fit.converged
    assert (rough.kind, rough.length, rough.exact) == ('states', pytest.approx(0.5, abs=0.005), False)
    assert wrong(rough) < 0.1
    sharp = fit_positions(motions, rough.fit.theta, rough.fit.delay, box(), DELAYS)
    assert sharp.white
    assert sharp.kind == 'positions'
    assert sharp.length > 0.99 * (motions[0].end - motions[0].start), 'as one segment'
    assert sharp.variance == pytest.approx(1, abs=0.15)
    assert wrong(sharp) < 0.005
    assert sharp.fit.delay == pytest.approx(0, abs=5e-5)
    assert sharp.fit.converged


@pytest.mark.parametrize('noise', [0.0, 3e-4])
def test_positions_that_no_encoder_has_read_will_do(noise):
    motion = recording(400, counts=0, seed=2)
    motion = replace(motion, q=motion.q + np.random.default_rng(1).normal(scale=noise, size=motion.q.shape))
    motions, scale = prepared(motion)
    rough = fit_states(motions, TRUTH * 1.2, 0.0, box(), DELAYS, scale)
    sharp = fit_positions(motions, rough.fit.theta, rough.fit.delay, box(), DELAYS)
    assert sharp.exact
    assert sharp.white == bool(noise), 'without noise the simulation errs alone, at each sample as at the one before'
    assert sharp.length > (3.9 if noise else 0.4)
    assert wrong(sharp) < (0.005 if noise else 1e-5)


@pytest.mark.parametrize(('counts', 'seed'), [(0, 1), (4000, 1)])
def test_a_chaotic_motion_is_followed_for_seconds(counts, seed):
    """From smoothed states as they are at 100 Hz it could not be, for two seconds."""
    motions, scale = prepared(recording(seed=seed, counts=counts, **CHAOTIC))
    start = np.append(C1.vector('rotor') * 1.1, 0.0)
    rough = fit_states(motions, start[:-1], 0.0, box('rotor'), DELAYS, scale)
    sharp = fit_positions(motions, rough.fit.theta, rough.fit.delay, box('rotor'), DELAYS)
    assert sharp.fit.converged
    assert sharp.length >= 1
    off = sharp.fit.theta / C1.vector('rotor') - 1
    assert np.abs(off).max() < (0.05 if counts == 4000 else 0.005)
    assert np.abs((sharp.fit.theta - C1.vector('rotor')) / trajectory_covariance(sharp)[1][:-1]).max() < 4


def test_a_model_without_the_rigs_dry_friction_is_not_taken_for_exact():
    rig = replace(PAPER, Fc1=0.03, Fc2=0.001)
    motions, scale = prepared(recording(500, rig=rig, seed=2))
    fits = []
    for model in ('viscous', 'coulomb'):
        start = np.pad(TRUTH, (0, MODELS[model] - 7))
        fits.append(fit_states(motions, start, 0.0, box(model), DELAYS, scale).fit)
    assert fits[1].cost < fits[0].cost / 5
    assert fit_positions(motions, fits[0].theta, 0.0, box(), DELAYS) is None


@pytest.mark.parametrize(
    ('model', 'friction', 'samples', 'interval'),
    [('viscous', {}, 1500, 0.002), ('coulomb', {'Fc1': 0.03, 'Fc2': 0.001}, 400, 0.01)],
)
def test_neither_pulses_shorter_than_a_step_nor_dry_friction_bend_it(model, friction, samples, interval):
    """Simulated with long steps they would, by many times what its standard errors promise."""
    rig, bounds = replace(PAPER, **friction), box(model)
    motions, scale = prepared(recording(samples, interval, rig=rig, seed=2))
    rough = fit_states(motions, rig.vector(model) * 1.1, 0.0, bounds, DELAYS, scale)
    sharp = fit_positions(motions, rough.fit.theta, rough.fit.delay, bounds, DELAYS)
    assert sharp.length == pytest.approx(samples * interval, abs=3 * interval)
    assert sharp.variance == pytest.approx(1, abs=0.15)
    off = (sharp.fit.theta - rig.vector(model)) / trajectory_covariance(sharp)[1][:-1]
    assert np.abs(off).max() < 4


def test_the_criterion_is_small_for_the_truth_only_and_averages():
    motions, scale = prepared(recording(500))
    J, count = segment_cost(motions, TRUTH, 0.0, box(), scale)
    assert J < 0.01, 'a hundredth of the variances'
    assert count > 4 * 100
    for k, factor in enumerate([0.7, 3, 5, 0.7, 3, 0.5, 20]):
        other = TRUTH * [factor if i == k else 1 for i in range(7)]
        assert segment_cost(motions, other, 0.0, box(), scale)[0] > 1.2 * J
    assert segment_cost(motions, TRUTH, 0.03, box(), scale)[0] > 3 * J
    twice = [*motions, Motion.prepare(replace(recording(500), t=motions[0].recorded.t + 50), 0.02)]
    again = segment_cost(twice, TRUTH, 0.0, box(), scale)
    np.testing.assert_allclose(again, (J, 2 * count), rtol=1e-6)


def test_a_search_anywhere_within_the_bounds_ends_in_the_basin():
    motions, scale = prepared(recording(500, seed=2))
    told = []
    settings = MDESettings(population=30, generations=51, per_component=False)
    result = search(motions, box(), scale, settings, 1, 2, lambda generation, best: told.append((generation, best)))
    assert (np.diff(result.history[:, 0]) <= 0).all()
    assert told
    assert told[0][1] >= result.value[0]
    theta = result.x[0]
    assert ((box().lower <= theta) & (theta <= box().upper)).all()
    assert theta[2] ** 2 < theta[0] * theta[1]
    assert wrong(fit_states(motions, theta, 0.0, box(), DELAYS, scale)) < 0.1
