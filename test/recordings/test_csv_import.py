# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

import csv
import math

import numpy as np
import pytest

from pendubot_identification.errors import CsvError
from pendubot_identification.recordings.bag_reader import read_trajectory
from pendubot_identification.recordings.csv_import import import_csv
from pendubot_identification.recordings.joint_states import write_trajectory

from ..conftest import RECORDINGS

TEXT = """t,q1,q2,dq1,dq2,tau1,tau2
5.00,0.1,0.2,1,2,3,4
5.01,0.3,0.5,5,6,7,8
5.03,0.6,0.4,9,8,7,6
"""


@pytest.fixture
def given(tmp_path):
    def write(text=TEXT, encoding='utf-8'):
        path = tmp_path / 'run.csv'
        path.write_text(text, encoding=encoding)
        return path

    return write


def test_the_default_columns(given):
    trajectory = import_csv(given())
    np.testing.assert_allclose(trajectory.t, [0, 0.01, 0.03])
    np.testing.assert_array_equal(trajectory.q, [[0.1, 0.2], [0.3, 0.5], [0.6, 0.4]])
    np.testing.assert_array_equal(trajectory.qd, [[1, 2], [5, 6], [9, 8]])
    np.testing.assert_array_equal(trajectory.tau, [[3, 4], [7, 8], [7, 6]])


def test_what_may_be_absent(given):
    trajectory = import_csv(given('t,q1,q2,tau1\n0,1,2,3\n1,2,3,4\n'))
    assert trajectory.qd is None
    np.testing.assert_array_equal(trajectory.tau, [[3, 0], [4, 0]])


@pytest.mark.parametrize(
    'text',
    [
        TEXT.replace(',', ';'),
        TEXT.replace(',', ' , '),
        TEXT.replace(',', '\t'),
        TEXT + '\n,,\n',
        TEXT.replace('7,6', '7,6,'),
        'sep=;\n' + TEXT.replace(',', ';'),
        '"SEP=|"\n' + TEXT.replace(',', '|'),
        'sep=\t\n' + TEXT.replace(',', '\t'),
    ],
)
def test_other_ways_to_write_the_same(given, text):
    np.testing.assert_array_equal(import_csv(given(text)).q, import_csv(given()).q)


def test_a_byte_order_mark_is_no_part_of_a_name(given):
    assert len(import_csv(given(encoding='utf-8-sig'))) == 3


def test_columns_can_be_named(given):
    path = given('time,th1,th2,u,extra\n0,1,2,3,x\n1,2,3,4,y\n')
    trajectory = import_csv(path, {'t': 'time', 'q1': 'th1', 'q2': 'th2', 'tau1': 'u'})
    np.testing.assert_array_equal(trajectory.q, [[1, 2], [2, 3]])


def test_degrees(given):
    plain, degrees = import_csv(given()), import_csv(given(), degrees=True)
    np.testing.assert_allclose(degrees.q, np.deg2rad(plain.q))
    np.testing.assert_allclose(degrees.qd, np.deg2rad(plain.qd))
    np.testing.assert_array_equal(degrees.tau, plain.tau)


@pytest.mark.parametrize('zero', ['horizontal', 'hanging'])
@pytest.mark.parametrize('elbow', ['relative', 'absolute'])
def test_the_same_pose_in_every_convention(tmp_path, zero, elbow):
    # Link 1 at 30 degrees above the horizontal, link 2 bent by 40 degrees more; 1 and 2 rad/s.
    q1, q2, dq1, dq2 = math.radians(30), math.radians(40), 1.0, 2.0
    first = q1 + (math.pi / 2 if zero == 'hanging' else 0)
    second = first + q2 if elbow == 'absolute' else q2
    second_rate = dq1 + dq2 if elbow == 'absolute' else dq2
    path = tmp_path / 'run.csv'
    with path.open('w', newline='') as file:
        rows = [
            (t, math.degrees(first), math.degrees(second), 0, math.degrees(dq1), math.degrees(second_rate))
            for t in (0, 1)
        ]
        csv.writer(file).writerows([('t', 'q1', 'q2', 'tau1', 'dq1', 'dq2'), *rows])
    trajectory = import_csv(path, degrees=True, zero=zero, elbow=elbow)
    np.testing.assert_allclose(trajectory.q[1], [q1, q2], atol=1e-12)
    np.testing.assert_allclose(trajectory.qd[1], [dq1, dq2], atol=1e-12)


