# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

import re
import shlex
import struct
import sys

import numpy as np
import pytest
import scipy.io

from pendubot_identification import api
from pendubot_identification.errors import PendubotError, TableError
from pendubot_identification.recordings.table_reader import TableReader
from pendubot_identification.trajectories.conversion import Conversion

TEXT = """t,q1,q2,dq1,dq2,tau1,tau2
5.00,0.1,0.2,1,2,3,4
5.01,0.3,0.5,5,6,7,8
5.03,0.6,0.4,9,8,7,6
"""
NAMES = ['t', 'q1', 'q2', 'tau1']
MINIMAL = 't,q1,q2,tau1\n'


def read(path, **options):
    return TableReader(path, Conversion.of(options)).motion


@pytest.fixture
def written(tmp_path):
    def write(text=TEXT, encoding='utf-8'):
        path = tmp_path / 'run.csv'
        path.write_text(text, encoding=encoding)
        return path

    return write


def test_the_default_columns_and_degrees(written):
    trajectory = read(written())
    np.testing.assert_allclose(trajectory.t, [0, 0.01, 0.03])
    np.testing.assert_array_equal(trajectory.q, [[0.1, 0.2], [0.3, 0.5], [0.6, 0.4]])
    np.testing.assert_array_equal(trajectory.qd, [[1, 2], [5, 6], [9, 8]])
    np.testing.assert_array_equal(trajectory.tau, [[3, 4], [7, 8], [7, 6]])
    degrees = read(written(), degrees=True)
    np.testing.assert_allclose(degrees.q, np.deg2rad(trajectory.q))
    np.testing.assert_allclose(degrees.qd, np.deg2rad(trajectory.qd))
    np.testing.assert_array_equal(degrees.tau, trajectory.tau)


@pytest.mark.parametrize('encoding', ['utf-8', 'utf-16-le'])
def test_a_byte_order_mark_is_left_out_in_a_named_encoding(written, encoding):
    path = written('\ufeff' + TEXT, encoding)
    np.testing.assert_array_equal(read(path, encoding=encoding).q, [[0.1, 0.2], [0.3, 0.5], [0.6, 0.4]])


def test_an_invalid_cell_after_many_rows_is_found(written):
    rows = [f'{k / 100};{0.1 * (k % 7)};0.2;{k % 3}' for k in range(20_000)]
    rows[17_000] = '170;é;0.2;1'
    path = written('\n'.join([MINIMAL.strip().replace(',', ';'), *rows]).replace('.', ','), encoding='latin-1')
    with pytest.raises(TableError, match=r"line 17002, column 'q1': 'é' is no finite number, as of 1 of 20000 rows"):
        read(path, decimal='comma')
    motion = read(path, decimal='comma', skip_missing=True)
    assert len(motion) == 19_999
    np.testing.assert_array_equal(motion.q[-1], [0.1 * (19_999 % 7), 0.2])


