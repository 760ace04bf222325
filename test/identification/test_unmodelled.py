# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Unmodelled effects of independently simulated rigs are reported once, and compensated if significant."""

import re

import numpy as np
import pytest

from pendubot_identification.identification.pipeline import identify
from pendubot_identification.level import Level
from pendubot_identification.trajectories.trajectory import Trajectory
from test.simulated_rig import CATALOGUE, UNKNOWN, Rig, record, true

RECORDINGS = 3
SATURATED, OFFSET, LAGGING = ('saturation', 2), ('offset', 0), ('lag', 2)
#: The rigs by name and strength, simulated at once.
RIGS = {None: Rig()} | {
    (name, strength): (CATALOGUE | UNKNOWN)[name][strength]
    for name, strength in (SATURATED, OFFSET, LAGGING, ('backlash', 2), ('push', 2))
}


@pytest.fixture(scope='module')
def recordings():
    """Return three recordings of 8 s of each rig."""
    batch = [rig for rig in RIGS.values() for _ in range(RECORDINGS)]
    seeds = [*range(RECORDINGS)] * len(RIGS)
    recordings = iter(record(seeds, batch, seconds=8.0, step=0.001, begin=10.0 * np.array(seeds)))
    return {name: [next(recordings) for _ in range(RECORDINGS)] for name in RIGS}


@pytest.fixture
def identified(recordings):
    """Return a function that returns the result of a rig's recordings and the largest error of P1 to P5 [%]."""

    def identified(name=None):
        motions = [
            Trajectory(r.t, r.q, np.column_stack([r.tau, 0 * r.tau]), name=f'take {k}')
            for k, r in enumerate(recordings[name])
        ]
        result = identify(motions)
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
