# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Unmodelled effects, disturbances and contradictions of recordings are detected, and reported once."""

import re
from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest

from pendubot_identification.criteria.likelihood import SHARED
from pendubot_identification.identification import effects
from pendubot_identification.identification.effects import find_effects
from pendubot_identification.identification.fitting import TrainingData, first_fit
from pendubot_identification.identification.pipeline import identify
from pendubot_identification.identification.selection import Fits, fit_composite
from pendubot_identification.identification.settings import Settings
from pendubot_identification.identification.validation import contradictions, disturbances
from pendubot_identification.level import Level
from pendubot_identification.model.parameters import Parameters
from pendubot_identification.trajectories.conversion import Affine
from pendubot_identification.trajectories.motion import Motion
from test import real
from test.simulated_rig import CATALOGUE, FC, STRENGTH, UNKNOWN, Rig, record, true
from test.virtual import recording, trajectory

SETTINGS = Settings(model='coulomb', hold='zero')
#: Rigs with an effect, and the size of the effect by location.
EFFECTS = {
    'dead zone': (Rig(dead_zone=0.02), {'motor': 0.02}),
    'back-EMF': (Rig(no_load=12.0), {'motor': np.hypot(STRENGTH, 1 / 12.0)}),
    'eccentricity': (Rig(eccentric=0.02), {"elbow's encoder": 0.02}),
    'asymmetry': (Rig(asymmetry=0.8), {'shoulder': -0.4 * FC[0], 'elbow': -0.4 * FC[1]}),
    'drag': (Rig(drag=0.0003), {'shoulder': -0.0003, 'elbow': -0.0003}),
    'cogging': (Rig(cogging2=(0.008, 4)), {'elbow, 4 a turn': 0.008}),
}
#: All rigs by name, simulated at once.
RIGS = {name: rig for name, (rig, _) in EFFECTS.items()} | {
    'ideal': Rig(),
    'saturation': CATALOGUE['saturation'][2],
    'offset': CATALOGUE['offset'][0],
    'lag': CATALOGUE['lag'][2],
    'backlash': UNKNOWN['backlash'][2],
    'push': UNKNOWN['push'][2],
}
P1_TO_P5 = np.array(list(true(Rig()).values())[:5])


@pytest.fixture(scope='module')
def recordings():
    """Return two recordings of 8 s of each rig."""
    batch = [rig for rig in RIGS.values() for _ in range(2)]
    seeds = [0, 1] * len(RIGS)
    recordings = iter(record(seeds, batch, seconds=8.0, step=0.0025, begin=10.0 * np.array(seeds)))
    return {name: [next(recordings), next(recordings)] for name in RIGS}


@pytest.fixture(scope='module')
def problem(recordings):
    """Return a cached function that returns the data of a rig, and the fit of the shortest interval."""

    @cache
    def problem(name):
        motions = [trajectory(each) for each in recordings[name]]
        data = TrainingData.prepare(motions, SETTINGS.of_rig(motions))
        return data, first_fit(data, lambda *_: None)

    return problem


@pytest.fixture(scope='module')
def detected(problem):
    """Return a cached function that returns the detected effects of a rig."""
    return cache(lambda name: [found for found, _ in find_effects(problem(name)[1])])


@pytest.mark.parametrize('name', EFFECTS)
def test_only_the_true_effect_of_a_rig_is_accepted(problem, detected, name):
    (_, rough), (_, sizes), found = problem(name), EFFECTS[name], detected(name)
    assert {(f.name, f.where) for f in found} == {(name, where) for where in sizes}
    assert all(f.accepted for f in found)
    P = rough.x[:5]
    for f in found:
        # The asymmetry of the shoulder is estimated before that of the elbow, whose friction is small.
        tolerance = 0.3 if name == 'asymmetry' else 0.03
        assert np.linalg.norm(f.sizes) == pytest.approx(abs(sizes[f.where]), rel=tolerance)
        assert np.sign(f.sizes[0]) == np.sign(sizes[f.where])
        P = P * (1 + f.moved)
        assert f'({f.where}, ' in f.sentence
        assert ' compensated, P1 to P5 change by ' in f.sentence
    np.testing.assert_allclose(P, P1_TO_P5, rtol=2e-3)


def test_an_effect_below_the_threshold_is_reported_as_possible_and_not_compensated(problem):
    data, rough = problem('dead zone')
    ((found, _),) = find_effects(rough, effects.EffectSettings(sure=np.inf))
    assert (found.name, found.accepted) == ('dead zone', False)
    assert found.sentence.startswith('possible, not compensated: the motor gives no torque below a threshold (motor)')
    assert effects.compensated(data.motions[0], [found], 0.0) is data.motions[0]
    assert list(find_effects(rough, effects.EffectSettings(sure=np.inf, tried=np.inf))) == []


