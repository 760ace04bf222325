# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""pendubot reproduce from outside: files, the same bytes every time, and one sentence for each mistake."""

import csv
import json
import os
import re
import signal
import subprocess
import sys
import time

import pytest

from pendubot_identification.cli.main import main
from pendubot_identification.paper import trials
from pendubot_identification.paper.reproduce import PARTS
from test.conftest import ROOT

COMMAND = [sys.executable, '-m', 'pendubot_identification.cli.main']
FIGURES = ('figure1', 'figure1_evaluations', 'dataset', 'fit', 'threshold', 'dimensions')
TABLES = ('table4', 'table4_order', 'table4_pace', 'table7', 'table8', 'threshold', 'operator')
TABLES += ('dimensions', 'dimensions_errors')
#: What is measured, and so differs.
TIMES = {'times.md', 'times.csv'}


@pytest.fixture
def smaller(monkeypatch):
    """Every part, in a few seconds."""
    monkeypatch.setattr(trials, 'THRESHOLDS', (0.3, 1.0))
    monkeypatch.setattr(trials, 'DIMENSIONS', (2, 3))
    monkeypatch.setattr(trials, 'SWEEP_GENERATIONS', 100)


def reproduce(*arguments):
    return main(['reproduce', *map(str, arguments)])


def files(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob('*') if path.is_file()}


def test_everything_lands_in_one_folder(smaller, tmp_path, capsys):
    folder = tmp_path / 'new' / 'paper'
    assert reproduce('--runs', 1, '--seed', 3, '--output', folder) == 0
    captured = capsys.readouterr()
    assert captured.err == '', 'no progress where nobody watches'
    assert str(folder / 'index.md') in captured.out
    expected = {'index.md', *TIMES}
    expected |= {f'figures/{name}.{ending}' for name in FIGURES for ending in ('png', 'svg')}
    expected |= {f'tables/{name}.{ending}' for name in TABLES for ending in ('md', 'csv')}
    expected |= {f'runs/{name}.json' for name in ('competition', 'identification', 'sweep', 'dimensions')}
    assert set(files(folder)) == expected
    index = (folder / 'index.md').read_text()
    assert 'pendubot reproduce --runs 1 --seed 3' in index
    assert 'Not finished' not in index
    for name in TABLES:
        assert (folder / 'tables' / f'{name}.md').read_text() in index
    for target in re.findall(r'\]\(([^)]+)\)', index):
        assert (folder / target).exists(), target


def test_raw_runs_have_seeds_and_counts_and_the_tables_follow_from_them(tmp_path):
    assert reproduce('--only', 'table4', '--runs', 2, '--output', tmp_path / 'out') == 0
    raw = json.loads((tmp_path / 'out' / 'runs' / 'competition.json').read_text())
    assert (raw['seed'], raw['runs'], raw['complete']) == (1, 2, True)
    rows = list(csv.DictReader((tmp_path / 'out' / 'tables' / 'table4.csv').open()))
    assert len(rows) == len(raw['trials']) == 16
    assert len({trial['seed'] for trial in raw['trials']}) == 16
    for row, trial in zip(rows, raw['trials'], strict=True):
        values = [run['value'] for run in trial['runs']]
        assert (row['function'], row['algorithm']) == (trial['function'], trial['algorithm'])
        assert len(values) == 20
        assert float(row['best']) == min(values[:2])
        assert float(row['average']) == pytest.approx(sum(values[:2]) / 2)
        assert int(row['reached, of 20']) == sum(value <= 1e-5 for value in values)


def test_the_same_seed_gives_the_same_bytes_in_another_process(tmp_path):
    options = ['--only', 'table4,figure1,table8,fit', '--runs', '1']
    assert reproduce(*options, '--output', tmp_path / 'one') == 0
    env = os.environ | {'PYTHONHASHSEED': '7'}
    again = subprocess.run(
        [*COMMAND, 'reproduce', *options, '--output', str(tmp_path / 'two')],
        cwd=ROOT,
        env=env,
        timeout=200,
        check=False,
    )
    assert again.returncode == 0
    first, second = files(tmp_path / 'one'), files(tmp_path / 'two')
    assert set(first) == set(second)
    assert {name for name in first if first[name] != second[name]} <= TIMES
    assert reproduce('--only', 'table8', '--runs', 1, '--seed', 2, '--output', tmp_path / 'other') == 0
    other = files(tmp_path / 'other')
    assert other['runs/identification.json'] != first['runs/identification.json']


def test_a_part_is_the_same_alone_as_among_others(tmp_path):
    assert reproduce('--only', 'table8', '--runs', 1, '--output', tmp_path / 'one') == 0
    assert reproduce('--only', 'table7,table8', '--runs', 1, '--output', tmp_path / 'two') == 0
    one, two = files(tmp_path / 'one'), files(tmp_path / 'two')
    assert set(one) == {'index.md', 'runs/identification.json', 'tables/table8.md', 'tables/table8.csv'}
    assert all(one[name] == two[name] for name in one if name != 'index.md')


