# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What the model lacks is named, compensated where it is sure, and said once; on a rig with equations of its own."""

import numpy as np
import pytest

from pendubot_identification.identify.pipeline import identify
from pendubot_identification.level import Level
from pendubot_identification.trajectories.trajectory import Trajectory
from test.simulated_rig import CATALOGUE, UNKNOWN, Rig, record, true

COGGING = 'cogging, shoulder, 7 a turn'


def found(rig):
    """Return what three recordings of 10 s say, and the errors of P1 to P5 [%]."""
    made = record(range(3), [rig] * 3, begin=np.array([0.0, 10.0, 20.0]))
    motions = [Trajectory(r.t, r.q, np.column_stack([r.tau, 0 * r.tau]), name=f'take {k}') for k, r in enumerate(made)]
    result = identify(motions)
    return result, 100 * np.abs(result.best.theta[:5] / list(true(rig).values())[:5] - 1).max()


def test_a_clean_rig_is_exact():
    result, error = found(Rig())
    assert (result.level, result.warnings, result.effects) == (Level.OK, (), ())
    assert result.best.exact
    assert error < 0.01


@pytest.mark.parametrize(
    ('cell', 'name', 'where'),
    [(('saturation', 2), 'saturation', 'motor'), ((COGGING, 0), 'cogging', 'shoulder, 7 a turn')],
)
def test_an_effect_is_named_and_compensated(cell, name, where):
    result, error = found(CATALOGUE[cell[0]][cell[1]])
    assert [(effect.name, effect.where, effect.accepted) for effect in result.effects] == [(name, where, True)]
    assert result.level is Level.WARN
    assert ['compensated, P1 to P5 change by up to' in warning for warning in result.warnings] == [True]
    assert error < 0.05


@pytest.mark.parametrize(
    ('cell', 'beginning'), [(('offset', 0), "the shoulder's effort is off by"), (('lag', 2), 'the torque follows')]
)
def test_what_is_a_fault_and_an_effect_is_said_once(cell, beginning):
    result, error = found(CATALOGUE[cell[0]][cell[1]])
    (said,) = result.warnings
    assert said.startswith(beginning)
    assert result.level is Level.WARN
    assert error < 0.05


def test_what_no_catalogue_has_is_said_as_a_fraction_of_the_innovations():
    result, error = found(UNKNOWN['backlash'][2])
    assert result.level is Level.WARN
    (said,) = result.warnings
    assert said.startswith('the rig has unmodelled effects: they make 9')
    assert (result.unmodelled > 0.8).all()
    assert error < 2


def test_pushes_by_hand_are_disturbances():
    result, error = found(UNKNOWN['push'][2])
    assert result.level is Level.WARN
    assert result.warnings[0].startswith('a disturbance: take 0 at 3.4 s, ')
    assert error < 1
