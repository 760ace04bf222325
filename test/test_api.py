# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What is imported from the package itself, as a script or a notebook does."""

import ast
import json
import subprocess
import sys
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

import pendubot_identification
from pendubot_identification import (
    HANGING,
    UPRIGHT,
    Identified,
    Level,
    Pendubot,
    PendubotError,
    Trajectory,
    api,
    identify,
    read,
    simulate,
)
from pendubot_identification.model.parameters import BALANCE
from test.conftest import ROOT

SAMPLE = ROOT / 'bags' / 'paper_experiment'
FAST = {'criterion': 'weak', 'model': 'viscous', 'hold': 'zero'}
RIG = Pendubot.from_vector(BALANCE.vector())


@pytest.fixture(scope='module')
def found():
    return identify(SAMPLE, **FAST)


def test_names_are_the_same_at_run_time_and_for_type_checkers():
    stub = ast.parse((ROOT / 'pendubot_identification' / '__init__.pyi').read_text())
    listed = {alias.asname for node in stub.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert listed == {*pendubot_identification.__all__} <= {*dir(pendubot_identification)}
    for name in listed - {'identify'}:
        assert getattr(pendubot_identification, name) is getattr(api, name)
    with pytest.raises(AttributeError, match='no attribute'):
        pendubot_identification.nonsense  # noqa: B018


@pytest.mark.parametrize('before', ['', 'import pendubot_identification.identify.options, pendubot_identification.api'])
def test_importing_takes_nothing_and_identify_is_a_function_and_a_room_whatever_came_first(before):
    script = f"""
import json, sys
import pendubot_identification
heavy = sorted({{'numpy', 'scipy', 'yaml', 'ctypes'}} & {{*sys.modules}})
{before}
from pendubot_identification import identify, read
import pendubot_identification.identify.settings as settings
assert callable(identify) and identify.settings is settings
try:
    identify()
except pendubot_identification.PendubotError as error:
    print(json.dumps([heavy, str(error)]))
"""
    done = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True, timeout=60, check=True)
    heavy, said = json.loads(done.stdout)
    assert heavy == []
    assert 'names of bags, or motions as read() returns them, are expected' in said


def test_bags_and_motions_in_memory_give_the_same_parameters(found):
    motion = read(SAMPLE)
    again = identify(motion, **FAST)
    np.testing.assert_allclose(again.theta, found.theta, rtol=1e-9)
    assert [source.role for source in again.result.bags] == ['training', 'validation']
    part = read(f'{SAMPLE}@0:9')
    assert 9 - part.interval <= part.duration + 1e-9 < 9.0


def test_a_file_of_ones_own_is_read_as_is_said(found, tmp_path):
    motion = read(SAMPLE)
    columns = [motion.t * 1000, *np.degrees(motion.q - HANGING).T, motion.tau[:, 0]]
    np.savetxt(tmp_path / 'run.txt', np.transpose(columns), header='t a b u', fmt='%.17g')
    said = {'columns': {'q1': 'a', 'q2': 'b', 'tau1': 'u'}, 'degrees': True, 'zero': 'hanging', 'time_unit': 'ms'}
    np.testing.assert_allclose(read(tmp_path / 'run.txt', **said).q, motion.q, atol=1e-12)
    np.testing.assert_allclose(identify(tmp_path / 'run.txt', **said, **FAST).theta, found.theta, rtol=1e-6)


def test_what_was_found_is_arrays_and_saved_and_read_again(found, tmp_path):
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
    assert 'Measured against simulated motion' in found.report(tmp_path / 'look').read_text()


def test_a_notebook_shows_verdict_and_tables(found):
    doubtful = replace(found, result=replace(found.result, level=Level.WARN, warnings=['P1 < P2 & so on']))
    shown = ElementTree.fromstring(f'<div>{doubtful._repr_html_()}</div>')
    assert shown.find('p').text == 'WARN: P1 < P2 & so on'
    rows = list(shown.find('table').iter('tr'))
    assert [row[0].text for row in rows[1:3]] == ['P1 [kg m²]', 'P2 [kg m²]']
    assert 'the 95 % intervals hold, given the torque scale' in found._repr_html_()
    assert 'P1=0.0022' in repr(found)


