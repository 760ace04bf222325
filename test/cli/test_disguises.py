# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""One recording in many formats and conventions: following the messages gives the parameters of the original."""

import json
import shlex
from functools import partial

import numpy as np
import pytest
import scipy.io

from pendubot_identification.identification.pipeline import identify
from pendubot_identification.identification.settings import Settings
from pendubot_identification.recordings.bag_reader import read_trajectory
from pendubot_identification.trajectories.trajectory import Trajectory
from test.conftest import ROOT
from test.simulated_rig import Rig, record

pandas, openpyxl, _ = map(pytest.importorskip, ('pandas', 'openpyxl', 'pyarrow'))

BAG = ROOT / 'bags' / 'paper_experiment'
QUICK = ('--criterion', 'weak', '--model', 'viscous', '--optimizer', 'lsq', '--hold', 'zero', '--delay', '0', '--json')


def as_text(file, columns, **how):
    pandas.DataFrame(columns).to_csv(file, index=False, **how)


def excel(file, columns, **how):
    pandas.DataFrame(columns).to_excel(file, index=False, **how)


def excel_as_text(file, columns):
    excel(file, {name: [str(x).replace('.', ',') for x in values.tolist()] for name, values in columns.items()})


def parquet(file, columns):
    pandas.DataFrame(columns).to_parquet(file)


def matlab_struct(file, columns):
    scipy.io.savemat(file, {'remark': 'Monday', 'run': {**columns, 'gain': 3.0}}, oned_as='column')


def stacked(columns):
    return {'t': columns['t'], 'q': np.column_stack([columns['q1'], columns['q2']]), 'tau': columns['tau1']}


def with_missing_rows(file, columns):
    """Write rows without values, as a logger does without data."""
    as_text(file, columns)
    lines = file.read_text().splitlines()
    for k, row in ((700, ',,,'), (300, '{t},nan,NaN,nan'), (10, '#N/A,#N/A,#N/A,#N/A')):
        lines.insert(k, row.format(t=3.0))
    file.write_text('\n'.join(lines))


def named(*names, **how):
    """Return a function that writes text with these column names."""
    return lambda file, columns: as_text(file, columns, header=list(names), **how)


def lines_above(*lines, names=True):
    """Return a function that writes text below other lines, with or without column names."""

    def write(file, columns):
        as_text(file, columns, header=names)
        file.write_text('\n'.join([*lines, file.read_text()]))

    return write


def sheet_with_a_title(file, columns):
    """Write a second sheet with a title above the names and units below them."""
    book = openpyxl.Workbook()
    book.active.append(['Protokoll'])
    sheet = book.create_sheet('Messung 1')
    for row in (['Pendel A'], list(columns), UNITS, *np.column_stack(list(columns.values())).tolist()):
        sheet.append(row)
    book.save(file)


def repeated(file, columns):
    """Write some rows twice, like a logger that is faster than the rig."""
    rows = np.sort([*range(900), 17, 300, 301])
    as_text(file, {name: values[rows] for name, values in columns.items()})


def dates(columns, how='%Y-%m-%dT%H:%M:%S.%f'):
    first = pandas.Timestamp('2026-05-12 10:00:00')
    return (first + pandas.to_timedelta((1e6 * columns['t']).round(), unit='us')).strftime(how)


