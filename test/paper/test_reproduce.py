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

import matplotlib
import numpy as np
import pytest

from pendubot_identification.cli.main import main
from pendubot_identification.model.parameters import PAPER
from pendubot_identification.model.simulation import simulate
from pendubot_identification.paper import paper_figures, reproduction, trials
from test.conftest import ROOT

FIGURES = ('figure1', 'figure1_evaluations', 'dataset', 'fit', 'threshold', 'dimensions')
TABLES = ('table4', 'table4_order', 'table4_pace', 'table7', 'table8', 'threshold', 'operator')
TABLES += ('dimensions', 'dimensions_errors')
#: What is measured, and so differs.
TIMES = {'times.md', 'times.csv'}


def reproduce(*arguments):
    return main(['reproduce', *map(str, arguments)])


def status_of(*arguments):
    try:
        return reproduce(*arguments)
    except SystemExit as ended:
        return ended.code


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
    """The folder of a small reproduction, made while the user prefers another style."""
    folder = tmp_path_factory.mktemp('reproduced') / 'new' / 'paper'
    with pytest.MonkeyPatch.context() as monkeypatch, matplotlib.rc_context({'axes.facecolor': 'red'}):
        fewer(monkeypatch)
        assert reproduce('--runs', 2, '--seed', 3, '--output', folder) == 0
        assert matplotlib.rcParams['axes.facecolor'] == 'red'
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
    assert {'runs/competition.json', 'runs/sweep.json', 'figures/threshold.svg', 'figures/threshold.png'} <= set(again)
    assert {name for name in again if first[name] != again[name]} <= TIMES | {'index.md'}


def test_a_part_is_the_same_alone_in_another_process(everything, tmp_path):
    command = [sys.executable, '-m', 'pendubot_identification.cli.main', 'reproduce', '--only', 'table8,fit']
    alone = subprocess.run(
        [*command, '--runs', '2', '--seed', '3', '--output', str(tmp_path / 'alone')],
        cwd=ROOT,
        env=os.environ | {'PYTHONHASHSEED': '7'},
        timeout=200,
        capture_output=True,
        text=True,
    )
    assert (alone.returncode, alone.stderr) == (0, ''), 'no progress where nobody watches'
    assert str(tmp_path / 'alone' / 'index.md') in alone.stdout
    first, again = files(everything), files(tmp_path / 'alone')
    expected = {'index.md', 'runs/identification.json', 'tables/table8.md', 'tables/table8.csv'}
    assert set(again) == expected | {'figures/fit.svg', 'figures/fit.png'}
    assert all(again[name] == first[name] for name in again if name != 'index.md')


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


def test_true_parameters_balance_the_energy_of_a_motion_and_repeat_it_piece_by_piece():
    t = np.arange(2000) / 1000
    recorded = simulate(PAPER, t, np.column_stack([0.15 * np.sin(4 * t), 0 * t]))
    _, gained, received = paper_figures.energy_balance(recorded, PAPER.vector())
    assert np.abs(received - gained).max() < 0.01 * np.ptp(gained)
    _, gained, received = paper_figures.energy_balance(recorded, PAPER.vector() * [1.5, 1, 1, 1, 1, 1, 1])
    assert np.abs(received - gained).max() > 0.1 * np.ptp(gained)
    pieces = paper_figures.predicted(recorded, PAPER, 0.5)
    assert [len(piece) for piece in pieces] == [500] * 4
    np.testing.assert_allclose(np.concatenate([piece.t for piece in pieces]), recorded.t)
    assert np.abs(np.concatenate([piece.q for piece in pieces]) - recorded.q).max() < 0.01


def test_json_is_the_tables_and_nothing_else_and_a_folder_is_left_alone_unless_force_is_said(
    everything, tmp_path, capsys
):
    (tmp_path / 'index.md').write_text('mine')
    arguments = '--only', 'table8,dataset', '--runs', 2, '--json', '--output', tmp_path
    assert reproduce(*arguments) == 1
    assert 'exists already and is not empty' in capsys.readouterr().err
    assert files(tmp_path) == {'index.md': b'mine'}
    assert reproduce(*arguments, '--force') == 0
    assert (tmp_path / 'index.md').read_text().startswith('# The paper, reproduced')
    data = json.loads(capsys.readouterr().out)
    assert (data['seed'], data['runs'], data['figures']) == (1, 2, ['dataset'])
    rows = data['tables']['table8']['rows']
    assert [row[0] for row in rows] == ['P1', 'P2', 'P3', 'P4', 'P5', 'b1', 'b2']
    assert rows[0][2] == 0.002207
    assert rows[0][3] == pytest.approx(0.002207, rel=0.2)
    raws = [json.loads((folder / 'runs' / 'identification.json').read_text()) for folder in (tmp_path, everything)]
    assert raws[0]['theta_runs'] != raws[1]['theta_runs'], 'another seed'


@pytest.mark.parametrize(
    ('arguments', 'status', 'sentence'),
    [
        (['--runs', 0], 2, '0 runs were asked for; a number from 1 to 67 is expected'),
        (['--runs', 68], 2, 'a number from 1 to 67'),
        (['--seed', -1], 2, 'the seed is -1'),
        (['--output', '{}/file/out'], 1, 'cannot be written'),
        (['--only', 'table4,figure2'], 2, f"there is no 'figure2'; name some of {', '.join(reproduction.PARTS)}"),
    ],
)
def test_what_makes_no_sense_is_refused_and_nothing_is_written(tmp_path, capsys, arguments, status, sentence):
    (tmp_path / 'file').write_text('a file')
    arguments = [str(a).format(tmp_path) for a in arguments]
    if '--output' not in arguments:
        arguments += ['--output', str(tmp_path / 'out')]
    assert status_of(*arguments) == status
    assert sentence in ' '.join(capsys.readouterr().err.split())
    assert files(tmp_path) == {'file': b'a file'}


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
