# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The complete identification of simulated and real motions, good and poor."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pendubot_identification.criteria.prediction_error import HORIZONS, Prediction, predict, state_scale
from pendubot_identification.errors import ExcitationError, ParameterError, TrajectoryError
from pendubot_identification.identification.pipeline import identify
from pendubot_identification.identification.settings import Settings
from pendubot_identification.identification.validation import assess
from pendubot_identification.level import Level
from pendubot_identification.model.parameters import NAMES, PAPER, Parameters, default_bounds
from pendubot_identification.model.simulation import HANGING, quantised, simulate
from pendubot_identification.trajectories.motion import Motion
from test.identification.test_assessment import GOOD
from test.identification.test_unmodelled import ANOTHER
from test.real import recorded
from test.virtual import C1, CHAOTIC, GEARED, STIFF, exact_motion, recording

TRUTH = PAPER.vector()
#: Fast settings.
ENERGY = Settings(criteria=('energy',), model='viscous', optimizer='lsq')
WEAK = Settings(criteria=('weak',), model='viscous', optimizer='lsq', hold='zero')
LIKELIHOOD = Settings(model='viscous', hold='zero')


def error(estimate, truth=TRUTH):
    """Return the largest relative error of the parameters."""
    return np.abs(estimate.theta / truth - 1).max()


def test_default_settings_identify_the_true_parameters_and_report_progress():
    reports = []
    result = identify([recording(400, seed=2)], progress=lambda *report: reports.append(report))
    best = result.best
    assert (result.level, result.warnings, result.effects) == (Level.OK, (), ())
    assert (best.criterion, best.model) == ('likelihood', 'viscous')
    assert (best.prediction.error < result.estimates[0].prediction.error)[:3].all(), 'better than energy'
    assert best.exact
    assert best.converged
    assert error(best) < 0.005
    assert best.determined.all()
    assert (np.abs(best.theta - TRUTH) < 4 * best.std_error).all()
    assert (best.effort.hold, round(best.effort.delay, 3)) == ('zero', 0)
    assert result.interval == pytest.approx(0.01)
    assert np.degrees(np.abs(best.zeros.angles)).max() < 0.05
    stages = ' '.join(stage for stage, *_ in reports)
    assert stages.startswith('preparing')
    for part in ('checking signs', 'likelihood: scoring', 'unmodelled effects', 'all samples', 'energy: MDE'):
        assert part in stages
    assert all(0 <= done <= total or total == 0 for _, done, total, _ in reports)
    J = [best for stage, _, _, best in reports if stage == 'energy: MDE']
    assert (np.diff(J) <= 0).all()


def test_missing_samples_few_generations_and_notes_give_warnings():
    motion = recording(400)
    kept = (np.arange(400) < 100) | (np.arange(400) % 12 != 4)
    settings = replace(WEAK, optimizer='mde', generations=20)
    result = identify([motion[kept]], [], settings, notes=['the bag was not closed'])
    warnings = ' '.join(result.warnings)
    assert result.level > Level.OK
    assert 'about 25 of 400 samples are missing' in warnings
    assert 'of 10 runs reached the exact minimum' in warnings
    assert 'the bag was not closed' in result.warnings


def noisy(motion):
    """Return the motion with an effort that another sensor measured, with noise."""
    return replace(motion, tau=motion.tau + np.random.default_rng(1).normal(scale=[0.02, 0], size=motion.tau.shape))


def stuck(motion):
    """Return the motion with encoders that stand still for 0.4 s."""
    return replace(motion, q=np.concatenate([motion.q[:200], np.repeat(motion.q[200:201], 40, axis=0), motion.q[240:]]))


@pytest.mark.parametrize(
    ('rig', 'change', 'warning'),
    [
        (PAPER, lambda motion: motion, ''),
        (ANOTHER, lambda motion: motion, 'both parts of one contradict each other'),
        (PAPER, lambda motion: replace(motion, q=np.add(motion.q, [0.0, 0.07])), "one: q2's zero is off by 4.0 +-"),
        (PAPER, noisy, 'do not explain the validation data'),
        (PAPER, stuck, 'a disturbance: one at '),
    ],
    ids=['alike', 'another rig', 'another zero', 'noisy', 'disturbed'],
)
def test_validation_data_that_differ_from_the_training_data_are_reported(rig, change, warning):
    validation = change(recording(500, seed=2, rig=rig, name='one'))
    result = identify([recording(500, name='one')], [validation], LIKELIHOOD)
    assert result.level is (Level.WARN if warning else Level.OK)
    assert warning in ''.join(result.warnings[:1])