@pytest.mark.parametrize(
    ('text', 'sentence'),
    [
        (TEXT.replace('tau1', 'torque'), r"no column 'tau1' for tau1; its columns are t, q1, .*--columns tau1=NAME"),
        (TEXT.replace('0.5', 'open'), r"line 3, column 'q2': 'open' is no finite number"),
        (TEXT.replace('0.5', 'nan'), r"line 3, column 'q2': 'nan' is no finite number"),
        (TEXT.replace('0.5', ''), r"line 3, column 'q2': nothing is no finite number"),
        (
            TEXT.replace(',7,6', ''),
            'line 4 has 5 cells; 7 are expected, one for each column name; mend or remove that row',
        ),
        (TEXT.replace('9,8,7,6', '9,8,7'), 'line 4 has 6 cells'),
        (TEXT.replace('9,8,7,6', '9,8,7,6,5'), 'line 4 has 8 cells; 7 are expected'),
        (
            TEXT.replace('9,8,7,6', '9,8,7,6,5').replace(',', ';'),
            '7 are expected, one for each column name; mend or remove that row',
        ),
        # Decimal commas, in all columns and in the last alone.
        (
            't,q1,q2,tau1\n0,00,0,10,0,20,0,30\n0,01,0,10,0,20,0,30\n',
            'line 2 has 8 cells; 4 are .*decimals .*commas: .*points',
        ),
        (
            't,q1,q2,tau1\n0.00,0.1,0.2,0,30\n0.01,0.1,0.2,0,31\n',
            'line 2 has 5 cells; 4 are .*decimals .*commas: .*points',
        ),
        (TEXT.splitlines()[0], 'holds no row of numbers'),
        (TEXT.replace(',', ';').replace('.', ','), "'5,00' is no finite number; write decimals with a point"),
        (TEXT.replace('dq1', 'q1'), "has 2 columns 'q1'; rename all but the one for q1"),
        (TEXT.replace('0.5', '5' * 200_000), 'line 3: field larger than field limit'),
        ('t,q1,q2,tau1\n0,1,2,3\n10,1,2,3\n20,1,2,3\n', r'rows are 10 s apart.*divide milliseconds by 1000'),
        ('', 'run.csv is empty; a line of column names and rows of numbers are expected'),
        (' \n\n', 'run.csv is empty'),
        ('sep=;', "no column 't' for t"),
        ('sep=;\nt;q1;q2;tau1\n0;1;2;nan\n', "line 3, column 'tau1': 'nan'"),
    ],
)
def test_a_file_that_cannot_be_used_is_one_sentence(given, text, sentence):
    with pytest.raises(CsvError, match=sentence):
        import_csv(given(text))


def test_a_column_that_was_named_must_be_there(given):
    with pytest.raises(CsvError, match="no column 'u2' for tau2"):
        import_csv(given(), {'tau2': 'u2'})
    with pytest.raises(CsvError, match="'theta1' is no quantity"):
        import_csv(given(), {'theta1': 'q1'})


@pytest.mark.parametrize(('stamp', 'what'), [('5.00', 'repeats'), ('4.99', 'runs back')])
def test_stamps_that_do_not_increase_are_one_sentence(given, stamp, what):
    with pytest.raises(CsvError, match=rf'line 3: the time .* {what}, after 5; every row needs a later one'):
        import_csv(given(TEXT.replace('5.01', stamp)))


def test_a_file_that_cannot_be_read_is_one_sentence(tmp_path):
    with pytest.raises(CsvError, match='No such file'):
        import_csv(tmp_path / 'nowhere.csv')
    (tmp_path / 'binary.csv').write_bytes(b'\x89MCAP0\r\n\xff')
    with pytest.raises(CsvError, match='no text in UTF-8'):
        import_csv(tmp_path / 'binary.csv')


@pytest.mark.recordings
def test_every_recording_imports_into_a_bag(tmp_path):
    with (RECORDINGS / 'manifest.csv').open() as file:
        entries = list(csv.DictReader(file))
    assert len(entries) == 16
    for entry in entries:
        trajectory = import_csv(RECORDINGS / entry['file'])
        bag = tmp_path / entry['file'].removesuffix('.csv')
        write_trajectory(bag, trajectory)
        back = read_trajectory(bag).trajectory
        assert len(back) == int(entry['samples'])
        np.testing.assert_allclose(back.t, trajectory.t, atol=1e-9)
        np.testing.assert_array_equal(back.q, trajectory.q)
        np.testing.assert_array_equal(back.qd, trajectory.qd)
        np.testing.assert_array_equal(back.tau, trajectory.tau)
