# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The Python interface, as imported from the package by scripts and notebooks."""

import ast
import inspect
import runpy
import sys
from dataclasses import replace
from datetime import datetime, timezone
from typing import Literal, get_args, get_origin, get_type_hints
from xml.etree import ElementTree

import matplotlib.figure
import numpy as np
import pytest

import pendubot_identification
from pendubot_identification import (
    HANGING,
    Identified,
    Level,
    Pendubot,
    PendubotError,
    Trajectory,
    api,
    check,
    compare,
    describe,
    identify,
    read,
    simulate,
)
from pendubot_identification.control.linear_control import linearise
from pendubot_identification.formats.export import export
from pendubot_identification.identification import OPTIONS
from pendubot_identification.model.dynamics import energy
from pendubot_identification.model.parameters import BALANCE
from pendubot_identification.trajectories.conventions import CONVERSION, JOINTS
from test.conftest import ROOT, SAMPLE
from test.recordings.bags import csv

FAST = {'criterion': 'weak', 'model': 'viscous', 'hold': 'zero'}
RIG = Pendubot.from_vector(BALANCE.vector())
TIMES = [0, 0.1, 0.2]


@pytest.fixture(scope='module')
def found():
    return identify(SAMPLE, **FAST)


def test_names_are_the_same_at_run_time_and_for_type_checkers():
    stub = ast.parse((ROOT / 'pendubot_identification' / '__init__.pyi').read_text())
    listed = {alias.asname for node in stub.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert listed == {*pendubot_identification.__all__} <= {*dir(pendubot_identification)}
    for name in listed:
        assert getattr(pendubot_identification, name) is getattr(api, name)
    with pytest.raises(AttributeError, match='no attribute'):
        pendubot_identification.nonsense  # noqa: B018


def test_bags_motions_arrays_and_frames_give_the_same_parameters(found):
    pandas, stages = pytest.importorskip('pandas'), set()
    motion = read(SAMPLE)
    degrees, milli = np.degrees(motion.q - HANGING), motion.tau[:, 0] * 1000
    units = {'degrees': True, 'zero': 'hanging', 'torque_unit': 'mNm'}
    frame = pandas.DataFrame({'t': motion.t, 'theta1': degrees[:, 0], 'q2': degrees[:, 1], 'tau1': milli})
    columns = {'q1': 'theta1'}
    dates = np.datetime64('2026-11-26') + np.rint(1e9 * motion.t).astype('timedelta64[ns]')
    np.testing.assert_allclose(read(frame, columns=columns, **units).q, motion.q, atol=1e-12)
    for again in (
        identify(motion, **FAST, progress=lambda stage, done, of, best: stages.add(stage)),
        identify(t=dates, q=degrees.tolist(), tau=milli.tolist(), time_unit='ns', **units, **FAST),
        identify(frame.set_index('t'), columns=columns, **units, **FAST),
        identify(frame.set_index('t').rename_axis(None), columns=columns, **units, **FAST),
        identify(motion[:900], validate=motion[900:], **FAST),
    ):
        np.testing.assert_allclose(again.theta, found.theta, rtol=1e-9)
        assert [source.role for source in again.result.bags] == ['training', 'validation']
    assert {'preparing', 'checking signs, zeros and stamps'} <= stages
    microseconds = [datetime.fromtimestamp(x, timezone.utc) for x in motion.t]
    again = identify(t=microseconds, q=motion.q, tau=motion.tau, **FAST)
    np.testing.assert_allclose(again.theta, found.theta, rtol=1e-4)
    part = read(f'{SAMPLE}@0:9')
    assert 9 - part.interval <= part.duration + 1e-9 < 9.0


def test_results_are_arrays_and_can_be_saved_and_loaded(found, tmp_path):
    assert found.names == ('P1', 'P2', 'P3', 'P4', 'P5', 'b1', 'b2')
    low, high = found.intervals.T
    assert ((low < found.theta) & (found.theta < high)).all()
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), found.std_error)
    assert (found.level, found.warnings) == (Level.OK, [])
    found.save(tmp_path / 'rig.yaml')
    again = Identified.load(tmp_path / 'rig.yaml')
    np.testing.assert_array_equal(again.theta, found.theta)
    assert again.pendubot == Pendubot.load(tmp_path / 'rig.yaml') == found.pendubot
    with pytest.raises(PendubotError, match='exists already'):
        found.save(tmp_path / 'rig.yaml')


