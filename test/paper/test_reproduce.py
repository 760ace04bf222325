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
from dataclasses import replace

import pytest

from pendubot_identification.cli.main import main
from pendubot_identification.paper import trials
from pendubot_identification.paper.reproduce import PARTS
from test.conftest import ROOT

FIGURES = ('figure1', 'figure1_evaluations', 'dataset', 'fit', 'threshold', 'dimensions')
TABLES = ('table4', 'table4_order', 'table4_pace', 'table7', 'table8', 'threshold', 'operator')
TABLES += ('dimensions', 'dimensions_errors')
#: What is measured, and so differs.
TIMES = {'times.md', 'times.csv'}


def reproduce(*arguments):
    return main(['reproduce', *map(str, arguments)])


def files(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob('*') if path.is_file()}


def fewer(monkeypatch):
    """Every part in a few seconds: fewer runs, generations, thresholds and dimensions."""
    short = {name: how if name == 'PSO' else replace(how, generations=60) for name, how in trials.SETTINGS.items()}
    for name, value in {'MANY': 2, 'SETTINGS': short, 'SWEEP': 2, 'SWEEP_GENERATIONS': 100}.items():
        monkeypatch.setattr(trials, name, value)
    monkeypatch.setattr(trials, 'THRESHOLDS', (0.3, 1.0))
    monkeypatch.setattr(trials, 'DIMENSIONS', (2, 3))


@pytest.fixture(scope='module')
def everything(tmp_path_factory):
    folder = tmp_path_factory.mktemp('reproduced') / 'new' / 'paper'
    with pytest.MonkeyPatch.context() as monkeypatch:
        fewer(monkeypatch)
        assert reproduce('--runs', 2, '--seed', 3, '--output', folder) == 0
    return folder


def test_everything_lands_in_one_folder(everything):
    folder = everything
    expected = {'index.md', *TIMES}
    expected |= {f'figures/{name}.{ending}' for name in FIGURES for ending in ('png', 'svg')}
    expected |= {f'tables/{name}.{ending}' for name in TABLES for ending in ('md', 'csv')}
    expected |= {f'runs/{name}.json' for name in ('competition', 'identification', 'sweep', 'dimensions')}
    assert set(files(folder)) == expected
    index = (folder / 'index.md').read_text()
    assert 'pendubot reproduce --runs 2 --seed 3' in index
    assert 'Not finished' not in index
    for name in TABLES:
        assert (folder / 'tables' / f'{name}.md').read_text() in index
    for target in re.findall(r'\]\(([^)]+)\)', index):
        assert (folder / target).exists(), target


def test_the_same_seed_gives_the_same_bytes(everything, tmp_path, monkeypatch):
    fewer(monkeypatch)
    assert reproduce('--only', 'table4,threshold', '--runs', 2, '--seed', 3, '--output', tmp_path / 'again') == 0
    first, again = files(everything), files(tmp_path / 'again')
    assert {'runs/competition.json', 'runs/sweep.json', 'figures/threshold.svg'} <= set(again)
    assert {name for name in again if first[name] != again[name]} <= TIMES | {'index.md'}


def test_raw_runs_have_seeds_and_counts_and_the_tables_follow_from_them(everything):
    raw = json.loads((everything / 'runs' / 'competition.json').read_text())
    assert (raw['seed'], raw['runs'], raw['complete']) == (3, 2, True)
    rows = list(csv.DictReader((everything / 'tables' / 'table4.csv').open()))
    assert len(rows) == len({trial['seed'] for trial in raw['trials']}) == 16
    for row, trial in zip(rows, raw['trials'], strict=True):
        values = [run['value'] for run in trial['runs']]
        assert (row['function'], row['algorithm']) == (trial['function'], trial['algorithm'])
        assert len(values) == 4
        assert float(row['best']) == min(values[:2])
        assert float(row['average']) == pytest.approx(sum(values[:2]) / 2)
        assert int(row['reached, of 4']) == sum(value <= 1e-5 for value in values)


def test_a_part_is_the_same_alone_and_in_another_process_and_another_with_another_seed(tmp_path):
    folders = [tmp_path / name for name in ('one', 'two', 'three')]
    assert reproduce('--only', 'table7,table8', '--runs', 1, '--output', folders[0]) == 0
    command = [sys.executable, '-m', 'pendubot_identification.cli.main', 'reproduce', '--only', 'table8', '--runs', '1']
    again = subprocess.run(
        [*command, '--output', str(folders[1])],
        cwd=ROOT,
        env=os.environ | {'PYTHONHASHSEED': '7'},
        timeout=200,
        capture_output=True,
        text=True,
    )
    assert (again.returncode, again.stderr) == (0, ''), 'no progress where nobody watches'
    assert str(folders[1] / 'index.md') in again.stdout
    assert reproduce('--only', 'table8', '--runs', 1, '--seed', 2, '--output', folders[2]) == 0
    among, alone, other = map(files, folders)
    assert set(alone) == {'index.md', 'runs/identification.json', 'tables/table8.md', 'tables/table8.csv'}
    assert all(alone[name] == among[name] for name in alone if name != 'index.md')
    assert other['runs/identification.json'] != alone['runs/identification.json']


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


def test_an_interrupt_keeps_what_is_done(tmp_path, monkeypatch, capsys):
    """Ctrl-C in the third trial of the sweep."""
    fewer(monkeypatch)
    minimise, calls = trials.mde, []

    def interrupted(*arguments, **options):
        calls.append(arguments)
        if len(calls) == 3:
            signal.raise_signal(signal.SIGINT)
        return minimise(*arguments, **options)

    monkeypatch.setattr(trials, 'mde', interrupted)
    folder = tmp_path / 'out'
    assert reproduce('--only', 'dataset,threshold', '--runs', 1, '--output', folder) == 1
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert f'interrupted; what is done is kept in {folder}: dataset. For the rest' in line
    index = (folder / 'index.md').read_text()
    assert 'Not finished:** threshold' in index
    assert 'figures/dataset.png' in index
    assert (folder / 'figures' / 'dataset.png').exists()
    sweep = json.loads((folder / 'runs' / 'sweep.json').read_text())
    assert (sweep['complete'], len(sweep['trials'])) == (False, 2)


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