def test_every_effect_is_a_candidate_and_cogging_only_of_joints_that_turn(problem):
    motions = problem('drag')[0].motions
    assert {c.name for c in effects.catalogue(motions, 0.0)} == set(effects.MEANINGS)
    still = [replace(m, recorded=replace(m.recorded, q=m.recorded.q * [0.01, 1.0])) for m in motions]
    assert {c.where.split(',')[0] for c in effects.catalogue(still, 0.0) if c.name == 'cogging'} == {'elbow'}


def test_compensated_torques_equal_the_acting_torques(problem, detected):
    """A dead zone changes the recorded torque; drag adds a torque that depends on the smoothed speed."""
    for name in ('dead zone', 'drag'):
        motion = problem(name)[0].motions[0]
        t = np.arange(0.5, 7.0, 0.005)
        acting = np.diff(effects.compensated(motion, detected(name), 0.0).impulse(t), axis=0) / 0.005
        recorded = np.diff(motion.impulse(t), axis=0) / 0.005
        if name == 'dead zone':
            expected = np.sign(recorded) * np.maximum(abs(recorded) - 0.02, 0)
        else:
            v = motion.states((t[1:] + t[:-1]) / 2)[2:].T
            expected = recorded - 0.0003 * v * abs(v)
        np.testing.assert_allclose(acting, expected, atol=0.02 * abs(acting - recorded).max())


@pytest.fixture
def identified(recordings):
    """Return a function that returns the result of a rig's recordings and the largest error of P1 to P5 [%]."""

    def identified(name, settings=SETTINGS):
        result = identify([trajectory(each, f'take {k}') for k, each in enumerate(recordings[name])], [], settings)
        return result, 100 * np.abs(result.best.theta[:5] / list(true(RIGS[name]).values())[:5] - 1).max()

    return identified


def test_an_ideal_rig_is_identified_exactly(identified):
    result, error = identified('ideal', Settings())
    assert (result.level, result.warnings, result.effects) == (Level.OK, (), ())
    assert result.best.exact
    assert error < 0.01


def test_an_effect_is_reported_and_compensated(identified):
    result, error = identified('saturation')
    assert [(effect.name, effect.where, effect.accepted) for effect in result.effects] == [
        ('saturation', 'motor', True)
    ]
    assert result.level is Level.WARN
    (warning,) = result.warnings
    assert 'compensated, P1 to P5 change by up to' in warning
    assert error < 0.05


def test_an_effect_with_a_size_on_its_bound_is_not_accepted(problem):
    (data, rough), quiet = problem('saturation'), lambda *_: None
    before = Fits.of(data, rough, quiet)
    found, with_it = next(find_effects(rough))
    after = Fits.of(data, with_it, quiet)
    assert after.surely_better(before, found)
    free = after.exact.free & (np.arange(len(after.exact.free)) != SHARED)
    assert not replace(after, exact=replace(after.exact, free=free)).surely_better(before, found)


@pytest.mark.parametrize(
    ('name', 'beginning'), [('offset', "the shoulder's effort is off by"), ('lag', 'the torque follows')]
)
def test_a_fault_that_is_also_an_effect_is_reported_once(identified, name, beginning):
    result, error = identified(name)
    (warning,) = result.warnings
    assert warning.startswith(beginning)
    assert result.level is Level.WARN
    assert error < 0.05


def test_an_effect_outside_the_catalogue_is_reported_by_its_fraction_of_the_innovation_variance(identified):
    result, error = identified('backlash')
    assert result.level is Level.WARN
    (warning,) = result.warnings
    assert warning.startswith('the rig has unmodelled effects, or its angles are noisy: they make 9')
    assert (result.unmodelled > 0.8).all()
    assert error < 2


def test_pushes_by_hand_are_reported_as_disturbances(identified, recordings):
    result, error = identified('push')
    assert result.level is Level.WARN
    assert result.warnings[0].startswith('a disturbance: ')
    named = re.findall(r'take (\d) at ([\d.]+) s', result.warnings[0])
    assert len(named) == 3
    for take, at in named:
        pushes = recordings['push'][int(take)].pushed
        assert any(begin < float(at) < end + 0.1 for begin, end in pushes)
    assert error < 2


def test_a_residual_above_the_quantization_level_is_an_unmodelled_effect():
    takes = [trajectory(each) for each in record([0, 1, 2], [Rig(rub=0.2)] * 3, counts=16384)]
    found = identify(takes)
    assert not found.best.exact
    assert found.level is Level.WARN
    assert any('unmodelled effects' in warning for warning in found.warnings)
    assert (np.abs(found.best.theta[:5] - P1_TO_P5) < found.best.half_width[:5]).all()


ANOTHER = Parameters(P1=0.004, P2=0.0008, P3=0.0002, P4=0.04, P5=0.006, b1=0.0066, b2=0.0001)


def contradicted(*recordings, model='viscous', hold='zero'):
    """Return the messages about recordings that contradict each other."""
    return list(contradictions([Motion.prepare(each, 0.02, hold) for each in recordings], model, 0.0, Settings()))