def test_json_is_the_tables_and_nothing_else(tmp_path, capsys):
    assert reproduce('--only', 'table8,dataset', '--runs', 1, '--output', tmp_path / 'out', '--json') == 0
    data = json.loads(capsys.readouterr().out)
    assert (data['seed'], data['runs'], data['figures']) == (1, 1, ['dataset'])
    rows = data['tables']['table8']['rows']
    assert [row[0] for row in rows] == ['P1', 'P2', 'P3', 'P4', 'P5', 'b1', 'b2']
    assert rows[0][2] == 0.002207
    assert rows[0][3] == pytest.approx(0.002207, rel=0.2)


def test_a_folder_that_exists_is_left_alone_unless_force_is_said(tmp_path, capsys):
    folder = tmp_path / 'mine'
    folder.mkdir()
    (folder / 'index.md').write_text('mine')
    assert reproduce('--only', 'dataset', '--runs', 1, '--output', folder) == 1
    assert 'exists already and holds something, and was left as it is' in capsys.readouterr().err
    assert files(folder) == {'index.md': b'mine'}
    assert reproduce('--only', 'dataset', '--runs', 1, '--output', folder, '--force') == 0
    assert (folder / 'index.md').read_text().startswith('# The paper, reproduced')


@pytest.mark.parametrize(
    ('arguments', 'status', 'sentence'),
    [
        (['--runs', 0], 2, '0 runs were asked for; a number from 1 to 67 is expected'),
        (['--runs', -3], 2, '-3 runs were asked for'),
        (['--runs', 68], 2, 'a number from 1 to 67'),
        (['--seed', -1], 2, 'the seed is -1'),
        (['--output', '{}/file/out'], 1, 'cannot be written'),
        (['--output', '/proc/out'], 1, 'cannot be written'),
        (['--output', '{}/file', '--force'], 1, 'cannot be written'),
    ],
)
def test_what_makes_no_sense_is_refused_and_nothing_is_written(tmp_path, capsys, arguments, status, sentence):
    (tmp_path / 'file').write_text('a file')
    arguments = [str(a).format(tmp_path) for a in arguments]
    if '--output' not in arguments:
        arguments += ['--output', str(tmp_path / 'out')]
    assert reproduce(*arguments) == status
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert line.startswith('pendubot: ')
    assert sentence in line
    assert files(tmp_path) == {'file': b'a file'}
    assert not (tmp_path / 'out').exists()


@pytest.mark.parametrize('name', ['table5', 'figure2', ''])
def test_an_unknown_table_or_figure_is_wrong_usage(tmp_path, capsys, name):
    with pytest.raises(SystemExit) as refused:
        reproduce('--only', f'table4,{name}', '--output', tmp_path / 'out')
    assert refused.value.code == 2
    assert f"there is no '{name}'; name some of {', '.join(PARTS)}" in ' '.join(capsys.readouterr().err.split())
    assert not (tmp_path / 'out').exists()


def test_an_interrupt_keeps_what_is_done(tmp_path):
    folder = tmp_path / 'out'
    options = ['--only', 'dataset,threshold', '--runs', '67', '--output', str(folder)]
    process = subprocess.Popen([*COMMAND, 'reproduce', *options], cwd=ROOT, stderr=subprocess.PIPE, text=True)
    end = time.monotonic() + 120
    while not (folder / 'figures' / 'dataset.svg').exists() and process.poll() is None and time.monotonic() < end:
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=120)
    assert process.returncode == 1
    assert 'interrupted; what is done is kept in' in err
    assert 'Traceback' not in err
    index = (folder / 'index.md').read_text()
    assert 'Not finished:** threshold' in index
    assert 'figures/dataset.png' in index
    assert (folder / 'figures' / 'dataset.png').exists()
    if (folder / 'runs' / 'sweep.json').exists():
        assert json.loads((folder / 'runs' / 'sweep.json').read_text())['complete'] is False


def test_neither_help_nor_info_waits_for_matplotlib_or_scipy():
    code = (
        'import sys\n'
        'from pendubot_identification.cli.main import main, parser\n'
        'parser().format_help()\n'
        f'assert main(["info", {str(ROOT / "bags" / "paper_experiment")!r}]) == 0\n'
        'try:\n'
        '    main(["reproduce", "--help"])\n'
        'except SystemExit:\n'
        '    pass\n'
        'assert not {"matplotlib", "scipy"} & set(sys.modules), sorted(sys.modules)\n'
    )
    result = subprocess.run([sys.executable, '-c', code], cwd=ROOT, capture_output=True, text=True, timeout=100)
    assert result.returncode == 0, result.stderr