def test_a_notebook_shows_level_and_tables(found):
    doubtful = replace(found, result=replace(found.result, level=Level.WARN, warnings=['P1 < P2 & so on']))
    shown = ElementTree.fromstring(f'<div>{doubtful._repr_html_()}</div>')
    assert shown.find('p').text == 'WARN: P1 < P2 & so on'
    rows = list(shown.find('table').iter('tr'))
    assert [row[0].text for row in rows[1:3]] == ['P1 [kg m²]', 'P2 [kg m²]']
    assert 'the 95 % intervals hold, given the torque scale' in found._repr_html_()
    assert 'P1=0.0022' in repr(found)


def test_a_frame_has_a_row_for_each_parameter(found, monkeypatch):
    pytest.importorskip('pandas')
    frame = found.frame()
    assert tuple(frame.index) == found.names
    np.testing.assert_array_equal(frame['value'], found.theta)
    np.testing.assert_array_equal(frame[['low', 'high']], found.intervals)
    assert frame.loc['b2', 'meaning'] == 'viscous friction of the elbow'
    monkeypatch.setitem(sys.modules, 'pandas', None)
    with pytest.raises(PendubotError, match='pip install pandas'):
        found.frame()


def test_the_terms_of_the_equations_of_motion_are_consistent():
    """M a = tau - bias - friction, arrays are broadcast, and only the shoulder has a motor."""
    q, qd, tau = np.array([0.3, -1.2]), np.array([2.0, -1.0]), np.array([0.2, 0.1])
    friction = np.array([RIG.b1, RIG.b2]) * qd
    inertial = RIG.mass_matrix(q) @ RIG.acceleration(q, qd, tau)
    np.testing.assert_allclose(inertial, tau - RIG.bias(q, qd) - friction, rtol=1e-12)
    many = np.array([[[0.3, -1.2], [0.1, 0.2], [1.0, 2.0]]])
    expected = [[RIG.mass_matrix(one) for one in many[0]]]
    np.testing.assert_array_equal(RIG.mass_matrix(many), expected)
    np.testing.assert_allclose(RIG.bias(many, qd)[0, 1], RIG.bias(many[0, 1], qd), rtol=1e-12)
    for a, b in ((many, qd), (q, many)):
        pairs = zip(*(np.broadcast_to(each, many.shape)[0] for each in (a, b)), strict=True)
        np.testing.assert_allclose(RIG.energy(a, b), [[RIG.energy(*pair) for pair in pairs]], rtol=1e-12)
    assert RIG.energy(q, qd) == pytest.approx(energy(RIG.vector(), q, qd), rel=1e-12)
    A, B = RIG.linearised()
    np.testing.assert_array_equal(np.hstack([A, B]), np.hstack(linearise(RIG))[:, :5])


def test_a_torque_may_be_constant_for_the_shoulder_or_for_both_joints():
    t = np.arange(100) * 0.01
    expected = simulate(RIG, t, np.column_stack([np.full(100, 0.3), np.zeros(100)]))
    for tau in (0.3, np.full(100, 0.3)):
        motion = simulate(RIG, t, tau, HANGING)
        assert isinstance(motion, Trajectory)
        np.testing.assert_array_equal(motion.q, expected.q)
    durations = np.rint(1000 * t).astype('timedelta64[ms]')
    np.testing.assert_allclose(simulate(RIG, durations, 0.3).q, expected.q)


