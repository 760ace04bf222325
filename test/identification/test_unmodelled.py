# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Unmodelled effects, disturbances and contradictions of recordings are reported once."""

import re
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from pendubot_identification.criteria.likelihood import SHARED
from pendubot_identification.identification.effects import find_effects
from pendubot_identification.identification.fitting import TrainingData, first_fit
from pendubot_identification.identification.pipeline import identify
from pendubot_identification.identification.selection import Fits, fit_composite
from pendubot_identification.identification.settings import Settings
from pendubot_identification.identification.validation import contradictions, disturbances
from pendubot_identification.level import Level
from pendubot_identification.model.parameters import Parameters, default_bounds
from pendubot_identification.trajectories.motion import Motion
from test import real
from test.simulated_rig import CATALOGUE, UNKNOWN, Rig, record, true
from test.virtual import recording, trajectory

RECORDINGS = 2
SATURATED, OFFSET, LAGGING = ('saturation', 2), ('offset', 0), ('lag', 2)
#: The rigs by name and strength, simulated at once.
RIGS = {None: Rig()} | {
    (name, strength): (CATALOGUE | UNKNOWN)[name][strength]
    for name, strength in (SATURATED, OFFSET, LAGGING, ('backlash', 2), ('push', 2))
}


@pytest.fixture(scope='module')
def recordings():
    """Return two recordings of 8 s of each rig."""
    batch = [rig for rig in RIGS.values() for _ in range(RECORDINGS)]
    seeds = [*range(RECORDINGS)] * len(RIGS)
    recordings = iter(record(seeds, batch, seconds=8.0, step=0.002, begin=10.0 * np.array(seeds)))
    return {name: [next(recordings) for _ in range(RECORDINGS)] for name in RIGS}


@pytest.fixture
def identified(recordings):
    """Return a function that returns the result of a rig's recordings and the largest error of P1 to P5 [%]."""

    def identified(name=None):
        result = identify([trajectory(each, f'take {k}') for k, each in enumerate(recordings[name])])
        return result, 100 * np.abs(result.best.theta[:5] / list(true(RIGS[name]).values())[:5] - 1).max()

    return identified


def test_an_ideal_rig_is_identified_exactly(identified):
    result, error = identified()
    assert (result.level, result.warnings, result.effects) == (Level.OK, (), ())
    assert result.best.exact
    assert error < 0.01


def test_an_effect_is_reported_and_compensated(identified):
    result, error = identified(SATURATED)
    assert [(effect.name, effect.where, effect.accepted) for effect in result.effects] == [
        ('saturation', 'motor', True)
    ]
    assert result.level is Level.WARN
    (warning,) = result.warnings
    assert 'compensated, P1 to P5 change by up to' in warning
    assert error < 0.05


def test_an_effect_with_a_size_on_its_bound_is_not_accepted(recordings):
    motions = [trajectory(each) for each in recordings[SATURATED]]
    data, quiet = TrainingData.prepare(motions, Settings().of_rig(motions)), lambda *_: None
    rough = first_fit(data, quiet)
    before = Fits.of(data, rough, quiet)
    found, with_it = next(find_effects(rough))
    after = Fits.of(data, with_it, quiet)
    assert after.surely_better(before, found)
    free = after.exact.free & (np.arange(len(after.exact.free)) != SHARED)
    assert not replace(after, exact=replace(after.exact, free=free)).surely_better(before, found)


@pytest.mark.parametrize(
    ('cell', 'beginning'), [(OFFSET, "the shoulder's effort is off by"), (LAGGING, 'the torque follows')]
)
def test_a_fault_that_is_also_an_effect_is_reported_once(identified, cell, beginning):
    result, error = identified(cell)
    (warning,) = result.warnings
    assert warning.startswith(beginning)
    assert result.level is Level.WARN
    assert error < 0.05


def test_an_effect_outside_the_catalogue_is_reported_by_its_fraction_of_the_innovation_variance(identified):
    result, error = identified(('backlash', 2))
    assert result.level is Level.WARN
    (warning,) = result.warnings
    assert warning.startswith('the rig has unmodelled effects: they make 9')
    assert (result.unmodelled > 0.8).all()
    assert error < 2


def test_pushes_by_hand_are_reported_as_disturbances(identified, recordings):
    result, error = identified(('push', 2))
    assert result.level is Level.WARN
    assert result.warnings[0].startswith('a disturbance: ')
    named = re.findall(r'take (\d) at ([\d.]+) s', result.warnings[0])
    assert len(named) == 3
    for take, at in named:
        pushes = recordings[('push', 2)][int(take)].pushed
        assert any(begin < float(at) < end + 0.1 for begin, end in pushes)
    assert error < 2


ANOTHER = Parameters(P1=0.004, P2=0.0008, P3=0.0002, P4=0.04, P5=0.006, b1=0.0066, b2=0.0001)


def contradicted(*recordings, model='viscous', hold='zero'):
    """Return the messages about recordings that contradict each other."""
    bounds = default_bounds().of({'viscous': 7, 'rotor': 10}[model])
    return list(contradictions([Motion.prepare(each, 0.02, hold) for each in recordings], model, 0.0, bounds))


def rough(*recordings):
    """Return the fit of the shortest interval."""
    data = TrainingData.prepare(recordings, Settings(model='viscous', hold='zero').of_rig(recordings))
    return fit_composite(data, lambda *_: None, effects=False).rough


@pytest.fixture(scope='module')
def one_rig():
    return [recording(500, seed=seed, name=f'take {seed}') for seed in range(3)]


def test_recordings_of_one_rig_agree(one_rig):
    assert contradicted(*one_rig) == contradicted(*one_rig[:2]) == contradicted(one_rig[0]) == []
    assert list(disturbances(rough(*one_rig))) == []


def test_the_recording_of_another_rig_is_reported(one_rig):
    (message,) = contradicted(one_rig[0], recording(500, seed=1, rig=ANOTHER, name='another'), one_rig[2])
    assert message.startswith('another contradicts the other recordings')


@pytest.mark.recordings
def test_a_recording_among_recordings_of_another_real_rig_is_reported():
    rigs = [real.recorded(rig, 'train') for rig in real.RIGS]
    for one, other in product(rigs, rigs):
        messages = contradicted(*one[:3], *other[3:4], model='rotor', hold='linear')
        assert [text.split(' contradicts')[0] for text in messages] == ([] if one is other else [other[3].name])
