# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The command line, run in this process, and one folder with what most of its subcommands take."""

import os
import shutil

import pytest

from pendubot_identification.cli.main import main
from test.conftest import ROOT

PAPERS = ('--criterion', 'energy', '--model', 'viscous')
FAST = (*PAPERS, '--optimizer', 'lsq')


@pytest.fixture
def run(capsys):
    """Runs pendubot; returns its exit status, what it printed and what it said on stderr."""

    def run(*arguments):
        capsys.readouterr()
        try:
            status = main([*map(str, arguments)])
        except SystemExit as stopped:
            status = stopped.code
        return status, *capsys.readouterr()

    return run


@pytest.fixture
def refused(run):
    """Runs pendubot, which is to end with this status and one line, no traceback, nothing printed; returns the line."""

    def refused(*arguments, status=1):
        ended, out, err = run(*arguments)
        assert (ended, out) == (status, '')
        line = err.strip().splitlines()[-1]
        assert line.startswith('pendubot')
        assert 'Traceback' not in err
        return line

    return refused


@pytest.fixture(scope='session')
def made(tmp_path_factory):
    """A folder with the sample bag as swing, its result and report as in the paper, and a simulated bag, sim."""
    folder = tmp_path_factory.mktemp('made')
    shutil.copytree(ROOT / 'bags' / 'paper_experiment', folder / 'swing')
    before = os.getcwd()
    os.chdir(folder)
    assert main(['identify', 'swing', *PAPERS, '--output', 'result.yaml', '--report', 'look']) == 0
    assert main(['simulate', '--output', 'sim']) == 0
    os.chdir(before)
    return folder


@pytest.fixture
def there(made, monkeypatch):
    """The same, entered."""
    monkeypatch.chdir(made)
    return made


def contents(folder):
    """All files of a folder and what is in them."""
    return {path: path.read_bytes() for path in folder.rglob('*') if path.is_file()}