def test_masked_samples_are_missing():
    motion = read(f'{SAMPLE}@0:9')
    q = np.ma.array(motion.q)
    q[30, 1] = np.ma.masked
    for t in (motion.t, np.ma.array((1e9 * motion.t).astype('datetime64[ns]'))):
        with pytest.raises(PendubotError, match=r'1 of \d+ samples .* at 0\.\d+ s; .* add --skip-missing'):
            identify(t=t, q=q, tau=motion.tau, **FAST)


def test_a_missing_date_is_a_missing_sample():
    pandas, motion = pytest.importorskip('pandas'), read(f'{SAMPLE}@0:9')
    dates = np.datetime64('2026-11-26') + np.rint(1e9 * motion.t).astype('timedelta64[ns]')
    dates[0] = np.datetime64('NaT')
    frame = pandas.DataFrame({'t': dates, 'q1': motion.q[:, 0], 'q2': motion.q[:, 1], 'tau1': motion.tau[:, 0]})
    np.testing.assert_array_equal(read(frame, skip_missing=True).q, motion.q[1:])
    with pytest.raises(PendubotError, match=r"sample 1, column 't': 'NaT' is no finite number, as of 1 of \d+ rows"):
        read(frame)


def test_a_suffix_selects_the_format_of_an_export(found, tmp_path):
    path = found.export(tmp_path / 'rig.urdf', link_length=0.03, torque_limit=1.0, revolute=True)
    assert path.read_text() == export(found.result, 'urdf', 0.03, 1.0, revolute=True)[0]
    assert 'mujoco' in RIG.export(str(tmp_path / 'rig.xml')).read_text()
    numbers = runpy.run_path(str(RIG.export(tmp_path / 'rig.py')))['THETA']
    assert repr(numbers) == repr(tuple(RIG.theta.tolist()))
    with pytest.raises(PendubotError, match=r'rig.urdf exists already .* overwrite=True'):
        found.export(path)
    with pytest.raises(PendubotError, match=r'rig.usd has no suffix that names a format; .urdf, '):
        RIG.export('rig.usd')


def test_corrections_are_applied_to_recordings_in_memory(found):
    motion = read(SAMPLE)
    again = identify(replace(motion, q=motion.q * [1, -1]), apply_remedies=True, **FAST)
    np.testing.assert_allclose(again.theta, found.theta, rtol=1e-9)
    assert any('applied corrections of the recordings: --negate q2' in warning for warning in again.warnings)


def test_a_result_of_arrays_is_reported_and_plotted_from_memory(tmp_path):
    motion = read(f'{SAMPLE}@0:9')
    found = identify(t=motion.t, q=motion.q, tau=motion.tau, **FAST)
    assert 'Measured against simulated motion' in found.report(tmp_path / 'look').read_text()
    q1, q2 = matplotlib.figure.Figure().subplots(2)
    assert found.plot(axes=[q1, q2]) == [q1, q2]
    (t, measured), recorded = q1.get_lines()[0].get_data(), found.motions[1][0]
    assert recorded.t[0] - 1e-5 <= t[0] < t[-1] <= recorded.t[-1]
    np.testing.assert_allclose(measured, np.interp(t, recorded.t, recorded.q[:, 0]), atol=0.02)
    (axis,) = found.plot('torque', axes=q1)
    assert axis is q1
    grid = matplotlib.figure.Figure().subplots(2, 2)
    assert found.plot(axes=grid) == [*grid.flat]
    with pytest.raises(PendubotError, match="no plot 'torques'"):
        found.plot('torques')
    with pytest.raises(PendubotError, match='no axes were given'):
        found.plot(axes=[])
    found.save(tmp_path / 'rig.yaml')
    with pytest.raises(FileNotFoundError, match='were in memory'):
        Identified.load(tmp_path / 'rig.yaml').plot()