@pytest.mark.parametrize(
    ('text', 'sentence'),
    [
        (TEXT.replace('tau1', 'y'), r"no column 'tau1' for tau1; its columns are t, q1, .*--columns tau1=NAME"),
        *(
            (TEXT.replace('0.5', cell), f"line 3, column 'q2': {quoted} is no finite number")
            for cell, quoted in (('open', "'open'"), ('nan', "'nan'"), ('', 'nothing'))
        ),
        (TEXT.replace(',7,6', ''), 'line 4 has 5 cells; 7 are expected, one for each column name; correct or remove'),
        (TEXT.replace('9,8,7,6', '9,8,7,6,5').replace(',', ';'), 'line 4 has 8 cells; .* name; correct or remove'),
        # Decimal commas in all columns, and in the last column.
        (MINIMAL + '0,00,0,10,0,20,0,30\n', 'line 2 has 8 cells; 4 are .*decimals .*commas: .*points'),
        (MINIMAL + '0.00,0.1,0.2,0,30\n', 'line 2 has 5 cells; 4 are .*decimals .*commas: .*points'),
        *(
            (MINIMAL.replace(',', ';') + f'{first};1;2;3\n{second};1;2;3\n', f"{second}' has separators of thousands")
            for first, second in (('9,000', '1,000,000'), ('9.000', '1.000.000'), ('9,000', '1,234.5'))
        ),
        (TEXT.replace('dq1', 'q1'), "has 2 columns 'q1'; rename all but one of them"),
        (MINIMAL + '0,1,2,3\n10,1,2,3\n20,1,2,3\n', r'rows are 10 s apart.*: add --time-unit ms'),
        (MINIMAL + '0,1,2,3\n.12,1,2,3\n', r'rows are 0.12 s apart.*: record at a higher rate'),
        (MINIMAL + '10:00:00.0,1,2,3\n10:00:05.0,1,2,3\n', r'rows are 5 s apart.*: record at a higher rate'),
        (TEXT.splitlines()[0], 'holds no row of numbers'),
        (
            TEXT.replace('q1', 'q1 [deg]').replace('q2', 'q2 [rad]'),
            "'q1 .deg.' and 'q2 .rad.' have different units; convert",
        ),
        (' \n\n', 'run.csv is empty; a line of column names and rows of numbers are expected'),
        ('sep=;\n' + TEXT.replace(',', ';'), 'has its column names in line 2, line 1 is expected: add --skip-rows 1'),
        *(
            (TEXT.replace('5.01', stamp), rf'line 3: the time .* {problem}')
            for stamp, problem in (
                ('5.00', 'repeats, after 5; every row needs a later one: export more digits'),
                ('4.99', 'decreases, after 5; every row needs a later one: .* without a restart of the clock'),
            )
        ),
        (
            MINIMAL + '1732710000.098,1,2,3\n1732710000.099,1,2,3\n1732710000.098,1,2,3\n',
            r'line 4: the time 1732710000.098 decreases, after 1732710000.099; every',
        ),
    ],
)
def test_an_unusable_text_file_is_refused_in_one_sentence(written, text, sentence):
    with pytest.raises(TableError, match=sentence):
        read(written(text))


@pytest.mark.parametrize(
    ('columns', 'sentence'),
    [
        ({'tau2': 'u2'}, "no column 'u2' for tau2"),
        ({'t': 't', 'q2': 'x'}, "no column 'x' for q2; .* --columns t=t,q2=q2"),
        ({'theta1': 'q1'}, "columns: there is no quantity 'theta1'"),
    ],
)
def test_invalid_column_names_are_refused_in_one_sentence(written, columns, sentence):
    with pytest.raises(PendubotError, match=sentence):
        read(written(), columns=columns)


def opaque():
    """Return a timetable of MATLAB: an object whose content is a reference number."""

    def element(kind, data):
        return struct.pack('<II', kind, len(data)) + data + b'\0' * (-len(data) % 8)

    def matrix(kind, *parts):
        return element(14, element(6, struct.pack('<II', kind, 0)) + b''.join(parts))

    number = matrix(13, element(5, struct.pack('<ii', 1, 1)), element(1, b''), element(6, struct.pack('<I', 7)))
    return matrix(17, element(1, b'T'), element(1, b'MCOS'), element(1, b'timetable'), number)


def in_matlab(path, **variables):
    scipy.io.savemat(path, variables)


def in_excel(path, *rows):
    book = pytest.importorskip('openpyxl').Workbook()
    for row in rows:
        book.active.append(row)
    book.save(path)


