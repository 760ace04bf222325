# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The composite innovations likelihood: its slopes, its blocks of time and its minimum."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import PPoly
from scipy.optimize import minimize

from pendubot_identification.criteria.likelihood import (
    Effect,
    FilterData,
    Likelihood,
    LikelihoodSettings,
    Unknown,
    bounded_step,
    fit,
)
from pendubot_identification.model.filter import Term, TermKind
from pendubot_identification.model.parameters import Parameters, default_bounds
from pendubot_identification.model.simulation import quantised, simulate
from pendubot_identification.trajectories.motion import Motion
from test.simulated_rig import Rig, record, true
from test.virtual import C1, CHAOTIC, recording, trajectory

#: Parameters of a rig with geared motors.
TRUE = C1.vector('geared')


def motions(seeds=(1, 2), samples=1000, smoothing=0.05, **options):
    """Return recordings of the geared rig, by default sampled every 5 ms."""
    options = {'interval': 0.005, **CHAOTIC, **options}
    return [Motion.prepare(recording(samples, seed=seed, **options), smoothing) for seed in seeds]


def likelihood(prepared, theta=TRUE, effects=(), **settings):
    """Return the likelihood of recordings, and a start with this theta."""
    filter_data = FilterData.of(prepared, LikelihoodSettings(**settings))
    levels = len(filter_data.settings.intervals)
    torque = np.sqrt(np.mean(np.concatenate([m.recorded.tau for m in prepared]) ** 2, axis=0)).max()
    speed = max(m.states(m.recorded.t)[2:].std() for m in prepared)
    inertia, weight = theta[:2].sum(), theta[3:5].sum()
    own = [inertia] * 3 + [weight] * 2 + [torque / speed] * 2 + [torque] * 2 + [inertia] + [torque] * 2 + [1, 1]
    quantization, box = np.log(filter_data.quantization) / 2, default_bounds()
    noise = [*(quantization + 0.4), *np.log([0.03 * torque] * 2)] * levels
    low, high = [*quantization, -20, -20] * levels, [*(quantization + 3), 5, 5] * levels
    rest = np.full(1 + 2 * len(prepared), 0.1)  # the delay and the offsets
    lower, upper = (np.concatenate(parts) for parts in ((box.lower, -rest, low), (box.upper, rest, high)))
    like = Likelihood(filter_data, lower, upper, np.array([*own, 0.01]))
    x = np.concatenate([theta, 0 * rest, noise])
    return like.extended(effects, x) if effects else (like, x)


def information(like, evaluation):
    """Return the diagonal of the information of all blocks."""
    total = np.zeros(len(like.lower))
    for block, owner in zip(evaluation.informations, like.filter_data.owner, strict=True):
        total[like.of_recording(owner)] += np.diag(block)
    return total


def scaled(motion, own):
    """Return the motion with its torques increased by a fraction."""
    return replace(motion, impulse=PPoly(motion.impulse.c * (1 + own[0]), motion.impulse.x))


#: An additional torque, a scale of the recorded torque, and the width of the shoulder's dry friction.
EFFECTS = (
    Effect('drag', 'elbow', (Unknown(0.01, -1.0, 1.0, 0.003),), (Term(TermKind.DRAG, 1),)),
    Effect('gain', 'motor', (Unknown(0.1, -0.5, 0.5, 0.02),), shape=scaled),
    Effect('width', 'shoulder', (Unknown(0.05, 0.005, 3.0, 0.08),), width=(0,)),
)


@pytest.fixture(scope='module')
def prepared():
    return motions()


@pytest.mark.parametrize(('effects', 'freedom'), [((), 1e9), (EFFECTS, 12.0)], ids=['model', 'effects'])
def test_slopes_agree_with_finite_differences_of_the_costs(prepared, effects, freedom):
    like, x = likelihood(prepared, 1.02 * TRUE + 0.01, effects, freedom=freedom, intervals=(0.05, 0.2))
    x[14] = 0.002
    x[like.shared : like.before_noise] = 0.001, -0.002, -0.003, 0.004
    evaluation = like.evaluate(x)
    np.testing.assert_allclose(evaluation.costs, like.costs(x))
    steps = 1e-4 * np.concatenate([like.scale, np.full(4, 0.01), np.ones(4 * like.levels)])
    expected = [(like.costs(x + d) - like.costs(x - d)) / (2 * abs(d).sum()) for d in np.diag(steps)]
    # Scaled by the square root of the curvature.
    size = np.sqrt(information(like, evaluation))
    size = np.where(size > 0, size, 1.0)  # k2 has no information without a torque at the elbow.
    np.testing.assert_allclose(evaluation.slopes / size, np.transpose(expected) / size, rtol=2e-3, atol=2e-2)


