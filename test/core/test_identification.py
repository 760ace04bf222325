"""The whole identification on motions of the virtual rig, and what it says of poor ones."""

import csv

import numpy as np
import pytest

from pendubot_identification.core.errors import ExcitationError, ParameterError, TrajectoryError
from pendubot_identification.core.excitation import PulseTrain
from pendubot_identification.core.identification import identify
from pendubot_identification.core.level import Level
from pendubot_identification.core.mde import MDESettings
from pendubot_identification.core.parameters import PAPER, default_bounds
from pendubot_identification.core.settings import Settings
from pendubot_identification.core.simulation import HANGING, quantised, simulate
from pendubot_identification.core.trajectory import Trajectory
from test.conftest import RECORDINGS

LSQ = Settings(optimizer='lsq')


def recording(n=900, interval=0.01, seed=1, counts=4000, torque=None):
    t = np.arange(n) * interval
    shoulder = [PulseTrain(seed=seed).torque(x) for x in t] if torque is None else torque(t)
    motion = simulate(PAPER, t, np.column_stack([shoulder, np.zeros(n)]))
    return quantised(motion, counts) if counts else motion


def recorded(group, role):
    """The motions of a rig's real recordings, straight from their CSV files."""
    motions = []
    for row in csv.DictReader((RECORDINGS / 'manifest.csv').open()):
        if row['group'] == group and row['role'] == role:
            a = np.genfromtxt(RECORDINGS / row['file'], delimiter=',', names=True)
            q, tau = (np.column_stack([a[f'{name}1'], a[f'{name}2']]) for name in ('q', 'tau'))
            motions.append(Trajectory(a['t'], q, tau, name=row['file']))
    return motions


def test_mde_reaches_the_exact_minimum_in_every_run():
    result = identify([recording()], [recording(seed=2)])
    assert result.runs_at_minimum == 10
    np.testing.assert_allclose(result.J, result.J_exact, rtol=1e-6)
    np.testing.assert_allclose(result.parameters.vector(), result.exact.vector(), rtol=1e-3)
    assert result.validation.J_runs.shape == (10,)
    assert not result.parameters.unphysical()


@pytest.mark.recordings
@pytest.mark.parametrize('group', ['dfki_C1_sysid', 'dfki_A0_sysid'])
def test_mde_reaches_the_exact_minimum_on_pooled_real_recordings(group):
    result = identify(recorded(group, 'train'), recorded(group, 'test'))
    assert result.runs_at_minimum == 10
    assert result.level >= Level.WARN, 'the energy criterion does not foresee these rigs, and must say so'
    assert result.warnings


def test_fine_sampling_leads_to_the_truth():
    result = identify([recording(9000, 0.001, counts=0, torque=lambda t: 0.15 * np.sin(4 * t))], settings=LSQ)
    np.testing.assert_allclose(result.parameters.vector(), PAPER.vector(), rtol=0.03)
    assert result.level is not Level.ERROR


def test_a_runs_result_is_the_same_alone_and_among_others():
    motion = recording()
    few, many = (identify([motion], settings=Settings(mde=MDESettings(generations=50), runs=n)) for n in (2, 5))
    np.testing.assert_array_equal(few.runs.x, many.runs.x[:2])


def test_several_recordings_without_validation_are_foreseen_from_each_other():
    motions = [recording(seed=s) for s in (1, 2, 3)]
    result = identify(motions, settings=LSQ)
    assert result.validation.method == 'each recording foreseen from the others'
    alone = [identify([m for m in motions if m is not left], [left], LSQ).validation.J for left in motions]
    np.testing.assert_allclose(result.validation.J, np.mean(alone), rtol=1e-9)


def test_standard_errors_are_as_large_as_the_spread_over_recordings():
    """Of the criterion's own minimum, that is: its bias is another matter."""
    results = [identify([recording(seed=s)], settings=LSQ) for s in range(24)]
    theta = np.array([r.parameters.vector() for r in results])
    spread = 1.4826 * np.median(abs(theta - np.median(theta, axis=0)), axis=0)
    typical = np.nanmedian([r.std_error for r in results], axis=0)
    assert (typical > spread / 4).all()
    assert (typical < spread * 4).all()


def test_a_rig_at_rest_is_refused():
    with pytest.raises(ExcitationError, match='moved by only 0 and 0 rad, so none of P1'):
        identify([recording(torque=np.zeros_like)])


def test_a_still_elbow_is_refused_with_what_cannot_be_told():
    motion = recording()
    q = np.column_stack([motion.q[:, 0], np.full(len(motion), HANGING[1])])
    with pytest.raises(ExcitationError, match=r'P1, P2, P3.* cannot be told apart.*elbow moved by only 0 rad'):
        identify([Trajectory(motion.t, q, motion.tau, name='held elbow')])


def test_an_unphysical_result_is_an_error_and_says_why():
    motion = recording()
    reversed_torque = Trajectory(motion.t, motion.q, -motion.tau, name='wrong sign')
    result = identify([reversed_torque], settings=LSQ)
    assert result.level is Level.ERROR
    assert any(w.startswith('not physical') for w in result.warnings)


def test_a_parameter_on_its_bound_is_named_and_has_no_standard_error():
    bounds = default_bounds().replaced('b1', 0.0, 0.001)
    result = identify([recording()], settings=Settings(optimizer='lsq', bounds=bounds))
    assert any(w.startswith('b1 lies on its bound 0.001') for w in result.warnings)
    assert np.isnan(result.std_error[5])
    assert np.isfinite(result.std_error[:5]).all()
    assert result.level is Level.WARN


def test_too_few_generations_are_noticed():
    result = identify([recording()], settings=Settings(mde=MDESettings(generations=20)))
    assert any('of 10 runs reached the exact minimum' in w for w in result.warnings)


def test_notes_on_the_data_become_warnings():
    result = identify([recording()], settings=LSQ, notes=['the bag was never closed'])
    assert 'the bag was never closed' in result.warnings
    assert result.level is Level.WARN


def test_too_short_a_recording_is_refused():
    with pytest.raises(TrajectoryError, match='too few'):
        identify([recording(30)])


@pytest.mark.parametrize(
    ('changes', 'sentence'),
    [
        ({'criterion': 'magic'}, "no criterion 'magic'; choose one of energy"),
        ({'optimizer': 'luck'}, 'no optimizer'),
        ({'model': 'air'}, 'no model'),
        ({'sliding': -1.0}, 'sliding window is -1 s'),
        ({'smoothing': float('nan')}, 'smoothing window is nan s'),
    ],
)
def test_settings_without_sense_are_refused(changes, sentence):
    with pytest.raises(ParameterError, match=sentence):
        Settings(**changes)