def test_every_recording_is_predicted_with_its_own_zeros():
    """Also of energy, whose estimate contains the error of the training recording's zero."""
    motions, off = [recording(600, seed=k) for k in (1, 2)], np.array([[0.01, -0.008], [-0.03, 0.04]])
    right = identify(motions[:1], motions[1:], LIKELIHOOD)
    result = identify(*([replace(m, q=m.q + zero)] for m, zero in zip(motions, off, strict=True)), LIKELIHOOD)
    assert (result.best.exact, result.level, result.warnings) == (True, Level.OK, ())
    np.testing.assert_allclose(result.best.zeros.angles.T, off, atol=2e-4)
    assert (result.best.zeros.std_error < 2e-4).all()
    np.testing.assert_allclose(result.best.prediction.error, right.best.prediction.error, rtol=0.01)
    assert (result.estimates[0].prediction.error[:3] < 1.3 * right.estimates[0].prediction.error[:3]).all()


def test_a_zero_that_is_wrong_in_all_recordings_is_compensated_by_likelihood_alone():
    motions = [recording(600, seed=k) for k in (1, 2)]
    wrong = [replace(m, q=m.q + np.radians([10, 6 * k])) for k, m in enumerate(motions)]
    energy, best = identify(wrong, settings=LIKELIHOOD).estimates
    assert (energy.level, best.level) == (Level.ERROR, Level.WARN)
    assert best.warnings[0].startswith("q1's zero is off by 10.0 +-")
    assert [w.split(' +-')[0] for w in best.warnings[1:]] == [f"{motions[1].name}: q2's zero is off by 6.0"]
    np.testing.assert_allclose(best.theta, TRUTH, rtol=0.005)
    np.testing.assert_allclose(
        best.prediction.error, identify(motions, settings=LIKELIHOOD).best.prediction.error, 0.02
    )


@pytest.mark.parametrize(
    ('criteria', 'driven', 'absent'), [(('energy', 'weak', 'likelihood'), (1, 0), 'k2'), (('weak',), (0, 1), 'k1')]
)
def test_a_joint_without_a_motor_has_no_friction_under_load(criteria, driven, absent):
    motion = exact_motion(GEARED, 300, 0.01, seed=3, strength=np.array(driven)).recorded
    for estimate in identify([motion], settings=Settings(criteria, 'geared', hold='zero')).estimates:
        present = estimate.present
        assert estimate.absent == (absent,)
        assert list(np.array(NAMES)[~present]) == [absent]
        assert (estimate.theta[~present] == 0).all()
        assert np.isnan(estimate.std_error[~present]).all()
        assert np.isnan(estimate.intervals[~present]).all()
        assert np.isfinite(estimate.std_error[present]).all()
        assert np.isfinite(estimate.condition_number)
        assert absent not in ' '.join([*estimate.warnings, *estimate.advice])


def test_a_delay_of_the_effort_is_estimated():
    delay = -0.018
    result = identify([recording(250, delay=delay, seed=2)], [], LIKELIHOOD)
    effort = result.best.effort
    assert abs(effort.delay - delay) < 4 * effort.std_error < 1e-3
    assert error(result.best) < 0.01
    assert result.best.exact


@pytest.mark.parametrize(('torque', 'step', 'q'), [(0.02, 0.5, (0.5, 0.5)), (0.5, 2.0, HANGING)])
def test_a_steady_torque_is_not_a_fault_and_a_motion_at_rest_validates_nothing(torque, step, q):
    rig = Parameters(P1=0.06, P2=0.03, P3=0.025, P4=0.25, P5=0.12, b1=0.01, b2=0.002, Fc1=0.03, Fc2=0.01)
    t = np.arange(2000) * 0.01
    motion = quantised(simulate(rig, t, np.outer(np.where(t < step, 0.0, torque), [1, 0]), q), 4096)
    half = len(t) // 2
    result = identify([motion[:half]], [motion[half:]])
    assert not result.faults
    assert result.level < Level.ERROR
    assert ('validates nothing' in ' '.join(result.warnings)) == (torque == 0.5)
    assert (np.abs(result.best.theta[:5] - rig.vector('geared')[:5]) < result.best.half_width[:5]).all()


def test_a_measured_torque_gives_the_first_order_hold():
    """A measured torque changes linearly between samples; a commanded torque is held."""
    t, fine = np.arange(300) * 0.02, np.arange(5980) * 0.001
    torque = np.interp(fine, t, 0.3 * np.random.default_rng(1).choice([-1, 1], 300))
    motion = quantised(simulate(PAPER, fine, np.column_stack([torque, 0 * fine]))[::20], 4000)
    result = identify([motion], [], Settings(model='viscous'))
    assert result.best.effort.hold == 'linear'
    assert 'torque measured at its samples' in ' '.join(result.best.steps)
    assert error(result.best) < 0.02