def rough(*recordings):
    """Return the fit of the shortest interval."""
    data = TrainingData.prepare(recordings, Settings(model='viscous', hold='zero').of_rig(recordings))
    return fit_composite(data, lambda *_: None, effects=False).rough


@pytest.mark.parametrize('hold', ['zero', 'linear'])
def test_a_dead_zone_or_saturation_changes_the_torque_after_a_lag(hold):
    motion = Motion.prepare(recording(200), 0.02, hold)
    candidates = {(each.name, each.where): each for each in effects.catalogue([motion], 0.0)}
    late, t = candidates['lag', 'motor'].shape(motion, np.array([0.02])), np.linspace(0, 1.99, 500)
    dead = candidates['dead zone', 'motor'].shape
    np.testing.assert_allclose(dead(late, np.zeros(1)).impulse(t), late.impulse(t), rtol=0, atol=1e-12)
    assert np.abs(late.impulse(t) - motion.impulse(t)).max() > 1e-3
    # A recording with twice the largest torque of the training data does not reverse it.
    twice = motion.changed(Affine.of(T=2 * np.eye(2)))
    sagging = candidates['saturation', 'gradual'].shape(twice, np.array([0.9])).impulse.derivative()
    assert (sagging(motion.recorded.t[:-1]) * twice.recorded.tau[:-1] >= 0).all()


@pytest.fixture(scope='module')
def one_rig():
    return [recording(500, seed=seed, name=f'take {seed}') for seed in range(3)]


def test_recordings_of_one_rig_agree(one_rig):
    assert contradicted(*one_rig) == contradicted(*one_rig[:2]) == contradicted(one_rig[0]) == []
    assert list(disturbances(rough(*one_rig))) == []


@pytest.mark.parametrize('sign', [1, -1])
def test_the_recording_of_another_rig_is_reported_and_a_correction_that_is_not_sufficient_is_no_cause(one_rig, sign):
    other = recording(500, seed=1, rig=ANOTHER, name='another')
    (message,) = contradicted(one_rig[0], replace(other, q=other.q * [1, sign]), one_rig[2])
    assert message.startswith('another contradicts the other recordings')
    assert message.endswith('check that all recordings are of one rig, with the same signs and zeros')


@pytest.mark.parametrize(
    ('change', 'found'),
    [
        (lambda m: replace(m, q=m.q * [1, -1]), "the elbow's position has the wrong sign"),
        (lambda m: replace(m, q=m.q + np.array([np.pi / 2, 0])), "q1's zero is off by 90.0"),
        (lambda m: replace(m, q=m.q[:, ::-1], tau=m.tau[:, ::-1]), 'the joints are in the wrong order'),
        (lambda m: replace(m, tau=1000 * m.tau), 'link 2 would weigh'),
    ],
)
def test_the_fault_of_a_recording_that_contradicts_the_others_is_named(change, found, one_rig):
    (message,) = contradicted(one_rig[0], replace(change(one_rig[1]), name='wrong'), one_rig[2])
    assert message.startswith('wrong contradicts the other recordings')
    assert f'; in it, {found}' in message


def test_a_recording_that_is_too_short_for_a_test_of_its_correction_is_named_without_a_cause(one_rig):
    short = replace(one_rig[1][:70], name='short')
    (message,) = contradicted(one_rig[0], replace(short, q=short.q + np.radians([60.0, 0.0])), one_rig[2])
    assert message.startswith('short contradicts the other recordings')
    assert message.endswith('check that all recordings are of one rig, with the same signs and zeros')


@pytest.mark.recordings
@pytest.mark.parametrize(
    ('rig', 'change', 'found'),
    [
        (0, lambda m: replace(m, q=m.q * [1, -1]), "the elbow's position has the wrong sign"),
        (0, lambda m: replace(m, tau=-m.tau), 'the effort has the wrong sign'),
        (1, lambda m: replace(m, tau=-m.tau), 'the effort has the wrong sign'),
        (1, lambda m: replace(m, q=m.q + np.array([np.pi / 2, 0])), r"q1's zero is off by 90\.0 \+- \d degrees"),
    ],
)
def test_the_other_recordings_decide_which_fault_is_named(rig, change, found):
    """Alone, the recording of rig 0 fits with the effort negated, whichever of the two is wrong.

    After the faults of rig 1, no parameters fit the recording.
    """
    takes = real.recorded(real.RIGS[rig], 'train')
    (message,) = contradicted(*takes[:2], replace(change(takes[2]), name='wrong'), *takes[3:], model='rotor')
    assert message.startswith('wrong contradicts the other recordings')
    assert re.search(f'; in it, {found};', message)
    assert message.count('in it, ') == 1


@pytest.mark.recordings
def test_a_recording_among_recordings_of_another_real_rig_is_reported():
    rigs = [real.recorded(rig, 'train') for rig in real.RIGS]
    for one, other in product(rigs, rigs):
        messages = contradicted(*one[:3], *other[3:4], model='rotor', hold='linear')
        assert [text.split(' contradicts')[0] for text in messages] == ([] if one is other else [other[3].name])
