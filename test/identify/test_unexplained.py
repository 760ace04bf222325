# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What the models lack is named, and nothing else: on a simulated rig that has it, of equations of its own."""

import re

import numpy as np
import pytest

from pendubot_identification.identify.diagnosis import diagnose
from pendubot_identification.identify.identification import identify
from pendubot_identification.identify.recipes import Data
from pendubot_identification.identify.settings import Settings
from pendubot_identification.identify.unexplained import unexplained
from pendubot_identification.level import Level
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.trajectory import Trajectory
from test.effects.rig import EFFECTS, TRUE, Effects, accelerations, record, true

#: Effects, which strength, and as what they are named.
NAMED = {
    ('saturation', 0): 'saturation',
    ('saturation', 1): 'saturation',
    ('sag', 0): 'saturation',
    ('offset', 0): 'offset',
    ('drag', 0): 'drag',
    ('cogging', 0): 'cogging',
    ('spring', 1): 'spring',
    ('asymmetry', 0): 'asymmetry',
    ('drift', 0): 'drift',
    ('shaft', 0): 'shaft',
    ('eccentric', 0): 'eccentric',
}
UNNAMED = (('nothing', 0), ('tilt', 1), ('width', 0), ('push', 1), ('stop', 0))
#: What only simulated segments show, as what it is named, and within which error [%] P1 to P5 then are.
SUBTLE = {('lag', 0): ('lag', 0.01), ('lag', 1): ('lag', 0.02), ('stribeck', 0): ('friction', 0.02)}
SMOOTHING, RECORDINGS = 0.04, 3


@pytest.fixture(scope='module')
def recorded():
    """Three recordings of 10 s at 200 Hz and 4096 counts a turn for each."""
    lanes = [(*cell, k) for cell in (*NAMED, *UNNAMED, *SUBTLE) for k in range(RECORDINGS)]
    made = record(
        [k for *_, k in lanes],
        [EFFECTS[effect][strength] for effect, strength, _ in lanes],
        begin=np.array([10.0 * k for *_, k in lanes]),
    )
    return {cell: made[n * RECORDINGS : (n + 1) * RECORDINGS] for n, cell in enumerate((*NAMED, *UNNAMED, *SUBTLE))}


def trajectories(recordings):
    return [Trajectory(r.t, r.q, np.column_stack([r.tau, 0 * r.tau]), name=str(k)) for k, r in enumerate(recordings)]


def found(recordings, only=slice(None)):
    motions = [Motion.prepare(t, SMOOTHING, 'zero') for t in trajectories(recordings)[only]]
    return unexplained(motions, SMOOTHING, 'zero', 0.0)


def test_the_simulated_rig_without_effects_is_the_model():
    from pendubot_identification.model.dynamics import accelerations as of_package

    q1, q2, v1, v2, tau = np.random.default_rng(1).normal(size=(5, 100)) * [[2.0], [2.0], [5.0], [5.0], [0.3]]
    theta = [TRUE['P1'], TRUE['P2'], TRUE['P3'], TRUE['P4'], TRUE['P5'], 0.0, 0.0]
    np.testing.assert_allclose(
        accelerations(q1, q2, v1, v2, tau, 0.0), of_package(theta, q1, q2, v1, v2, tau, 0.0), rtol=1e-10
    )


@pytest.mark.parametrize('cell', NAMED, ids=lambda cell: f'{cell[0]} {cell[1]}')
def test_an_effect_is_named(recorded, cell):
    result = found(recorded[cell])
    assert result.effects[0].effect.name == NAMED[cell]
    assert result.effects[0].share > 0.3
    assert (result.share > 1.2 * result.noise).any()


def test_cogging_and_saturation_are_named_with_their_numbers(recorded):
    assert found(recorded['cogging', 0]).effects[0].effect.where == 'shoulder, 7 a turn'
    said = found(recorded['saturation', 1]).effects[0]
    assert float(said.effect.where.split()[2]) == pytest.approx(0.22, abs=0.03)
    assert np.abs(said.moved).max() > 0.1


@pytest.mark.parametrize('cell', UNNAMED, ids=lambda cell: f'{cell[0]} {cell[1]}')
def test_what_does_no_harm_is_not_named_and_the_rest_is_the_encoders_rounding(recorded, cell):
    result = found(recorded[cell])
    assert not result.effects
    np.testing.assert_allclose(result.share, result.noise, rtol=0.2)
    assert bool(result.bursts) == (cell[0] in ('push', 'stop'))


def test_every_push_is_a_burst_and_nothing_else_is(recorded):
    bursts = found(recorded['push', 1]).bursts
    pushes = [(str(k), *push) for k, r in enumerate(recorded['push', 1]) for push in r.pushed]
    overlapping = lambda burst, push: burst.recording == push[0] and burst.begin < push[2] and push[1] < burst.end  # noqa: E731
    assert all(any(overlapping(burst, push) for burst in bursts) for push in pushes)
    assert all(any(overlapping(burst, push) for push in pushes) for burst in bursts)