def test_a_held_torque_is_not_taken_for_a_measured_one():
    """At 200 Hz a measured torque that acts half a sample later fits as well, here even better."""
    assert identify([recording(400, 0.005, seed=2)]).best.effort.hold == 'zero'


def test_a_delay_gives_a_warning_unless_it_is_declared():
    delay = 0.023
    late = recording(400, delay=delay)
    found, declared, beyond = (
        identify([late], [], replace(WEAK, delays=d)) for d in ((-0.1, 0.1), (delay, delay), (-0.01, 0.01))
    )
    assert found.best.effort.delay == pytest.approx(delay, abs=5e-4)
    assert any('the effort acts 23 ms later' in w for w in found.warnings)
    assert error(found.best) < 0.05
    assert declared.level is Level.OK
    assert declared.best.effort.delay == delay
    # A search interval without the delay makes the parameters useless.
    assert any('the end of its search interval' in text for text in beyond.best.consequences)
    assert (found.level, beyond.level) == (Level.WARN, Level.ERROR)
    # A delay of 0 is plausible, also at the end of the interval.
    assert identify([recording(400)], [], replace(WEAK, delays=(-0.05, 0.0))).level is Level.OK


@pytest.mark.parametrize(
    'start',
    [Parameters(*(TRUTH * 3.0 ** np.random.default_rng(0).choice([-1, 1], 7))), replace(PAPER, P2=0.0, P3=0.0)],
    ids=['wrong by a factor of 3', 'without inertia'],
)
def test_the_estimate_converges_from_a_wrong_start(start):
    result = identify([recording(400, seed=2)], [], replace(LIKELIHOOD, start=start))
    assert error(result.best) < 0.01
    assert result.level is Level.OK


def test_a_start_from_which_no_filter_follows_is_refused():
    start = Parameters(P1=-1.0, P2=0.0, P3=5.0, P4=-3.0, P5=2.0, b1=-1.0, b2=0.0)
    with pytest.raises(TrajectoryError, match='from the parameters of start; leave it out'):
        identify([recording(400, seed=2)], [], replace(LIKELIHOOD, start=start))


def test_a_stiff_rig_is_identified_from_few_samples_and_a_wrong_initial_delay(monkeypatch):
    """Smoothing at a low sampling rate resembles a delay; with that delay the filter of a stiff rig diverges.

    At 33 Hz, friction under load resembles a lower torque of the motor.
    """
    monkeypatch.setattr('pendubot_identification.identification.fitting.estimate_delay', lambda *_, **__: 0.06)
    best = identify([recording(220, 0.03, rig=STIFF, seed=2, strength=4.0)], [], Settings(hold='zero')).best
    np.testing.assert_allclose(best.theta[:5], STIFF.vector()[:5], rtol=0.03)
    assert abs(best.effort.delay) < 1e-3


def test_a_chaotic_motion_is_explained_exactly():
    motion, truth = recording(1200, seed=1, **CHAOTIC), C1.vector('rotor')
    result = identify([motion[:900]], [motion[900:]], Settings(optimizer='lsq'))
    best = result.best
    assert result.level is Level.OK
    assert (best.criterion, best.model, best.exact) == ('likelihood', 'rotor', True)
    assert (np.abs(best.theta - truth) < 3 * best.std_error).all()
    assert error(best, truth) < 0.05


@pytest.mark.parametrize('count', [2, 3])
def test_without_validation_each_recording_or_block_is_predicted_from_the_others(count):
    motions = [recording(200, seed=s) for s in range(count)]
    result = identify(motions, [], ENERGY)
    if count < 3:
        assert result.validation == 'each of 6 blocks of time predicted from the others'
        return
    assert result.validation == 'each recording predicted from the others'
    prepared = [Motion.prepare(m, result.smoothing) for m in motions]
    parts = []
    for k, held_out in enumerate(prepared):
        theta = identify(motions[:k] + motions[k + 1 :], [], ENERGY).best.theta
        parts.append(predict([held_out], theta, 0.0, state_scale(prepared)))
    np.testing.assert_allclose(result.best.prediction.errors, Prediction.pool(parts).errors, rtol=1e-6)