UNITS = 'ms', 'deg', 'deg', 'mNm'
DEGREES = {'q1': lambda c: np.degrees(c['q1']), 'q2': lambda c: np.degrees(c['q2'])}
ALL_UNITS = DEGREES | {'t': lambda c: 1000 * c['t'], 'tau1': lambda c: 1000 * c['tau1']}
HANGING = {'q1': lambda c: np.degrees(c['q1'] + np.pi / 2), 'q2': lambda c: np.degrees(c['q2'])}
#: By file name: function that writes the file, changes of the columns, and the options that the messages name.
VARIANTS = {
    'matrices.mat': (lambda file, c: scipy.io.savemat(file, stacked(c), oned_as='row'), {}, []),
    'struct.mat': (matlab_struct, {}, []),
    'absolute elbow.csv': (as_text, {'q2': lambda c: c['q1'] + c['q2']}, ['--elbow absolute']),
    'flipped elbow.csv': (as_text, {'q2': lambda c: -c['q2']}, ['--negate q2']),
    'missing rows.csv': (with_missing_rows, {}, ['--skip-missing']),
    'flipped torque.csv': (as_text, {'tau1': lambda c: -c['tau1']}, ['--negate tau1,tau2']),
    'exchanged.csv': (as_text, {'q1': lambda c: c['q2'], 'q2': lambda c: c['q1']}, ['--swap positions']),
    'other names.tsv': (named('Time', 'theta1', 'theta2', 'u', sep='\t'), {}, []),
    'names of four languages.csv': (named('Zeit [s]', 'angle épaule', 'ángulo codo', '力矩'), {}, []),
    'Latin-1.csv': (named('t', 'Winkel Schulter', 'Winkel Ellenbogen [°]', 'tau', encoding='latin-1'), DEGREES, []),
    'UTF-16 without a mark.csv': (named('t', 'q1', 'q2', 'tau', encoding='utf-16-le'), {}, []),
    'units in names.csv': (named('t_ms', 'q1 [deg]', 'q2 [deg]', 'tau (mNm)'), ALL_UNITS, []),
    'a row of units.csv': (lines_above('t,q1,q2,tau1', 'ms,deg,deg,mNm', names=False), ALL_UNITS, []),
    'a title.csv': (lines_above('Run 7, Monday', 'second try'), {}, ['--skip-rows 2']),
    'no usual names.csv': (named('c1', 'c2', 'c3', 'c4'), {}, ['--columns t=c1,q1=c2,q2=c3,tau1=c4']),
    'a title on a second sheet.xlsx': (sheet_with_a_title, ALL_UNITS, ["--sheet 'Messung 1'", '--skip-rows 1']),
    'no names.xlsx': (partial(excel, header=False), {}, ['--columns t=1,q1=2,q2=3,tau1=4']),
    'decimal commas.xlsx': (excel_as_text, {}, ['--decimal comma']),
    'dates as text.xlsx': (excel, {'t': dates}, []),
    'German dates.csv': (as_text, {'t': partial(dates, how='%d.%m.%Y %H:%M:%S.%f')}, []),
    'dates in UTC.parquet': (parquet, {'t': lambda c: pandas.to_datetime(dates(c) + 'Z')}, []),
    'seconds since 1970.csv': (as_text, {'t': lambda c: 1.7e9 + c['t']}, []),
    'packed.csv.gz': (as_text, {}, []),
    'matrix.npz': (lambda file, c: np.savez(file, **stacked(c)), {}, []),
    'column vectors.npz': (lambda file, c: np.savez(file, **{n: x[:, None] for n, x in c.items()}), {}, []),
    'wrapped degrees.csv': (
        as_text,
        DEGREES | {'q1': lambda c: (np.degrees(c['q1']) + 115) % 360 - 115},
        ['--unwrap', '--degrees'],
    ),
    'repeated times.csv': (repeated, {}, []),
    'all at once.csv': (
        partial(as_text, sep=';', decimal=','),
        {**HANGING, 't': lambda c: 1e6 * c['t'], 'tau1': lambda c: 1000 * c['tau1']},
        ['--decimal comma', '--time-unit us', '--degrees', '--torque-unit mNm', '--zero hanging'],
    ),
}


@pytest.fixture(scope='module')
def columns():
    motion = read_trajectory(BAG).trajectory[:900]
    return {'t': motion.t.round(6), 'q1': motion.q[:, 0], 'q2': motion.q[:, 1], 'tau1': motion.tau[:, 0]}


@pytest.fixture
def identified(run):
    """Identifies a file; returns the result."""

    def identified(file, *options):
        status, out, err = run('identify', file, *QUICK, *options)
        assert status in (0, 3), err
        return json.loads(out)

    return identified


@pytest.fixture
def lab(columns, tmp_path, monkeypatch):
    """The working directory, with a file in the conventions of a lab."""
    monkeypatch.chdir(tmp_path)
    change = {name: convert(columns) for name, convert in HANGING.items()}
    as_text(tmp_path / 'run.csv', columns | change, header=['time', 'a', 'b', 'u'])


LABS = ('--columns', 't=time,q1=a,q2=b,tau1=u', '--degrees', '--zero', 'hanging')


def test_a_labs_conventions_are_taken_from_a_result(lab, run, identified, expected):
    assert run('identify', 'run.csv', *LABS, *QUICK, '--output', 'lab.yaml')[0] == 0
    np.testing.assert_allclose(theta(identified('run.csv', '--settings', 'lab.yaml')), expected, rtol=1e-6)
    assert run('import', 'run.csv', '--output', 'bag', '--settings', 'lab.yaml')[0] == 0
    # Options also apply to bags, and are added to saved settings.
    bag = identified('bag', '--negate', 'q2')
    table = identified('run.csv', '--settings=lab.yaml', '--negate=q2')
    np.testing.assert_allclose(theta(bag), theta(table), rtol=1e-6)


