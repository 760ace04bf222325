# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""One recording in many disguises: identified as from its bag by following what the program says, and by itself."""

import json
import re
import shlex

import numpy as np
import pytest
import scipy.io

from pendubot_identification.recordings.bag_reader import read_trajectory
from test.conftest import ROOT

BAG = ROOT / 'bags' / 'paper_experiment'
QUICK = ('--criterion', 'weak', '--model', 'viscous', '--optimizer', 'lsq', '--hold', 'zero', '--delay', '0', '--json')


def as_text(file, columns, delimiter=','):
    rows = zip(*(np.asarray(values).tolist() for values in columns.values()), strict=True)
    lines = [delimiter.join(columns), *(delimiter.join(map(repr, row)) for row in rows)]
    file.write_text('\n'.join(lines))


def with_decimal_commas(file, columns):
    as_text(file, columns, ';')
    file.write_text(file.read_text().replace('.', ','))


def matlab_struct(file, columns):
    scipy.io.savemat(file, {'remark': 'Monday', 'run': {**columns, 'gain': 3.0}}, oned_as='column')


def matlab_matrices(file, columns):
    """q with two columns, and times in a row."""
    q = np.column_stack([columns['q1'], columns['q2']])
    scipy.io.savemat(file, {'t': columns['t'], 'q': q, 'tau1': columns['tau1'][:, None]}, oned_as='row')


def matlab_73(file, columns):
    h5py = pytest.importorskip('h5py')
    with h5py.File(file, 'w', userblock_size=512) as hdf:
        hdf.create_group('#refs#')
        for name, values in columns.items():
            hdf.create_dataset(f'run/{name}', data=np.asarray(values)[None, :]).attrs['MATLAB_class'] = b'double'
    with file.open('r+b') as stream:
        stream.write(b'MATLAB 7.3 MAT-file'.ljust(124) + b'\0\2IM')


def excel(file, columns):
    book = pytest.importorskip('openpyxl').Workbook()
    for row in (list(columns), *zip(*(values.tolist() for values in columns.values()), strict=True)):
        book.active.append(row)
    book.save(file)


def parquet(file, columns):
    pyarrow = pytest.importorskip('pyarrow')
    from pyarrow.parquet import write_table

    write_table(pyarrow.table(columns), file)


def with_missing_rows(file, columns):
    """Rows that a logger wrote when nothing had come."""
    as_text(file, columns)
    lines = file.read_text().splitlines()
    for k, row in ((700, ',,,'), (300, '{t},nan,NaN,nan'), (10, '#N/A,#N/A,#N/A,#N/A')):
        lines.insert(k, row.format(t=3.0))
    file.write_text('\n'.join(lines))


HANGING = {'q1': lambda c: np.degrees(c['q1'] + np.pi / 2), 'q2': lambda c: np.degrees(c['q2'])}
#: How the file is made, what is done to its columns before, and the options that the program names.
DISGUISES = {
    'matrices.mat': (matlab_matrices, {}, []),
    'struct.mat': (matlab_struct, {}, []),
    'version 7.3.mat': (matlab_73, {}, []),
    'sheet.xlsx': (excel, {}, []),
    'run.parquet': (parquet, {}, []),
    'decimal commas.csv': (with_decimal_commas, {}, ['--decimal comma']),
    'milliseconds.csv': (as_text, {'t': lambda c: 1000 * c['t']}, ['--time-unit ms']),
    'degrees from hanging.csv': (as_text, HANGING, ['--degrees', '--zero hanging']),
    'absolute elbow.csv': (as_text, {'q2': lambda c: c['q1'] + c['q2']}, ['--elbow absolute']),
    'flipped elbow.csv': (as_text, {'q2': lambda c: -c['q2']}, ['--negate q2']),
    'millinewtonmetres.txt': (as_text, {'tau1': lambda c: 1000 * c['tau1']}, ['--torque-unit mNm']),
    'missing rows.csv': (with_missing_rows, {}, ['--skip-missing']),
    # Beyond the twelve.
    'flipped torque.csv': (as_text, {'tau1': lambda c: -c['tau1']}, ['--negate tau1,tau2']),
    'exchanged.csv': (as_text, {'q1': lambda c: c['q2'], 'q2': lambda c: c['q1']}, ['--swap positions']),
    'hanging.csv': (as_text, {'q1': lambda c: c['q1'] + np.pi / 2}, ['--zero hanging']),
    'other names.tsv': (
        lambda file, c: as_text(file, dict(zip(('Time', 'theta1', 'theta2', 'u'), c.values(), strict=True)), '\t'),
        {},
        ['--columns t=Time,q1=theta1,q2=theta2,tau1=u'],
    ),
    'all at once.csv': (
        with_decimal_commas,
        {**HANGING, 't': lambda c: 1e6 * c['t'], 'tau1': lambda c: 1000 * c['tau1']},
        ['--decimal comma', '--time-unit us', '--degrees', '--torque-unit mNm', '--zero hanging'],
    ),
}


@pytest.fixture(scope='module')
def columns():
    motion = read_trajectory(BAG).trajectory[:900]
    return {'t': motion.t, 'q1': motion.q[:, 0], 'q2': motion.q[:, 1], 'tau1': motion.tau[:, 0]}


@pytest.fixture
def identified(run):
    """Identifies; returns the result, or, where that is refused, the sentence."""

    def identified(file, *options):
        status, out, err = run('identify', file, *QUICK, *options)
        assert (status, bool(out)) in ((0, True), (3, True), (1, False))
        return json.loads(out) if out else err

    return identified


