# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The command pendubot reproduce: its files, its reproducibility, and its error messages."""

import re
import signal
from dataclasses import replace

import matplotlib
import pytest

from pendubot_identification.cli.main import main
from pendubot_identification.paper import trials
from test.cli.conftest import contents

TABLES = ('table4', 'table4_order', 'table4_pace', 'table7', 'table8', 'threshold', 'operator')
#: Files of measured times, which differ between runs.
TIMES = {'times.md', 'times.csv'}


def shorten(monkeypatch):
    """Reduce runs, generations and thresholds, so that every part takes seconds."""
    short = {name: replace(how, generations=60) for name, how in trials.SETTINGS.items()}
    for name, value in {'MANY': 2, 'SETTINGS': short, 'SWEEP': 2, 'SWEEP_GENERATIONS': 100}.items():
        monkeypatch.setattr(trials, name, value)
    monkeypatch.setattr(trials, 'THRESHOLDS', (0.3, 1.0))


@pytest.fixture(scope='module')
def reproduced(tmp_path_factory):
    """Return the folder of a short reproduction, under another matplotlib style of the user."""
    folder = tmp_path_factory.mktemp('reproduced') / 'new' / 'paper'
    with pytest.MonkeyPatch.context() as monkeypatch, matplotlib.rc_context({'axes.facecolor': 'red'}):
        shorten(monkeypatch)
        assert main(['reproduce', '--runs', '2', '--seed', '3', '--output', str(folder)]) == 0
    return folder


def test_all_files_are_written_to_one_folder(reproduced):
    expected = {'index.md', *TIMES, 'figures', 'tables', 'figures/figure1.png', 'figures/figure1.svg'}
    expected |= {f'tables/{name}.{ending}' for name in TABLES for ending in ('md', 'csv')}
    assert set(contents(reproduced)) == expected
    index = (reproduced / 'index.md').read_text()
    assert 'pendubot reproduce --runs 2 --seed 3' in index
    assert 'Not finished' not in index
    for name in TABLES:
        assert (reproduced / 'tables' / f'{name}.md').read_text() in index
    for target in re.findall(r'\]\(([^)]+)\)', index):
        assert (reproduced / target).exists(), target


def test_the_same_seed_gives_the_same_bytes_also_for_single_parts(reproduced, tmp_path, monkeypatch, run):
    shorten(monkeypatch)
    parts = ('--only', 'figure1,table8,threshold', '--seed', '3', '--output', tmp_path)
    (tmp_path / 'index.md').write_text('mine')
    status, _, err = run('reproduce', '--runs', 2, *parts)
    assert (status, contents(tmp_path)) == (1, {'index.md': b'mine'})
    assert 'exists already and is not empty' in err
    assert run('reproduce', '--runs', 2, *parts, '--force')[::2] == (0, ''), 'no progress without a terminal'
    first, again = contents(reproduced), contents(tmp_path)
    assert {'tables/threshold.md', 'tables/table8.csv', 'figures/figure1.svg', 'figures/figure1.png'} <= set(again)
    assert {name for name in again if first[name] != again[name]} == {'index.md'}
    other = ('--only', 'threshold', '--seed', 4, '--output', tmp_path, '--force')
    assert run('reproduce', '--runs', 2, *other)[0] == 0
    assert contents(tmp_path)['tables/threshold.csv'] != again['tables/threshold.csv']


def test_an_interrupt_keeps_finished_parts(tmp_path, monkeypatch, refused):
    """Ctrl-C in the third trial of the sweep."""
    shorten(monkeypatch)
    minimise, calls = trials.mde, []

    def interrupted(*arguments, **options):
        calls.append(arguments)
        if len(calls) == 3:
            signal.raise_signal(signal.SIGINT)
        return minimise(*arguments, **options)

    monkeypatch.setattr(trials, 'mde', interrupted)
    message = refused('reproduce', '--only', 'table7,threshold', '--runs', 1, '--output', tmp_path / 'out')
    assert f'interrupted; finished parts in {tmp_path / "out"}: table7. For the rest' in message
    index = (tmp_path / 'out' / 'index.md').read_text()
    assert 'Not finished:** threshold' in index
    assert (tmp_path / 'out' / 'tables' / 'table7.md').read_text() in index
