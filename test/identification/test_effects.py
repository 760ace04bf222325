# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Detection of unmodelled effects: the true effect of a simulated rig is accepted; an ideal rig has none."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

from pendubot_identification.criteria.likelihood import fit
from pendubot_identification.identification import effects
from pendubot_identification.identification.effects import catalogue, find_effects
from pendubot_identification.trajectories.motion import Motion
from test import simulated_rig as rig
from test.criteria.test_likelihood import likelihood
from test.simulated_rig import Rig
from test.virtual import trajectory

TRUE = np.append(list(rig.TRUE.values()), np.zeros(5))
RECORDINGS, SECONDS = 2, 8.0


@dataclass(frozen=True)
class Asymmetric(Rig):
    """A rig whose dry friction at the shoulder depends on the direction."""

    shoulder: float = 0.0  # [N m]


#: The rig of each effect, and the size of the effect by location; ``test_unmodelled.py`` has others.
EFFECTS = {
    'dead zone': (Rig(dead_zone=0.02), {'motor': 0.02}),
    'back-EMF': (Rig(no_load=12.0), {'motor': float(np.hypot(rig.STRENGTH, 1 / 12.0))}),
    'eccentricity': (Rig(eccentric=0.02), {"elbow's encoder": 0.02}),
    'offset': (Rig(offset=0.02), {'shoulder': 0.02}),
    'asymmetry': (Asymmetric(shoulder=0.004), {'shoulder': -0.004}),
    'drag': (Rig(drag=0.0003), {'shoulder': -0.0003, 'elbow': -0.0003}),
    'cogging': (Rig(cogging2=(0.008, 4)), {'elbow, 4 a turn': 0.008}),
}


@pytest.fixture(scope='module')
def recorded():
    """Return the recordings of each rig by the name of its effect; all rigs are simulated at once."""
    rigs = {'clean': Rig(), **{name: each for name, (each, _) in EFFECTS.items()}}
    batch = [each for each in rigs.values() for _ in range(RECORDINGS)]
    asymmetry = np.array([getattr(each, 'shoulder', 0.0) for each in batch])

    def friction(q, v, joint, e, usual=rig._friction):
        return usual(q, v, joint, e) + (asymmetry * abs(np.tanh(v / rig.WIDTH)) if joint == 0 else 0.0)

    seeds = [*range(RECORDINGS)] * len(rigs)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rig, '_friction', friction)
        recordings = iter(rig.record(seeds, batch, seconds=SECONDS, step=0.0025, begin=10.0 * np.array(seeds)))
    return {name: [next(recordings) for _ in range(RECORDINGS)] for name in rigs}


@pytest.fixture(scope='module')
def problem(recorded):
    """Return the fitted problem of a rig by the name of its effect."""

    @cache
    def solved(name):
        prepared = [Motion.prepare(trajectory(each), 0.05) for each in recorded[name]]
        return fit(*likelihood(prepared, 1.05 * TRUE, intervals=(0.05,)), 30, 0.1)

    return solved


@pytest.fixture(scope='module')
def detected(problem):
    """Return a cached function that detects the effects of a rig by the name of its effect."""
    return cache(lambda name: [found for found, _ in find_effects(problem(name))])


@pytest.mark.parametrize('name', EFFECTS)
def test_only_the_true_effect_of_a_rig_is_accepted(problem, detected, name):
    base, (_, sizes) = problem(name), EFFECTS[name]
    found = detected(name)
    assert {(f.name, f.where) for f in found} == {(name, where) for where in sizes}
    assert all(f.accepted for f in found)
    P = base.x[:5]
    for f in found:
        assert np.linalg.norm(f.sizes) == pytest.approx(abs(sizes[f.where]), rel=0.02)
        assert np.sign(f.sizes[0]) == np.sign(sizes[f.where])
        P = P * (1 + f.moved)
        assert f'({f.where}, ' in f.sentence
        assert ' compensated, P1 to P5 change by ' in f.sentence
    np.testing.assert_allclose(P, TRUE[:5], rtol=2e-3)


def test_an_effect_below_the_threshold_is_reported_as_possible_and_not_compensated(problem):
    base = problem('dead zone')
    ((found, _),) = find_effects(base, effects.EffectSettings(sure=np.inf))
    assert (found.name, found.accepted) == ('dead zone', False)
    assert found.sentence.startswith('possible, not compensated: the motor gives no torque below a threshold (motor)')
    motion = base.likelihood.filter_data.motions[0]
    assert effects.compensated(motion, [found], 0.0) is motion
    assert list(find_effects(base, effects.EffectSettings(sure=np.inf, tried=np.inf))) == []


def test_the_model_is_nested_in_each_candidate(problem):
    """Blind candidates, which the slope of the likelihood at zero does not detect, start at another size."""
    base = problem('clean')
    cost = base.likelihood.costs(base.x)
    candidates = catalogue(base.likelihood.filter_data.motions, 0.0)
    assert {c.name for c in candidates} == set(effects.MEANINGS)
    for c in candidates:
        like, x = base.likelihood.extended([c], base.x)
        assert len(x) == len(base.x) + len(c.unknowns)
        assert ((like.lower <= x) & (x <= like.upper)).all()
        if not c.blind:
            np.testing.assert_allclose(like.costs(x), cost, rtol=1e-7, atol=1e-6)


def test_cogging_is_a_candidate_only_for_joints_that_turn(problem):
    base = problem('clean')
    both = [c.where for c in catalogue(base.likelihood.filter_data.motions, 0.0) if c.name == 'cogging']
    assert len(both) == 2 * (effects.REPETITIONS - 1)
    still = [
        replace(m, recorded=replace(m.recorded, q=m.recorded.q * [0.01, 1.0]))
        for m in base.likelihood.filter_data.motions
    ]
    alone = [c.where for c in catalogue(still, 0.0) if c.name == 'cogging']
    assert alone == [where for where in both if where.startswith('elbow')]


def test_compensated_torques_equal_the_acting_torques(problem, detected):
    """A dead zone changes the recorded torque; drag adds a torque that depends on the smoothed speed."""
    for name in ('dead zone', 'drag'):
        motion = problem(name).likelihood.filter_data.motions[0]
        found = detected(name)
        t = np.arange(0.5, 7.0, 0.005)
        acting = np.diff(effects.compensated(motion, found, 0.0).impulse(t), axis=0) / 0.005
        recorded = np.diff(motion.impulse(t), axis=0) / 0.005
        if name == 'dead zone':
            expected = np.sign(recorded) * np.maximum(abs(recorded) - 0.02, 0)
        else:
            v = motion.states((t[1:] + t[:-1]) / 2)[2:].T
            expected = recorded - 0.0003 * v * abs(v)
        np.testing.assert_allclose(acting, expected, atol=0.02 * abs(acting - recorded).max())