def test_correlations_are_not_computed_from_the_differences_of_three_recordings():
    """The differences of three estimates span two directions only, so that all parameters would seem correlated."""
    motions = [exact_motion(GEARED, 300, 0.01, seed=seed, strength=1.5).recorded for seed in (1, 2, 3)]
    best = identify(motions, settings=Settings(model='coulomb', hold='zero')).best
    assert not best.exact
    assert '3 recordings' in best.uncertainty
    assert set(best.freedom) <= {2.0, 4.0, np.inf}
    apart = best.correlation[np.ix_(best.free, best.free)] - np.eye(best.free.sum())
    assert best.free.sum() > 6
    assert np.abs(apart).max() < 0.99
    assert not any(', correlation ' in sentence for sentence in best.advice)


def test_validation_data_do_not_change_the_estimate():
    motions = [recording(250, seed=s) for s in range(3)]
    alone, assessed, other = (identify(motions[:1], v, WEAK).best for v in ([], motions[1:], motions[2:]))
    np.testing.assert_array_equal(alone.theta, assessed.theta)
    np.testing.assert_array_equal(alone.std_error, assessed.std_error)
    assert np.isnan(alone.J_validation)
    assert assessed.J_validation > 0
    assert assessed.J_validation != other.J_validation
    assert (assessed.prediction.errors != other.prediction.errors).all()


@pytest.mark.parametrize('fault', ['torque at random', 'angles at random', 'in quarter turns'])
def test_an_unphysical_or_useless_result_is_never_ok(fault):
    motion, rng = recording(300, seed=2), np.random.default_rng(1)
    broken = {
        'torque at random': replace(motion, tau=rng.permutation(motion.tau)),
        'angles at random': replace(motion, q=np.cumsum(rng.normal(scale=0.02, size=motion.q.shape), axis=0)),
        'in quarter turns': replace(motion, q=motion.q / (np.pi / 2)),
    }
    result = identify([broken[fault]], [], replace(WEAK, criteria=('energy', 'weak')))
    assert result.level > Level.OK
    assert result.warnings
    for estimate in result.estimates:
        assert abs(estimate.theta[2]) <= np.sqrt(estimate.theta[0] * estimate.theta[1])


@settings(max_examples=30)
@given(
    st.lists(st.floats(-0.5, 2), min_size=7, max_size=7),
    st.lists(st.floats(0.01, 3), min_size=len(HORIZONS), max_size=len(HORIZONS)),
)
def test_no_unphysical_or_badly_predicting_result_has_the_level_ok(factors, errors):
    theta = TRUTH * factors
    size = np.repeat(np.array(errors)[:, None], 4, axis=1)
    prediction = Prediction(size, np.ones_like(size), np.full(len(HORIZONS), 9))
    estimate = replace(GOOD, theta=theta, prediction=prediction)
    bounds = replace(default_bounds(), lower=np.full(14, -10.0))
    assessed = assess(estimate, replace(WEAK, bounds=bounds))
    unphysical = bool(Parameters.from_vector(theta).unphysical())
    worse = max(errors[:3]) > 1
    assert (assessed.level is Level.ERROR) >= (unphysical or worse)
    assert any(w.startswith(('not physical', 'hardly physical')) for w in assessed.warnings) >= unphysical
    assert any(w.startswith('predicts worse than assuming that nothing moves') for w in assessed.warnings) == worse
    assert (assessed.level is Level.OK) == (not assessed.warnings)
    np.testing.assert_array_equal(assessed.theta, theta)


def test_a_parameter_on_its_bound_is_reported_and_keeps_its_standard_error():
    bounds = default_bounds().of(7).replaced('b1', 0.0, 0.001)
    result = identify([recording(400)], [], replace(WEAK, bounds=bounds))
    assert any(w.startswith('b1 lies on its bound 0.001') for w in result.warnings)
    assert not result.best.free[5]
    assert np.isnan(result.best.covariance[5]).all()
    assert np.isfinite(result.best.std_error).all()
    assert result.level > Level.OK


def test_friction_at_a_standstill_may_be_fixed_for_a_joint_that_always_turns():
    """Its column is 1e-80 of the others."""
    rig, t = Parameters(P1=0.02, P2=0.005, P3=0.004, P4=0.02, P5=0.01, b1=0.005, b2=0.0005), np.arange(500) * 0.01
    motion = simulate(rig, t, np.outer(0.05 + 0.03 * np.sign(np.sin(7 * t)), [1, 0]), qd=(9.0, 2.0))
    assert motion.qd[:, 0].min() > 6
    bounds = default_bounds().replaced('Fs1', 0, 0).replaced('k1', 0, 0)
    best = identify([quantised(motion, 4000)], [], replace(WEAK, model='geared', bounds=bounds)).best
    np.testing.assert_allclose(best.theta[:5], rig.vector()[:5], rtol=0.1)
    assert best.theta[10] == 0