@pytest.fixture
def lab(columns, tmp_path, monkeypatch):
    """A folder with a file in the ways of a lab, entered."""
    monkeypatch.chdir(tmp_path)
    change = {name: made(columns) for name, made in HANGING.items()}
    as_text(tmp_path / 'run.csv', dict(zip(('time', 'a', 'b', 'u'), (columns | change).values(), strict=True)))
    return tmp_path


LABS = ('--columns', 't=time,q1=a,q2=b,tau1=u', '--degrees', '--zero', 'hanging')


def test_how_a_lab_records_is_said_once(lab, run, identified, expected):
    assert run('info', 'run.csv', *LABS, '--save-map', 'lab.yaml')[0] == 0
    assert run('info', 'run.csv', *LABS, '--save-map', 'lab.yaml')[0] == 1, 'nothing is overwritten'
    np.testing.assert_allclose(theta(identified('run.csv', '--map', 'lab.yaml')), expected, rtol=1e-6)
    assert run('import', 'run.csv', '--output', 'bag', '--map', 'lab.yaml')[0] == 0
    np.testing.assert_allclose(theta(identified('bag')), expected, rtol=1e-6)
    # A bag is read in other ways, too, and what is typed counts for more than what was kept.
    bag = identified('bag', '--negate', 'q2')
    np.testing.assert_allclose(theta(bag), theta(identified('run.csv', '--map=lab.yaml', '--negate=q2')), rtol=1e-6)


def test_a_result_keeps_how_its_recordings_were_read(lab, run):
    assert run('identify', 'run.csv', *LABS[:2], '--apply-remedies', '--output', 'result.yaml', *QUICK)[0] == 0
    assert run('report', 'result.yaml')[2] == '', 'nothing is left out'
    assert run('compare', 'result.yaml', 'result_report/result.yaml', '--on', 'run.csv', '--map', 'result.yaml')[0] == 0
    kept = run('identify', 'run.csv', '--map', 'result.yaml', *QUICK)
    assert json.loads(kept[1])['reading']['zero'] == 'hanging'


def test_what_is_taken_of_a_file_is_said_and_what_looks_odd(lab, run):
    status, out, _ = run('info', 'run.csv', *LABS[:2], '--json')
    found = json.loads(out)
    assert (status, found['columns']) == (0, {'t': 'time', 'q1': 'a', 'q2': 'b', 'tau1': 'u'})
    assert (found['samples'], round(found['rate'], 1), found['gaps']) == (900, 100.0, 0)
    assert any('--degrees?' in guess for guess in found['guesses'])
    text = run('info', 'run.csv', *LABS)[1]
    assert text.startswith('run.csv: 900 samples, 8.990 s, 100.0 Hz\n')
    assert 'looks odd' not in text
    assert '--zero hanging?' in run('info', 'run.csv', *LABS[:3])[1]


@pytest.mark.parametrize(
    ('command', 'sentence'),
    [
        (('identify', BAG, '--columns', 't=x'), '--columns t=x is for files with columns; the stamps of a bag'),
        (('info', BAG, '--degrees'), 'info says what is in it, not what it means; leave out --degrees'),
        (('info', 'run.csv', '--map', 'none.yaml'), 'none.yaml cannot be read (No such file or directory)'),
        (('info', 'run.csv', '--map', 'run.csv'), 'run.csv names no options'),
        (('import', BAG, '--output', 'x'), 'is no file with columns; one whose name ends in .csv'),
    ],
)
def test_what_cannot_be_read_so_is_refused(lab, refused, command, sentence):
    assert sentence in refused(*command, status=2)


def theta(result):
    return [entry['value'] for entry in result['parameters'].values()]


@pytest.fixture(scope='module')
def expected(columns, tmp_path_factory):
    """Parameters from a bag."""
    from pendubot_identification.identify.pipeline import identify
    from pendubot_identification.identify.settings import Settings
    from pendubot_identification.trajectories.trajectory import Trajectory

    zeros = np.zeros(900)
    motion = Trajectory(
        columns['t'],
        np.column_stack([columns['q1'], columns['q2']]),
        np.column_stack([columns['tau1'], zeros]),
    )
    settings = Settings(('weak',), 'viscous', optimizer='lsq', hold='zero', delays=(0.0, 0.0))
    return identify([motion[:450]], [motion[450:]], settings).best.theta


@pytest.mark.parametrize('name', DISGUISES)
def test_a_disguise_is_seen_through(columns, identified, expected, tmp_path, name):
    write, change, options = DISGUISES[name]
    file = tmp_path / name
    write(file, columns | {each: made(columns) for each, made in change.items()})
    found = identified(file)
    if options:
        # A refusal, or faults: what is said of the first of them ends with the option that mends it.
        said = found if isinstance(found, str) else found['warnings'][0]
        assert re.search(f'(add|with) {re.escape(options[0])}', ' '.join(said.split())), said
        assert isinstance(found, str) or found['level'] == 'ERROR'
        found = identified(file, '--apply-remedies')
    np.testing.assert_allclose(theta(found), expected, rtol=1e-6)
    assert sorted(found['made_by']['applied']) == sorted(options)
    assert any('applied, as the recordings need it' in said for said in found['warnings']) == bool(options)


@pytest.mark.parametrize('name', ['decimal commas.csv', 'flipped elbow.csv', 'degrees from hanging.csv'])
def test_what_is_said_mends_it_when_it_is_typed(columns, identified, expected, tmp_path, name):
    write, change, options = DISGUISES[name]
    write(tmp_path / name, columns | {each: made(columns) for each, made in change.items()})
    found = identified(tmp_path / name, *shlex.split(' '.join(options)))
    np.testing.assert_allclose(theta(found), expected, rtol=1e-6)
    assert found['made_by']['applied'] == []
