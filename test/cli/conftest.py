# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A folder with the inputs of most subcommands."""

import shutil

import pytest

from pendubot_identification.cli.main import main
from test.conftest import SAMPLE

PAPERS = ('--criterion', 'energy', '--model', 'viscous')
FAST = (*PAPERS, '--optimizer', 'lsq')


@pytest.fixture(scope='session')
def inputs(tmp_path_factory):
    """A folder with the sample bag as swing, its result as in the paper, and a simulated bag, sim."""
    folder = tmp_path_factory.mktemp('inputs')
    shutil.copytree(SAMPLE, folder / 'swing')
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.chdir(folder)
        assert main(['identify', 'swing', *PAPERS, '--output', 'result.yaml']) == 0
        assert main(['simulate', '--output', 'sim']) == 0
    return folder


@pytest.fixture
def in_inputs(inputs, monkeypatch):
    """The same folder as the working directory."""
    monkeypatch.chdir(inputs)
    return inputs


def contents(folder):
    """Return the contents of all files below a folder, None for a folder, by path relative to it."""
    found = folder.rglob('*')
    return {str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None for path in found}