#: Functions that write the files, and the errors, by name.
UNUSABLE = {
    'binary.csv': (lambda path: path.write_bytes(b'\x89MCAP0\r\n\xff'), 'no text in UTF-8'),
    'text.mat': (lambda path: path.write_text('hello' * 99), r'is not a readable \.mat file'),
    'text.xlsx': (lambda path: path.write_text('hello'), r'is not a readable \.xlsx file'),
    'text.parquet': (lambda path: path.write_text('hello'), r'is not a readable \.parquet file'),
    'strings.mat': (lambda path: in_matlab(path, a='text', n=3.0), 'holds no columns of numbers'),
    'structs.mat': (
        lambda path: in_matlab(path, a={'t': np.arange(9.0)}, b={'t': np.arange(9.0), 'x': np.arange(9.0)}),
        "no column 't' for t; its columns are a.t, b.t, x",
    ),
    'timetable.mat': (
        lambda path: path.write_bytes(b'MATLAB 5.0 MAT-file'.ljust(124) + b'\0\1IM' + opaque()),
        r"which only MATLAB can read; in MATLAB, writetable\(timetable2table\(T\), 'run.csv'\)",
    ),
    'new.mat': (
        lambda path: path.write_bytes(b'MATLAB 7.3 MAT-file'.ljust(124) + b'\0\2IM'),
        "of MATLAB's version 7.3; save it with -v7",
    ),
    'octave.txt': (
        lambda path: path.write_text('# Created by Octave 8.4\n# name: t\n# type: matrix\n 0\n'),
        "is in Octave's text format; export it from Octave by save -v7 run.mat",
    ),
    'blank.xlsx': (in_excel, 'holds no columns of numbers'),
    'gap.xlsx': (
        lambda path: in_excel(path, [], NAMES, [0, 1, 2, 3], [0.01, 1, None, 3]),
        "row 4, column 'q2': nothing is no finite number, as of 1 of 2 rows; .*: add --skip-missing",
    ),
}


@pytest.mark.parametrize('name', UNUSABLE)
def test_an_unusable_file_of_another_program_is_refused_in_one_sentence(tmp_path, name):
    if package := {'parquet': 'pyarrow', 'xlsx': 'openpyxl'}.get(name.partition('.')[2]):
        pytest.importorskip(package)
    write, sentence = UNUSABLE[name]
    write(tmp_path / name)
    with pytest.raises(TableError, match=sentence):
        read(tmp_path / name)


def test_the_signals_of_a_scope_are_columns(tmp_path):
    t, names = np.arange(9.0)[:, None] / 100, ('q1', 'q2', 'tau1')
    signals = np.zeros(3, [('values', object), ('label', object)])
    signals[:] = [(k + t, name) for k, name in enumerate(names)]
    in_matlab(tmp_path / 'scope.mat', log={'time': t, 'signals': signals, 'blockName': 'rig/Scope'})
    with pytest.raises(TableError, match=r'its columns are time, log.signals1.values, log.signals2.values, log'):
        read(tmp_path / 'scope.mat')
    columns = {name: f'log.signals{k + 1}.values' for k, name in enumerate(names)}
    motion = read(tmp_path / 'scope.mat', columns=columns)
    np.testing.assert_allclose(np.column_stack([motion.q, motion.tau[:, 0]]), np.arange(3) + t)


def test_the_index_of_a_frame_is_a_column(tmp_path):
    pandas, _ = pytest.importorskip('pandas'), pytest.importorskip('pyarrow')
    frame = pandas.DataFrame({'t': np.arange(9) / 100, 'q1': 1.0, 'q2': 2.0, 'tau1': 3.0})
    for k, each in enumerate((frame, frame.set_index('t'), frame.set_index('t', drop=False))):
        each.to_parquet(tmp_path / f'{k}.parquet')
        np.testing.assert_array_equal(read(tmp_path / f'{k}.parquet').t, frame['t'])
        np.testing.assert_array_equal(api.read(each).t, frame['t'])
    dates = pandas.Timestamp('2026-11-27', tz='Europe/Berlin') + pandas.to_timedelta(frame['t'], unit='s')
    for index in (pandas.Index(dates), pandas.Index(dates - dates[0])):
        unnamed = frame.drop(columns='t').set_index(index.rename(None))
        np.testing.assert_allclose(api.read(unnamed).t, frame['t'], atol=1e-9)


