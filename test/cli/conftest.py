# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A folder with the inputs of most subcommands."""

import os
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
    before = os.getcwd()
    os.chdir(folder)
    assert main(['identify', 'swing', *PAPERS, '--output', 'result.yaml']) == 0
    assert main(['simulate', '--output', 'sim']) == 0
    os.chdir(before)
    return folder


@pytest.fixture
def in_inputs(inputs, monkeypatch):
    """The same folder as the working directory."""
    monkeypatch.chdir(inputs)
    return inputs


def contents(folder):
    """Return the contents of all files below a folder, by path."""
    return {path: path.read_bytes() for path in folder.rglob('*') if path.is_file()}