def test_a_result_serves_as_settings_file_for_its_recordings(lab, run):
    assert run('identify', 'run.csv', *LABS[:2], '--apply-remedies', '--output', 'result.yaml', *QUICK)[0] == 0
    assert run('report', 'result.yaml')[2] == '', 'the report must be complete'
    same = ('--settings', 'result.yaml')
    assert run('compare', 'result.yaml', 'result_report/result.yaml', '--on', 'run.csv', *same)[0] == 0
    kept = run('identify', 'run.csv', *same, *QUICK)
    assert json.loads(kept[1])['reading']['zero'] == 'hanging'


def test_an_empty_option_in_a_settings_file_has_its_default(lab, run, tmp_path):
    (tmp_path / 'empty.yaml').write_text('degrees: true\nsheet:\noffset:\n')
    found = json.loads(run('info', 'run.csv', *LABS[:2], '--settings', 'empty.yaml', '--json')[1])
    assert found['read_with'] == ['--columns t=time,q1=a,q2=b,tau1=u', '--degrees']


def test_info_shows_columns_rate_and_conversion_of_a_file(lab, run):
    found = json.loads(run('info', 'run.csv', *LABS[:2], '--json')[1])
    assert found['columns'] == {'t': 'time', 'q1': 'a', 'q2': 'b', 'tau1': 'u'}
    assert (found['samples'], round(found['rate'], 1), found['gaps']) == (900, 100.0, 0)
    text = run('info', 'run.csv', *LABS)[1]
    assert text.startswith('run.csv: 900 samples, 8.990 s, 100.0 Hz\n')
    assert 'read      --columns t=time,q1=a,q2=b,tau1=u --degrees --zero hanging\n' in text


def theta(result):
    return [entry['value'] for entry in result['parameters'].values()]


@pytest.fixture(scope='module')
def expected(columns):
    """Parameters identified from the motion in memory."""
    t, q1, q2, tau1 = columns.values()
    motion = Trajectory(t, np.column_stack([q1, q2]), np.column_stack([tau1, 0 * tau1]))
    settings = Settings(('weak',), 'viscous', optimizer='lsq', hold='zero', delays=(0.0, 0.0))
    return identify([motion[:450]], [motion[450:]], settings).best.theta


@pytest.mark.parametrize('name', VARIANTS)
def test_following_the_messages_gives_the_same_parameters(columns, identified, expected, run, tmp_path, name):
    write, change, named = VARIANTS[name]
    write(tmp_path / name, columns | {each: convert(columns) for each, convert in change.items()})
    following = []
    while left := [option for option in named if option not in following]:
        _, out, err = run('identify', tmp_path / name, '--check', *shlex.split(' '.join(following)))
        message = ' '.join((out + err).split())
        following += (advised := [option for option in left if option in message])
        assert advised, message
    found = identified(tmp_path / name, '--apply-remedies')
    np.testing.assert_allclose(theta(found), expected, rtol=1e-6)
    assert sorted(found['made_by']['applied']) == sorted(named)
    assert len({*found['warnings']}) == len(found['warnings'])
    assert any('applied corrections of the recordings' in warning for warning in found['warnings']) == bool(named)


def test_a_wrong_zero_that_stops_the_filter_is_named_and_a_rest_is_located(run, tmp_path):
    (motion,) = record([11], [Rig()], seconds=6.0, step=0.0025)
    from_hanging, resting = np.add(motion.q, [np.pi / 2, 0]), np.where(motion.t[:, None] < 3, [-np.pi / 2, 0], motion.q)
    for name, q in (('hanging.csv', from_hanging), ('resting.csv', resting)):
        as_text(tmp_path / name, {'t': motion.t, 'q1': q[:, 0], 'q2': q[:, 1], 'tau1': motion.tau})
    status, _, err = run('identify', tmp_path / 'hanging.csv')
    assert (status, 'add --zero hanging' in err) == (1, True)
    assert run('identify', tmp_path / 'hanging.csv', '--apply-remedies')[0] == 0
    assert 'resting.csv, 0 to 2.995 s: the joints moved by only' in run('identify', tmp_path / 'resting.csv')[2]