def test_dates_of_numpy_are_times(tmp_path):
    t = np.datetime64('2026-11-27T12:00', 'ns') + np.arange(9) * np.timedelta64(10, 'ms')
    np.savez(tmp_path / 'x.npz', t=t, q=np.ones((9, 2)), tau1=np.ones(9))
    np.testing.assert_allclose(read(tmp_path / 'x.npz', time_unit='ms').t, np.arange(9) / 100)


def test_a_missing_package_is_reported_with_the_command_that_installs_it(tmp_path, monkeypatch):
    (tmp_path / 'x.xlsx').write_bytes(b'')
    monkeypatch.setitem(sys.modules, 'pandas', None)
    with pytest.raises(TableError, match=r'pip install .*pandas.*; or in MATLAB, writetable\(table'):
        read(tmp_path / 'x.xlsx')


#: Unit of the current [A] by column name.
CURRENTS = {
    **dict.fromkeys(('Motor_Current', 'I', 'tau [A]', 'i_q', 'A', 'Intensité', '电流'), 1.0),
    **dict.fromkeys(('Strom [mA]', 'current_mA', 'mA'), 1e-3),
}


@pytest.mark.parametrize('name', CURRENTS)
def test_a_current_is_not_accepted_as_a_torque(written, name):
    path, columns, amperes = written(f't,q1,q2,{name}\n0,1,2,3\n0.01,1,2,4\n'), {'tau1': name}, CURRENTS[name]
    with pytest.raises(TableError, match=re.escape('--torque-constant K [N m/A], and --gear N')):
        read(path)
    with pytest.raises(TableError, match=f'a torque is expected: .* or --torque-constant {1 / amperes:g} if it is'):
        read(path, columns=columns)
    for options, expected in (
        ({'torque_constant': 1 / amperes}, 1.0),
        ({'torque_constant': 0.05, 'gear': 7.0}, 0.35 * amperes),
    ):
        motion = read(path, columns=columns, **options)
        np.testing.assert_allclose(motion.tau[:, 0], np.multiply(expected, [3, 4]), atol=1e-12)


def test_an_unknown_unit_is_not_accepted_as_newton_metres(written):
    path = written('t,q1,q2,tau1 [lbf ft]\n0,1,2,3\n0.01,1,2,4\n')
    with pytest.raises(TableError, match=r"unit 'lbf ft' of the column 'tau1 .lbf ft.' is not known, and N m are"):
        read(path)
    np.testing.assert_allclose(read(path, torque_constant=1.3558).tau[:, 0], np.multiply(1.3558, [3, 4]))


@pytest.mark.parametrize(('name', 'column', 'unit'), [('q1', 'q1 [rev]', 'rev'), ('t', 'time (min)', 'min')])
def test_an_unknown_unit_of_a_time_or_an_angle_is_refused_unless_the_column_is_named(written, name, column, unit):
    file = written(MINIMAL.replace(name, column, 1) + '0,1,2,3\n0.01,1,2,4\n')
    with pytest.raises(TableError, match=f"unit '{unit}' of the column .* is not known") as refused:
        read(file)
    assert str(refused.value).endswith(f'name it with --columns {shlex.quote(f"{name}={column}")}')
    assert len(read(file, columns={name: column})) == 2
    dated = 'Time (UTC),q1,q2,tau1\n2026-05-12T10:00:00.00,1,2,3\n2026-05-12T10:00:00.01,1,2,3\n'
    assert len(read(written(dated))) == 2
    digits = dated.replace('00.00', '00').replace('00.01', '00.010000001')
    assert read(written(digits)).duration == pytest.approx(0.01)


def test_a_current_by_a_row_of_units_is_not_accepted_as_a_torque(written):
    path = written('t,q1,q2,tau1\ns,rad,rad,mA\n0,0,0,1\n0.01,0.1,0,2\n')
    with pytest.raises(TableError, match='seems to hold a motor current'):
        read(path)
    np.testing.assert_allclose(read(path, torque_constant=2).tau[:, 0], [0.002, 0.004])
    with pytest.raises(PendubotError, match='--gear 5 multiplies a torque constant, and none is given; add'):
        read(path, gear=5)