def test_a_frame_has_a_row_a_parameter(found):
    pytest.importorskip('pandas')
    frame = found.frame()
    assert tuple(frame.index) == found.names
    np.testing.assert_array_equal(frame['value'], found.theta)
    np.testing.assert_array_equal(frame[['low', 'high']], found.intervals)
    assert frame.loc['b2', 'meaning'] == 'viscous friction of the elbow'


def test_without_pandas_the_frame_says_so(found, monkeypatch):
    monkeypatch.setitem(sys.modules, 'pandas', None)
    with pytest.raises(PendubotError, match='pip install pandas'):
        found.frame()


def test_a_rig_moves_as_its_terms_say():
    """M a = tau - bias - friction, energy is kept without friction, and upright is where A says that it falls."""
    q, qd, tau = np.array([0.3, -1.2]), np.array([2.0, -1.0]), np.array([0.2, 0.1])
    friction = np.array([RIG.b1, RIG.b2]) * qd
    left = RIG.mass_matrix(q) @ RIG.acceleration(q, qd, tau)
    np.testing.assert_allclose(left, tau - RIG.bias(q, qd) - friction, rtol=1e-12)
    free = replace(RIG, b1=0.0, b2=0.0)
    assert isinstance(free, Pendubot)
    motion = free.simulate(np.arange(200) * 0.01, q=(0.1, 0.2))
    energy = free.energy(motion.q, motion.qd)
    np.testing.assert_allclose(energy, energy[0], atol=1e-8)
    A, B = RIG.linearised()
    off, push = np.array([1e-6, -2e-6]), 1e-6
    slope = A @ [*off, 0, 0] + B[:, 0] * push
    np.testing.assert_allclose(RIG.acceleration(UPRIGHT + off, [0, 0], [push, 0]), slope[2:], rtol=1e-6)


def test_a_torque_may_be_a_number_or_the_shoulders_or_both():
    t = np.arange(100) * 0.01
    expected = simulate(RIG, t, np.column_stack([np.full(100, 0.3), np.zeros(100)]))
    for tau in (0.3, np.full(100, 0.3)):
        motion = simulate(RIG, t, tau, HANGING)
        assert isinstance(motion, Trajectory)
        np.testing.assert_array_equal(motion.q, expected.q)
    with pytest.raises(PendubotError, match=r'\(N,\) or \(N, 2\) are expected'):
        simulate(RIG, t, [1.0, 2.0])


def test_exports_are_those_of_the_command_line(found):
    assert 'swing' not in RIG.export('mjcf')
    assert '<robot' in found.export('urdf', link_length=0.03, torque_limit=1.0)
    with pytest.raises(PendubotError, match="no format 'usd'"):
        RIG.export('usd')


@pytest.mark.parametrize(
    ('call', 'said'),
    [
        (lambda: identify(SAMPLE, read(SAMPLE)), 'PosixPath, Trajectory was given'),
        (lambda: identify(SAMPLE, critrion='weak'), "no option 'critrion'; the options are criterion"),
        (lambda: identify(SAMPLE, bounds={'P9': (0, 1)}), "no parameter 'P9'"),
        (lambda: read('nosuch.csv'), 'cannot be read'),
        (lambda: read(SAMPLE, columns={'q1': 'a'}), 'is for files with columns; the stamps of a bag'),
        (lambda: identify(read(SAMPLE), degrees=True), 'degrees say how files are read, and motions are read already'),
        (lambda: Pendubot.load('nosuch.yaml'), 'cannot be read'),
    ],
)
def test_mistakes_are_said_in_a_sentence(call, said):
    with pytest.raises(PendubotError, match=said):
        call()
