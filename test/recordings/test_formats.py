# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""One recording in files of many formats: reading with the options that the messages name gives the same motion."""

import csv
import datetime

import numpy as np
import pytest
import scipy.io

from pendubot_identification import describe, read
from pendubot_identification.trajectories.conversion import options
from test.conftest import SAMPLE

pandas, openpyxl, _ = map(pytest.importorskip, ('pandas', 'openpyxl', 'pyarrow'))

UNITS = 'ms', 'deg', 'deg', 'mNm'


def text(*names, lines=lambda lines: lines, encoding='utf-8', **how):
    """Return a function that writes text with these column names and changed lines."""

    def write(file, columns):
        table = pandas.DataFrame(columns).to_csv(index=False, header=list(names) or True, **how)
        file.write_text('\n'.join(lines(table.splitlines())), encoding=encoding)

    return write


def separated(by):
    return text(lines=lambda lines: [line.replace(',', by) for line in lines])


def with_missing_rows(lines):
    """Insert rows without values, as a logger does without data."""
    return [*lines[:10], '#N/A,#N/A,#N/A,#N/A', *lines[10:300], '3.0,nan,NaN,nan', *lines[300:700], ',,,', *lines[700:]]


def with_damaged_rows(lines):
    """Insert cut and merged rows, as in the log of a serial port."""
    return [*lines[:10], lines[10][:9], *lines[10:300], lines[300][:9] + lines[301], *lines[300:]]


def excel(**how):
    return lambda file, columns: pandas.DataFrame(columns).to_excel(file, index=False, **how)


def excel_as_text(file, columns):
    excel()(file, {name: [str(x).replace('.', ',') for x in values.tolist()] for name, values in columns.items()})


def sheet_with_a_title(file, columns):
    """Write a second sheet with a title above the names and units below them."""
    book = openpyxl.Workbook()
    book.active.append(['Protokoll'])
    sheet = book.create_sheet('Messung 1')
    for row in (['Pendel A'], list(columns), UNITS, *np.column_stack(list(columns.values())).tolist()):
        sheet.append(row)
    book.save(file)


def matlab_struct(file, columns):
    scipy.io.savemat(file, {'remark': 'Monday', 'run': {**columns, 'gain': 3.0}}, oned_as='column')


def matrices(columns):
    return {'t': columns['t'], 'q': np.column_stack([columns['q1'], columns['q2']]), 'tau': columns['tau1']}


def repeated(lines):
    """Repeat some rows, like a logger that is faster than the rig."""
    return [line for k, line in enumerate(lines) for _ in range(1 + (k in (17, 300, 301)))]


def dates(columns, how='%Y-%m-%dT%H:%M:%S.%f'):
    passed = pandas.to_timedelta((1e6 * columns['t']).round(), unit='us')
    return (pandas.Timestamp('2026-05-12 10:00:00') + passed).strftime(how)