def test_the_parts_of_a_recording_between_pushes_are_still_one_recording(recorded):
    data = Data.prepare(trajectories(recorded['push', 1]), Settings())
    rest = data.without(found(recorded['push', 1]).bursts)
    assert len(rest.motions) > len(rest.groups) == len(rest.whole) == RECORDINGS
    names = [rest.whole[number].name for number in rest.recordings]
    assert all(part.name.startswith(name) for part, name in zip(rest.motions, names, strict=True))


@pytest.mark.parametrize(
    'cell', [('saturation', 1), ('cogging', 0), ('spring', 1), ('push', 1)], ids=lambda cell: f'{cell[0]} {cell[1]}'
)
def test_parameters_allow_for_what_was_found_and_the_level_says_so(recorded, cell):
    result = identify(trajectories(recorded[cell]), settings=Settings(('weak',), 'coulomb', optimizer='lsq'))
    assert result.level == Level.WARN
    worst = max(
        abs(result.best.theta[k] / value - 1)
        for k, value in enumerate(list(true(EFFECTS[cell[0]][cell[1]]).values())[:5])
    )
    assert worst < 0.035
    if cell[0] == 'push':
        assert 'torques from nowhere, left out: 0 at' in result.warnings[0]
    else:
        assert '% of the unexplained torque' in ' '.join(result.warnings)


@pytest.mark.parametrize(
    'cell', [('nothing', 0), ('saturation', 1), ('spring', 1)], ids=lambda cell: f'{cell[0]} {cell[1]}'
)
def test_by_energy_alone_effects_are_named_and_not_allowed_for(recorded, cell):
    result = identify(trajectories(recorded[cell]), settings=Settings(('energy',), 'coulomb', optimizer='lsq'))
    assert [found.effect.name for found in result.unexplained.effects] == ([] if cell[0] == 'nothing' else [cell[0]])
    assert (result.level == Level.WARN) == (cell[0] != 'nothing')
    assert all('and may change P1 to P5 by' in warning for warning in result.warnings)


@pytest.mark.parametrize('rig', [Effects(spring=0.2), Effects(stop=2.0)], ids=['spring', 'stop'])
def test_what_is_so_large_that_no_pendubot_moves_so_is_allowed_for_or_left_out(rig):
    recordings = trajectories(record(range(900, 900 + RECORDINGS), [rig] * RECORDINGS))
    motions = Data.prepare(recordings, Settings()).motions
    assert [fault.name for fault in diagnose(motions, SMOOTHING, 'zero', 'rotor')] == ['motion']
    result = identify(recordings, settings=Settings(('weak',), 'coulomb', optimizer='lsq'))
    assert (result.level, result.faults) == (Level.WARN, ())
    assert bool(result.unexplained.bursts) == (rig.spring == 0)
    assert [found.effect.name for found in result.unexplained.effects] == ['spring'] * (rig.spring > 0)
    np.testing.assert_allclose(result.best.theta[:5], list(TRUE.values())[:5], rtol=0.01)


def test_errors_that_last_are_said_though_no_effect_explains_them():
    recordings = trajectories(record(range(600, 600 + RECORDINGS), [EFFECTS['backlash'][1]] * RECORDINGS))
    result = identify(recordings, settings=Settings(('trajectory',), optimizer='lsq'))
    assert result.unexplained.effects == ()
    assert result.level == Level.WARN
    (said,) = result.warnings
    assert re.match(
        r'simulated segments are off by 5\.\d times what rounded angles explain: the rig has what the', said
    )


def test_one_recording_alone_is_left_out_by_blocks_of_time(recorded):
    assert found(recorded['cogging', 0], slice(1)).effects[0].effect.name == 'cogging'
    assert not found(recorded['nothing', 0], slice(1)).effects


@pytest.mark.parametrize('cell', SUBTLE, ids=lambda cell: f'{cell[0]} {cell[1]}')
def test_simulated_segments_show_what_differentiated_angles_hide(recorded, cell):
    result = identify(trajectories(recorded[cell]), settings=Settings(('trajectory',), optimizer='lsq'))
    name, most = SUBTLE[cell]
    assert result.unexplained.effects[0].effect.name == name
    assert result.level == Level.WARN
    assert 'of the errors of simulated segments' in ' '.join(result.warnings)
    best, truth = result.best, list(true(EFFECTS[cell[0]][cell[1]]).values())[:5]
    assert 100 * np.abs(best.theta[:5] / truth - 1).max() < most
    assert best.resized.size == 1, 'its size is estimated along'


def test_a_steady_torque_is_a_fault_that_is_estimated_along(recorded):
    result = identify(trajectories(recorded['offset', 0]), settings=Settings(('trajectory',), optimizer='lsq'))
    assert [fault.name for fault in result.faults] == ['offset']
    assert result.level == Level.WARN
    assert len(result.warnings) == 1, 'said once'
    assert 100 * np.abs(result.best.theta[:5] / list(TRUE.values())[:5] - 1).max() < 0.01


def test_a_clean_rig_is_as_exact_as_ever(recorded):
    result = identify(trajectories(recorded['nothing', 0]), settings=Settings(('trajectory',), optimizer='lsq'))
    assert (result.level, result.warnings) == (Level.OK, ())
    assert result.best.exact
    assert 100 * np.abs(result.best.theta[:5] / list(TRUE.values())[:5] - 1).max() < 0.004
