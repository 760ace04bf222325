# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The composite likelihood's estimate: exact rigs, the choice of hold, diverging filters, short recordings."""

from dataclasses import astuple, replace

import numpy as np
import pytest

from pendubot_identification.criteria.likelihood import Likelihood
from pendubot_identification.errors import TrajectoryError
from pendubot_identification.identification import fitting
from pendubot_identification.identification.fitting import TrainingData
from pendubot_identification.identification.pipeline import identify
from pendubot_identification.identification.selection import fit_composite
from pendubot_identification.identification.settings import Settings
from pendubot_identification.level import Level
from pendubot_identification.model.parameters import PAPER, Parameters
from pendubot_identification.model.simulation import simulate
from test import real
from test import simulated_rig as rig
from test.simulated_rig import Rig
from test.virtual import held_torques, recording, trajectory


def fitted(*recordings, effects=False, **options):
    """Return the estimate, and its steps as text."""
    data = TrainingData.prepare(recordings, Settings(**options).of_rig(recordings))
    answer = fit_composite(data, lambda *_: None, effects=effects)
    return answer, ' '.join(answer.steps)


def noisy(samples=400, seed=3):
    """A recording with 3 mrad of noise."""
    motion = recording(samples, seed=seed)
    return replace(motion, q=motion.q + np.random.default_rng(1).normal(scale=0.003, size=motion.q.shape))


def test_a_rig_that_turns_half_a_radian_between_samples_is_identified_exactly():
    motion = simulate(PAPER, np.arange(2000) / 200, held_torques(2000, 20, 0.8, 2))
    assert np.abs(np.diff(motion.q, axis=0)).max() > 0.45
    found = identify([motion[:1000]], [motion[1000:]])
    assert (found.level, found.warnings) == (Level.OK, ())
    np.testing.assert_allclose(found.best.theta[:5], astuple(PAPER)[:5], rtol=1e-5)


def test_a_disturbed_fast_motion_is_fitted_at_shorter_intervals():
    """The elbow turns at more than 100 rad/s; during half a second the recorded torque does not act."""
    (run,) = rig.record([4], [Rig(length=0.35, mass=0.15, strength=3.0)], seconds=8.0, step=0.0025)
    run.tau[700:800] = 0.0
    found = identify([trajectory(run)], [], Settings(model='coulomb', hold='zero', compensate=False))
    assert found.level is Level.ERROR
    assert 'the model predicts the motion over 0.025 s, and over 0.05 s is expected' in found.warnings[0]
    assert any(warning.startswith('a disturbance: ') and ' at 3.5 s' in warning for warning in found.warnings)


def test_the_torque_before_a_recording_is_unknown():
    """The recording starts with a torque, which acts 20 samples later; until then no torque acts."""
    rig = Parameters(0.0165, 0.00305, 0.00509, 0.1136, 0.0308, 0.004, 0.0009)
    motion = recording(2000, 0.001, counts=2000, rig=rig, delay=0.02, strength=3.0, width=0.5, hold=0.1)
    answer, _ = fitted(motion)
    assert (answer.exact is not None, answer.model) == (True, 'viscous')
    np.testing.assert_allclose(answer.theta[:5], rig.vector()[:5], rtol=2e-4)


@pytest.mark.parametrize(
    ('rate', 'counts', 'seconds', 'seeds'), [(1000, 500, 10.0, [1200, 1201, 1202]), (33, 4096, 6.0, [40, 41, 42])]
)
def test_correlated_quantization_is_no_unmodelled_effect(rate, counts, seconds, seeds):
    """A rig of 3 cm moves by less than a count for tens of samples, or has few samples; J2 correlates with P1 to P3.

    A larger model has errors of 20 %, or counts as inexact.
    """
    tiny = rig.SIZES['tiny']
    runs = rig.record(seeds, [tiny] * len(seeds), seconds=seconds, rate=rate, counts=counts, step=0.003)
    answer, _ = fitted(*map(trajectory, runs), hold='zero')
    assert (answer.exact is not None, answer.model) == (True, 'coulomb')
    np.testing.assert_allclose(answer.theta[:5], [*rig.true(tiny).values()][:5], rtol=0.01)


def test_one_noisy_recording_makes_the_fit_inexact():
    answer, steps = fitted(recording(400, seed=2), noisy())
    assert not answer.exact
    assert 'all samples' not in steps
    assert 'prediction errors' in steps
    np.testing.assert_allclose(answer.theta[:5], PAPER.vector()[:5], rtol=0.5)
    e, s = (each[answer.filter_data.weight > 0] for each in answer.last.likelihood.innovations(answer.last.x))
    per_measurement = (np.log(s) / 2 + 13 / 2 * np.log1p(e**2 / s / 12)).sum(axis=1).mean()
    np.testing.assert_allclose(answer.estimate().J, per_measurement, rtol=0.01)


def test_noise_of_unquantized_angles_does_not_bias_the_parameters():
    answer, _ = fitted(*(noisy(seed=seed) for seed in (3, 4)), model='viscous')
    np.testing.assert_allclose(answer.theta[:5], PAPER.vector()[:5], rtol=0.05)


def test_a_requested_hold_is_kept():
    assert fitted(recording(300, 0.02), hold='linear')[0].data.hold == 'linear'