def test_blocks_add_up_to_the_likelihood_of_the_recordings(prepared):
    like, x = likelihood(prepared)
    whole, _ = likelihood(prepared, block=math.inf)
    assert len(like.filter_data.owner) == 10
    assert len(whole.filter_data.owner) == 2
    np.testing.assert_array_equal(like.filter_data.owner, np.repeat([0, 1], 5))
    parts, sums = like.evaluate(x), whole.evaluate(x)
    for name in ('costs', 'slopes', 'informations'):
        part, total = getattr(parts, name), getattr(sums, name)
        np.testing.assert_allclose(part.reshape(2, 5, *part.shape[1:]).sum(axis=1), total, rtol=1e-9, atol=1e-6)


def test_the_prior_penalises_the_offsets(prepared):
    like, x = likelihood(prepared, intervals=(0.2,))
    x[like.shared : like.before_noise] = 0.05, 0.0, 0.0, -0.1
    found = like.evaluate(x)
    assert found.cost - found.costs.sum() == pytest.approx(0.5 * (1 + 4))
    prior = np.isin(np.arange(len(x)), (15, 16, 17, 18)) / 0.05**2
    np.testing.assert_allclose(found.slope - found.slopes.sum(axis=0), prior * x, atol=1e-6)
    np.testing.assert_allclose(np.diag(found.information) - information(like, found), prior, atol=1e-3)


def test_the_fit_converges_from_a_start_with_errors_of_30_percent(prepared):
    start = TRUE * np.where(np.arange(14) % 2, 0.7, 1.3)
    like, x = likelihood(prepared, start)
    costs = []
    found = fit(like, x, iterations=60, progress=costs.append)
    assert found.converged
    np.testing.assert_allclose(found.x[:5], TRUE[:5], rtol=1e-3)
    np.testing.assert_allclose(found.x[7:10], TRUE[7:10], rtol=1e-2)
    assert len(costs) == found.iterations
    assert (np.diff(costs) < 0).all()
    assert found.evaluation.cost == pytest.approx(like.costs(found.x).sum() + like.prior(found.x))
    assert not fit(like, x, iterations=2).converged
    assert fit(like, found.x, iterations=1, tolerance=0.0).converged  # the rest is negligible


def test_the_fit_of_a_wrong_model_reaches_a_minimum():
    """Pushes by hand: the curvature of J is far from the expected information."""
    (run,) = record([1], [Rig(pushes=2)], step=0.005)
    pushed = [Motion.prepare(trajectory(run), 0.05)]
    like, x = likelihood(pushed, Parameters(**true(Rig())).vector('geared'), intervals=(0.05,))
    found = fit(like, x)
    assert found.converged
    scale = np.sqrt(np.maximum(np.diag(found.evaluation.information), 1.0))

    def scaled(z):
        evaluation = like.evaluate(z / scale)
        return evaluation.cost, evaluation.slope / scale

    box = np.column_stack([like.lower, like.upper]) * scale[:, None]
    other = minimize(scaled, found.x * scale, jac=True, method='L-BFGS-B', bounds=box, options={'maxiter': 10})
    assert other.fun > found.evaluation.cost - 0.5


def test_the_intensity_of_white_torque_noise_is_estimated_at_each_interval():
    rng = np.random.default_rng(5)
    sigma, interval = 0.02, 0.005
    noisy = []
    for seed in (1, 2):
        clean = recording(2000, interval, seed=seed, **CHAOTIC)
        hidden = rng.normal(scale=sigma / math.sqrt(interval), size=clean.tau.shape)
        simulated = quantised(simulate(C1, clean.t, clean.tau + hidden), 4000)
        noisy.append(Motion.prepare(replace(simulated, tau=clean.tau), 0.05))
    like, x = likelihood(noisy)
    found = fit(like, x, iterations=60)
    intensities = np.exp(found.x[like.before_noise :].reshape(3, 4)[:, 2:])
    np.testing.assert_allclose(intensities, sigma, rtol=0.4)