DEGREES = {'q1': lambda c: np.degrees(c['q1']), 'q2': lambda c: np.degrees(c['q2'])}
ALL_UNITS = DEGREES | {'t': lambda c: 1000 * c['t'], 'tau1': lambda c: 1000 * c['tau1']}
WRAPPED = DEGREES | {'q1': lambda c: (np.degrees(c['q1']) + 115) % 360 - 115}
MISSING = {'skip_missing': 'true'}
NAMED = 't=c1,q1=c2,q2=c3,tau1=c4'
#: By file name: function that writes the file, changes of the columns, and the options that the messages name.
FILES = {
    'semicolons.csv': (separated(';'), {}, {}),
    'commas and spaces.csv': (separated(' , '), {}, {}),
    'tabs.csv': (separated('\t'), {}, {}),
    'spaces.csv': (separated('   '), {}, {}),
    'numpy.txt': (text(sep=' ', lines=lambda lines: [f'# {lines[0]}', *lines[1:]]), {}, {}),
    'quotes.csv': (text(quoting=csv.QUOTE_ALL), {}, {}),
    'a separator behind a row.csv': (text(lines=lambda lines: [*lines[:9], f'{lines[9]},', *lines[10:]]), {}, {}),
    'a separator behind every row.csv': (text(lines=lambda lines: [f'{line},' for line in lines]), {}, {}),
    'empty rows.csv': (text(lines=lambda lines: [*lines, '', ',,,']), {}, {}),
    'missing rows.csv': (text(lines=with_missing_rows), {}, MISSING),
    'damaged rows.csv': (text(sep=';', lines=with_damaged_rows), {}, MISSING),
    'other names.tsv': (text('Time', 'theta1', 'theta2', 'u', sep='\t'), {}, {}),
    'names of four languages.csv': (text('Zeit [s]', 'angle épaule', 'ángulo codo', '力矩'), {}, {}),
    'no usual names.csv': (text('c1', 'c2', 'c3', 'c4'), {}, {'columns': NAMED}),
    'a mark.csv': (text(encoding='utf-8-sig'), {}, {}),
    'UTF-16.csv': (text(encoding='utf-16'), {}, {}),
    'UTF-16 without a mark.csv': (text(encoding='utf-16-le'), {}, {}),
    'Latin-1.csv': (text('t', 'Winkel Schulter', 'Winkel Ellenbogen [°]', 'tau', encoding='latin-1'), DEGREES, {}),
    'units in names.csv': (text('t_ms', 'q1 [deg]', 'q2 [deg]', 'tau (mNm)'), ALL_UNITS, {}),
    'other words for units.csv': (text('t_millis', 'q1 (degrees)', 'q2 [度]', 'tau (mN m)'), ALL_UNITS, {}),
    'a row of units.csv': (text(lines=lambda lines: [lines[0], ','.join(UNITS), *lines[1:]]), ALL_UNITS, {}),
    'a title.csv': (text(lines=lambda lines: ['Run 7, Monday', 'second try', *lines]), {}, {'skip_rows': '2'}),
    'decimal commas, a title and a nameless column.csv': (
        text(sep=';', decimal=',', lines=lambda lines: ['Versuch 7', *(f';{line}' for line in lines)]),
        {},
        {'skip_rows': '1', 'decimal': 'comma'},
    ),
    'decimal commas.xlsx': (excel_as_text, {}, {'decimal': 'comma'}),
    'a title on a second sheet.xlsx': (sheet_with_a_title, ALL_UNITS, {'sheet': 'Messung 1', 'skip_rows': '1'}),
    'anywhere in a sheet.xlsx': (excel(startrow=2, startcol=3), {}, {}),
    'no names.xlsx': (excel(header=False), {}, {'columns': 't=1,q1=2,q2=3,tau1=4'}),
    'dates as text.xlsx': (excel(), {'t': dates}, {}),
    'German dates.csv': (text(), {'t': lambda c: dates(c, '%d.%m.%Y %H:%M:%S.%f')}, {}),
    'dates in UTC.parquet': (
        lambda file, c: pandas.DataFrame(c).to_parquet(file),
        {'t': lambda c: pandas.to_datetime(dates(c) + 'Z')},
        {},
    ),
    'dates under a unit.csv': (text('t [ms]', 'q1', 'q2', 'tau1', lines=with_missing_rows), {'t': dates}, MISSING),
    'seconds since 1970.csv': (text(), {'t': lambda c: 1.7e9 + c['t']}, {}),
    'repeated times.csv': (text(lines=repeated), {}, {}),
    'wrapped degrees.csv': (text(), WRAPPED, {'unwrap': 'true', 'degrees': 'true'}),
    'packed.csv.gz': (lambda file, c: pandas.DataFrame(c).to_csv(file, index=False), {}, {}),
    'matrices.mat': (lambda file, c: scipy.io.savemat(file, matrices(c), oned_as='row'), {}, {}),
    'struct.mat': (matlab_struct, {}, {}),
    'matrices.npz': (lambda file, c: np.savez(file, **matrices(c)), {}, {}),
    'column vectors.npz': (lambda file, c: np.savez(file, **{n: x[:, None] for n, x in c.items()}), {}, {}),
}


@pytest.mark.parametrize('name', FILES)
def test_a_file_is_read_by_the_options_that_the_messages_name(name, tmp_path):
    motion = read(SAMPLE)[:900]
    columns = {'t': motion.t.round(6), 'q1': motion.q[:, 0], 'q2': motion.q[:, 1], 'tau1': motion.tau[:, 0]}
    write, change, named = FILES[name]
    write(tmp_path / name, columns | {each: convert(columns) for each, convert in change.items()})
    followed = {}
    while problem := (found := describe(tmp_path / name, **followed)).problem:
        assert problem.remedy.keys() - followed.keys(), problem
        assert all(option in str(problem) for option in options(problem.remedy))
        followed |= problem.remedy
    assert followed == named
    np.testing.assert_allclose(found.motion.t, columns['t'], atol=1e-9)
    np.testing.assert_allclose(found.motion.q, motion.q, atol=1e-9)
    np.testing.assert_allclose(found.motion.tau, motion.tau, atol=1e-12)


@pytest.mark.parametrize('start', [datetime.datetime(2026, 11, 22, 23, 59, 59, 990000), datetime.timedelta(0)])
def test_times_of_day_are_converted_to_seconds(tmp_path, start):
    book = openpyxl.Workbook()
    book.active.append(['t', 'q1', 'q2', 'tau1'])
    for k in range(60):
        book.active.append([start + datetime.timedelta(seconds=k / 100), 1, 2, 3])
    book.save(tmp_path / 'x.xlsx')
    np.testing.assert_allclose(read(tmp_path / 'x.xlsx').t, np.arange(60) / 100, atol=1e-12)