MOTION = recording(300)
AT_REST = np.tile(HANGING, (300, 1))


@pytest.mark.parametrize(
    ('motion', 'sentence'),
    [
        (replace(MOTION, q=AT_REST, tau=0 * MOTION.tau), 'moved by only 0 and 0 rad, so none of P1'),
        (
            replace(MOTION, q=np.column_stack([MOTION.q[:, 0], AT_REST[:, 1]])),
            r'P1, P2, P3.* are not identifiable.*elbow moved by only 0 rad',
        ),
        (replace(MOTION, tau=0 * MOTION.tau), 'the torque does no work'),
        (MOTION[(MOTION.t < 1.5) | (MOTION.t > 1.8)], r'without a sample begin at 1\.490 s'),
        (MOTION[:30], 'too few'),
        (MOTION[:100], 'too short for the criteria weak and likelihood'),
    ],
)
def test_uninformative_recordings_are_refused_with_a_sentence(motion, sentence):
    with pytest.raises((ExcitationError, TrajectoryError), match=sentence):
        identify([motion], [], WEAK)


@pytest.mark.parametrize(
    ('settings', 'samples', 'interval'), [(WEAK, 102, 0.01), (LIKELIHOOD, 130, 0.01), (ENERGY, 125, 0.002)]
)
def test_short_recordings_are_identified(settings, samples, interval):
    """The criterion energy accepts motions that are shorter than a test function."""
    result = identify([recording(samples, interval, seed=2)], [], settings)
    assert np.isfinite(result.best.theta).all()
    assert result.best.prediction.starts.shape == (len(HORIZONS),)
    assert np.isnan(result.link_length).all() == (settings is ENERGY)


@pytest.mark.parametrize(
    ('changes', 'sentence'),
    [
        ({'criteria': ('energy', 'magic')}, 'criterion is magic; one of energy'),
        ({'criteria': ('weak', 'weak')}, 'one or more of energy'),
        ({'delays': (0.1, -0.1)}, 'the smaller one is expected first'),
        ({'delays': (0.0, float('inf'))}, 'delay is inf; .* from -0.5 to 0.5 s is expected'),
        ({'model': 'geared', 'bounds': default_bounds().of(7)}, 'bounds of 7 parameters were given'),
        ({'bounds': default_bounds().replaced('k1', 0.1, 0.2)}, 'bounds of k1 exclude 0, its value in smaller'),
        ({'runs': 0}, 'runs is 0; a whole number from 1'),
    ],
)
def test_invalid_settings_are_refused(changes, sentence):
    with pytest.raises(ParameterError, match=sentence):
        Settings(**changes)


@pytest.mark.recordings
def test_a_real_rig_is_predicted_better_than_by_persistence_and_by_published_parameters():
    motions = [motion[motion.t < 4] for motion in recorded('dfki_C1_sysid', 'train')[:2]]
    result = identify(motions, motions[:1], Settings(model='rotor', hold='zero'))
    prepared = [Motion.prepare(m, result.smoothing, result.best.effort.hold) for m in motions]
    scale, published_theta = state_scale(prepared), C1.vector()
    own, published = (
        predict(prepared, theta, result.best.effort.delay, scale).error[:3]
        for theta in (result.best.theta, published_theta)
    )
    assert (own < predict(prepared, published_theta, 0.0, scale).persistence[:3] / 2).all()
    assert (own < 0.8 * published).all()
    assert not Parameters.from_vector(result.best.theta).unphysical()
    assert not result.best.exact


@pytest.mark.recordings
def test_half_of_one_recording_of_a_real_rig_agrees_with_all_within_its_intervals():
    """A wrong fit of these 5 s had a delay of 74 ms and a third of the inertia."""
    motion = recorded('dfki_A0_sysid', 'train')[0]
    found = identify([motion[: len(motion) // 2]], [motion[len(motion) // 2 :]]).best
    of_all = np.array([0.1137, 0.0253, 0.0356, 0.3578, 0.1202])  # with half-widths, as in docs/benchmarks.md
    both = np.hypot(found.half_width[:5], [0.0044, 0.0008, 0.0011, 0.0142, 0.0023])
    assert (np.abs(found.theta[:5] - of_all) < both).all()
    assert (both < of_all / 2).all()
    assert abs(found.effort.delay) < 0.01