def test_bounds_are_kept(prepared):
    like, x = likelihood(prepared, 0.9 * TRUE, intervals=(0.1,))
    like.upper[0] = 0.97 * TRUE[0]
    like.lower[3] = like.upper[3] = 1.02 * TRUE[3]
    found = fit(like, x)
    assert found.x[0] == like.upper[0]
    assert found.x[3] == like.upper[3]
    assert not found.free[[0, 3]].any()
    assert found.free[[1, 2, 4]].all()
    assert ((like.lower <= found.x) & (found.x <= like.upper)).all()
    assert found.x[2] ** 2 < found.x[0] * found.x[1]


def test_the_step_is_zero_without_information():
    zero = np.zeros(2)
    step, gain = bounded_step(np.zeros((2, 2)), zero, 1e-3, zero - 1, zero + 1, np.ones(2, dtype=bool))
    assert (step == 0).all()
    assert gain == 0


def test_the_fit_converges_from_an_indefinite_mass_matrix(prepared):
    like, x = likelihood(prepared, intervals=(0.1,))
    inside = fit(like, x)
    x[:3] = 0.7 * TRUE[0], 0.7 * TRUE[1], 2 * TRUE[2]
    found = fit(like, x, 60)
    np.testing.assert_allclose(found.x[:5], inside.x[:5], rtol=0.01)


def test_a_start_at_which_the_filter_diverges_is_refused(prepared):
    like, x = likelihood(prepared, intervals=(0.1,))
    x[5], like.upper[5] = 1e6, math.inf
    with pytest.raises(FloatingPointError):
        fit(like, x)


def test_samples_at_rest_have_no_weight():
    """The rig hangs at rest for 2 s before it moves."""
    moving = recording(600, 0.005, seed=1, **CHAOTIC).tau
    t = np.arange(1000) * 0.005
    tau = np.concatenate([np.zeros((400, 2)), moving])
    at_rest = Motion.prepare(quantised(simulate(C1, t, tau), 4000), 0.05)
    like, x = likelihood([at_rest])
    resting, t = like.filter_data.weight == 0, like.filter_data.t
    assert resting[t < 1.9].all()
    assert not resting[t > 2.2].all()
    evaluation = like.evaluate(x)
    assert evaluation.costs[0] == 0.0 != evaluation.costs[-1]
    assert not evaluation.slopes[0].any()
    assert not evaluation.informations[0].any()


def test_missing_samples_lengthen_the_step_of_the_filter(prepared):
    whole = prepared[0].recorded
    kept = ~((whole.t > 2.0) & (whole.t < 2.09)) & (np.arange(len(whole.t)) % 41 != 40)
    holed = Motion.prepare(whole[kept], 0.05)
    filter_data = FilterData.of([holed], LikelihoodSettings(step=0.005))
    for g, (*_, edges, _, rows) in enumerate(filter_data.series):
        t = np.append(edges[0], filter_data.t[rows])
        assert np.isin(t, holed.recorded.t).all()
        assert np.isin(t, edges).all()
        assert (np.diff(edges) > 0).all()
        assert np.diff(edges).max() <= 0.005 + 1e-9
        assert np.diff(t).max() >= 0.09 - 1e-9
        assert (filter_data.samples.row[g] >= 0).sum() == len(t) - 1
        np.testing.assert_allclose(filter_data.samples.h[g].sum(), t[-1] - t[0])
    found = fit(*likelihood([holed, prepared[1]], 0.9 * TRUE, step=0.005), iterations=60)
    np.testing.assert_allclose(found.x[:5], TRUE[:5], rtol=1e-3)


@pytest.mark.parametrize('interval', [0.033, 0.09])
def test_each_filter_uses_samples_at_about_its_interval(interval):
    prepared = motions(samples=round(4 / interval), interval=interval, seeds=(1,))
    filter_data = FilterData.of(prepared)
    assert np.bincount(filter_data.samples.level, minlength=3).tolist() == [1, 1, 1]
    for wanted, each in zip(filter_data.settings.intervals, filter_data.series, strict=True):
        apart = np.diff(np.append(each.edges[0], filter_data.t[each.rows]))
        np.testing.assert_allclose(apart, max(1, round(wanted / interval)) * interval, rtol=1e-6)


def test_a_recording_that_is_shorter_than_an_interval_contributes_nothing():
    long, short = motions()[:1], motions((2,), samples=30)
    for prepared in ([*long, *short], [*short, *long]):
        like, x = likelihood(prepared, intervals=(0.2,))
        evaluation, ours = like.evaluate(x), like.filter_data.owner == prepared.index(short[0])
        assert np.isfinite(evaluation.cost)
        assert not evaluation.costs[ours].any()
        assert not evaluation.informations[ours].any()