def test_results_are_compared_in_a_frame(found):
    pytest.importorskip('pandas')
    other = identify(SAMPLE, **FAST | {'model': 'coulomb'}, smoothing=0.05)
    assert (other.result.smoothing, other.result.model) == (0.05, 'coulomb')
    frame = compare({'first': found, 'other': other})
    np.testing.assert_array_equal(frame['other', 'value'], other.theta)
    apart = frame['other', 'value'] - frame['first', 'value']
    error = np.hypot(frame['first', 'std_error'], frame['other', 'std_error'])
    np.testing.assert_allclose(frame['other', 't'], apart / error, rtol=1e-9)
    elsewhere = replace(other.result, bags=[replace(bag, bag='run@3.csv') for bag in other.result.bags])
    (note,) = compare({'first': found, 'other': Identified(elsewhere)}).attrs['notes']
    assert 'first and other were estimated from the same motion' in note


def choices_of(hint):
    """Return the texts that a type allows."""
    parts = get_args(hint)
    return {*parts} if get_origin(hint) is Literal else set().union(*map(choices_of, parts))


@pytest.mark.parametrize(('function', 'options'), [(identify, (*OPTIONS, *CONVERSION)), (read, CONVERSION)])
def test_a_signature_has_every_option_with_its_default_and_choices(function, options):
    shown = inspect.signature(function).parameters
    hints = get_type_hints(getattr(api, function.__name__.rpartition('.')[2]), localns={'DataFrame': object})
    for option in options:
        if option is JOINTS:
            continue  # joint_names, a sequence
        default = shown[option.name].default
        assert default in (None, (), 'likelihood') if option.optional else default == option.default
        assert choices_of(hints[option.name]) >= {*option.choices}


def test_checks_name_the_options_that_correct_a_recording(tmp_path):
    motion = read(SAMPLE)
    q = motion.q - HANGING
    file = tmp_path / 'run.csv'
    file.write_text(csv(replace(motion, q=q), names=('Zeit', 'a', 'b', 'tau1')))
    found = describe(file)
    assert found.columns == ['Zeit', 'a', 'b', 'tau1']
    assert found.taken == {'t': 'Zeit', 'tau1': 'tau1'}
    assert found.motion is None
    assert "has no column 'q1' for q1" in str(found.problem)
    named = {'columns': 'q1=a,q2=b'}
    np.testing.assert_allclose(describe(file, **named).motion.q, q, atol=1e-11)
    (wrong,) = (each for each in check(file, **named) if each.level > Level.OK)
    assert (wrong.check, wrong.level) == ('conventions', Level.ERROR)
    assert '--zero hanging' in wrong.sentence
    assert [each.level for each in check(file, **wrong.remedy)] == [Level.OK] * 6
    assert [each.check for each in check(f'{SAMPLE}@0:0.3')] == ['reading']
    short = tmp_path / 'short.csv'
    short.write_text(csv(motion[motion.t < 1.8]))
    assert 'take the complete recording by @0:' in check(short)[-1].sentence
    assert all(each.level == Level.OK for each in check(f'{short}@0:'))
    # A jump in the part for validation.
    later = motion.t > 0.7 * motion.duration
    for jump in (replace(motion, q=motion.q + 6.0 * later[:, None]), motion[(motion.t < 12) | (motion.t > 13)]):
        (wrong,) = (each for each in check(jump) if each.level == Level.ERROR)
        with pytest.raises(PendubotError) as refused:
            identify(jump, **FAST)
        assert wrong.sentence == str(refused.value)
    file.write_text(csv(motion, convert=lambda q: np.degrees(q - HANGING)))
    fast = check(file)[-1]
    assert (fast.check, fast.level, fast.remedy) == ('limits', Level.ERROR, {'degrees': 'true'})
    assert 'if they are encoder counts, multiply them by 2 pi / counts per turn' in fast.sentence
    with pytest.raises(PendubotError, match='there is no option'):
        check(file, nonsense=1)