def test_an_interval_at_which_the_filter_diverges_is_skipped(monkeypatch):
    real, longest = fitting.fit, [0.15]

    def fails(likelihood, *args, **how):
        if likelihood.filter_data.settings.intervals[-1] > longest[-1]:
            raise FloatingPointError
        return real(likelihood, *args, **how)

    monkeypatch.setattr(fitting, 'fit', fails)
    answer, steps = fitted(noisy())
    assert answer.filter_data.settings.intervals == (0.05, 0.1)
    assert 'innovations at 0.05, 0.1 s: ' in steps
    longest.append(0.0)
    with pytest.raises(TrajectoryError, match='no filter follows this motion'):
        fitted(noisy())


def test_a_filter_that_diverges_outside_the_middle_of_the_recordings_restarts(monkeypatch):
    real, raised = fitting.fit, []

    def fails(likelihood, *args, **how):
        if likelihood.levels == 1 and likelihood.filter_data.measurements > 50 and not raised:
            raised.append(likelihood)
            raise FloatingPointError
        return real(likelihood, *args, **how)

    expected, _ = fitted(recording(800, seed=2))
    monkeypatch.setattr(fitting, 'SETTINGS', replace(fitting.SETTINGS, search=4.0))
    monkeypatch.setattr(fitting, 'fit', fails)
    answer, _ = fitted(recording(800, seed=2))
    assert raised
    np.testing.assert_allclose(answer.theta[:5], expected.theta[:5], rtol=0.005)


def test_a_short_recording_beside_a_long_one_is_long_enough_for_the_search(monkeypatch):
    monkeypatch.setattr(fitting, 'SETTINGS', replace(fitting.SETTINGS, search=2.0))
    motions = [recording(2000), recording(200, seed=2)]
    data = TrainingData.prepare(motions, Settings(model='viscous', hold='zero').of_rig(motions)).excerpt()
    np.testing.assert_allclose([m.end - m.start for m in data.motions], [19.99 * 2.0 / 21.98, 1.0])
    np.testing.assert_allclose(data.linear('weak', 'viscous').criterion.free_minimum()[0], PAPER.P1, rtol=0.02)


def test_effects_of_long_recordings_are_searched_in_the_middle_and_estimated_from_all_samples(monkeypatch):
    monkeypatch.setattr(fitting, 'SETTINGS', replace(fitting.SETTINGS, search=8.0))
    motions = [*map(trajectory, rig.record(range(2), [Rig(dead_zone=0.015)] * 2, step=0.0025))]
    answer, _ = fitted(*motions, effects=True, model='coulomb', hold='zero')
    assert [(effect.name, effect.accepted) for effect in answer.effects] == [('dead zone', True)]
    assert answer.filter_data.measurements == sum(len(motion) - 1 for motion in motions)
    np.testing.assert_allclose(answer.theta[:5], [*rig.TRUE.values()][:5], rtol=1e-3)


def test_an_effect_of_the_middle_of_long_recordings_alone_is_not_compensated(monkeypatch):
    """The torque's sensor has an offset, whose sign changes: in the middle it is constant, on average zero."""
    monkeypatch.setattr(fitting, 'SETTINGS', replace(fitting.SETTINGS, search=10.0))
    runs = rig.record(range(2), [Rig()] * 2, step=0.0025)
    for k, run in enumerate(runs):
        run.tau += np.where(abs(run.t - 5.0) < 2.5, 0.1, -0.1)
        run.q += np.random.default_rng(k).normal(scale=0.01, size=run.q.shape)
    answer, _ = fitted(*map(trajectory, runs), effects=True, model='coulomb', hold='zero')
    (found,) = answer.effects
    assert (found.name, found.where, found.accepted) == ('offset', 'shoulder', False)


@pytest.mark.recordings
def test_a_fit_evaluates_the_likelihood_within_its_bounds_only(monkeypatch):
    """The sum of a friction and its step to zero is -1e-19 in some fits: the rig would be unphysical."""
    evaluate, outside = Likelihood.evaluate, []

    def recorded(like, x):
        outside.append(((x < like.lower) | (x > like.upper)).any())
        return evaluate(like, x)

    monkeypatch.setattr(Likelihood, 'evaluate', recorded)
    for take in real.recorded(real.RIGS[1], 'train')[-2:]:
        fitting.first_fit(TrainingData.prepare([take], Settings().of_rig([take])), lambda *_: None)
    assert outside
    assert not any(outside)


def test_every_recording_has_its_own_zeros():
    """Friction holds a link away from hanging while its zero is set; the second zero is wrong."""
    zeros = np.array([[0.03, -0.05], [-0.35, 0.2], [0.0, 0.0]])
    motions = [recording(800, seed=seed) for seed in range(3)]
    answer, steps = fitted(*(replace(m, q=m.q + zero) for m, zero in zip(motions, zeros, strict=True)))
    assert 'residual at the quantization level' in steps
    np.testing.assert_allclose(answer.theta[:5], astuple(PAPER)[:5], rtol=1e-3)
    np.testing.assert_allclose(answer.offsets, zeros, atol=1e-4)


def test_the_estimate_without_a_recording_is_the_fit_of_the_others():
    answer, _ = fitted(*(recording(400, seed=seed) for seed in (1, 2)), model='viscous')
    for removed in range(2):
        other, _ = fitted(recording(400, seed=2 - removed), model='viscous')
        np.testing.assert_allclose(answer.without(answer.filter_data.owner == removed)[:7], other.theta[:7], rtol=0.01)
    np.testing.assert_allclose(answer.without(answer.filter_data.owner < 0), answer.theta, rtol=1e-6)