@pytest.mark.parametrize('call', [read, identify, Pendubot.load, Identified.load])
@pytest.mark.parametrize('name', ['nosuch.csv', 'nosuch'])
def test_a_missing_file_is_also_a_file_not_found_error(call, name):
    with pytest.raises(FileNotFoundError, match=f'there is no (file|bag) {name}') as caught:
        call(name)
    assert isinstance(caught.value, PendubotError)


@pytest.mark.parametrize(
    ('call', 'message'),
    [
        (lambda: simulate(RIG, TIMES, [1.0, 2.0]), r'\(N,\) or \(N, 2\) are expected'),
        (lambda: simulate(None, TIMES), 'NoneType was given; a Pendubot is expected, such as found.pendubot'),
        (lambda: identify(SAMPLE, start=[5]), 'start is of type list; a result file or a Pendubot, such as found.pend'),
        (lambda: describe(read(SAMPLE)), 'Trajectory was given; the name of a bag or file is expected'),
        (lambda: compare([]), "results of identify.. by their names are expected, such as {'first': found}"),
        (lambda: compare({'rig': RIG}), 'results of identify.. by their names are expected'),
        (lambda: simulate(RIG, TIMES, ['a', 'b', 'c']), 'tau cannot be read: could not convert string'),
        (lambda: identify(t=[0.0, 1.0], q=[[0.0, 0.0], [0.0]], tau=0.0), 'q cannot be read: .*; numbers are expected'),
        (lambda: simulate(RIG, [0, 0.1, np.nan], 0.0), 'a stamp is not a finite number'),
        (lambda: simulate(RIG, TIMES, [0, np.nan, 0]), 'a tau that is not a number'),
        (lambda: simulate(RIG, TIMES, 0.0, (np.nan, 0)), 'a q that is not a number'),
        (lambda: simulate(RIG, TIMES, 0.0, (1,)), r'shape \(3, 1\); \(3, 2\) is expected'),
        (lambda: read({'t': [0.0]}), 'dict was given; only names .*, each an argument of its own, or t, q and tau are'),
        (
            lambda: read(pytest.importorskip('pandas').Series([0.0])),
            'Series was given; only names of bags or files, or',
        ),
        (lambda: read(SAMPLE, negate='q9'), "negate: there is no quantity 'q9'"),
        (lambda: identify(SAMPLE, read(SAMPLE)), 'PosixPath was given; only names of bags or files, or only'),
        (identify, 'nothing was given; only names of bags or files, or only DataFrames and motions'),
        (lambda: identify(t=[0.0], q=[[0.0, 0.0]]), 'tau is missing; t, q and tau are expected together'),
        (lambda: identify(t=[0.0, 1.0], q=[0.0, 0.0], tau=0.0), r't has shape \(2,\) and q \(2,\)'),
        (lambda: identify(t=0.0, q=[0.0, 0.0], tau=0.0), r't has shape \(\) and q \(2,\); \(N,\) and \(N, 2\)'),
        (
            lambda: identify(t=[0.0, 1.0], q=np.zeros((2, 2)), tau=0.0, qd=[0.0, 1.0], degrees=True),
            r't has shape \(2,\) and qd \(2,\); \(N,\) and \(N, 2\) are expected',
        ),
        (lambda: identify(Trajectory(np.zeros(1), np.zeros((1, 2)), np.zeros((1, 2)))), '1 samples are too few'),
        (lambda: Trajectory([[0.0]], [[0.0, 0.0]], [[0.0, 0.0]]), r't has shape \(1, 1\); \(1,\) is expected'),
        (lambda: identify(SAMPLE, t=[0.0]), 'both recordings and arrays were given'),
        (lambda: Pendubot(1.0, 1.0, 5.0, 1.0, 1.0, 0.0, 0.0), 'no rig can have .* does not exceed P3'),
        (lambda: identify(read(SAMPLE), degrees=True), 'degrees convert files, and a Trajectory is already converted'),
    ],
)
def test_invalid_arguments_are_reported_in_one_sentence(call, message):
    with pytest.raises(PendubotError, match=message):
        call()
