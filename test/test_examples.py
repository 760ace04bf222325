# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The scripts and the notebook of examples/, executed unchanged."""

import os
import re
import subprocess
import sys

import numpy as np
import pytest

from pendubot_identification.model.parameters import BALANCE, PAPER
from pendubot_identification.results.result import read_result
from test.conftest import ROOT, SAMPLE


@pytest.fixture
def example(tmp_path):
    def example(name, *arguments):
        command = [sys.executable, ROOT / 'examples' / name, *arguments]
        env = {**os.environ, 'TMPDIR': str(tmp_path)}
        done = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True, timeout=240)
        assert done.returncode == 0, done.stderr
        return done.stdout

    return example


def test_the_examples_for_bags_give_parameters_and_a_regulator(example, tmp_path):
    output = example('bag_to_parameters.py', SAMPLE, 'rig.yaml')
    assert 'P5 = 0.0033' in output
    theta = read_result(tmp_path / 'rig.yaml').theta.vector()
    np.testing.assert_allclose(theta, PAPER.vector(), rtol=0.02)
    assert 'poles of the closed loop' in example('lqr.py', 'rig.yaml')


def require_p1(output):
    P1, *_ = re.findall(r'P1 \[kg m\^2\] +(\S+)', output)
    assert float(P1) == pytest.approx(BALANCE.P1, rel=0.01)


def test_the_example_for_arrays_gives_parameters_a_figure_a_model_and_a_report(example, tmp_path):
    require_p1(example('own_arrays.py', tmp_path))
    assert all((tmp_path / name).stat().st_size for name in ('simulation.png', 'rig.urdf', 'report/report.html'))


def test_the_example_for_a_dataframe_gives_parameters(example):
    output = example('own_dataframe.py')
    assert '1500 samples, 14.99 s; it starts at [-1.57' in output
    require_p1(output)


def test_the_regulator_example_identifies_its_own_simulation(example):
    output = example('lqr.py')
    assert 'after 2 s: off by' in output
    require_p1(output)


def test_a_swing_up_planned_with_casadi_works_in_simulation(example):
    pytest.importorskip('casadi')
    (off,) = re.findall(r'ends (\S+) rad from upright', example('casadi_dynamics.py'))
    assert float(off) < 0.01


def test_the_notebook_shows_parameters_a_figure_and_a_model():
    nbclient, nbformat = pytest.importorskip('nbclient'), pytest.importorskip('nbformat')
    notebook = nbformat.read(ROOT / 'examples' / 'explore.ipynb', as_version=4)
    nbformat.validate(notebook)
    assert not any(cell.get('outputs') for cell in notebook.cells), 'the notebook must be stored without outputs'
    nbclient.NotebookClient(notebook, timeout=240, resources={'metadata': {'path': ROOT / 'examples'}}).execute()
    outputs = [output for cell in notebook.cells for output in cell.get('outputs', ())]
    kinds = {kind for output in outputs for kind in output.get('data', ())}
    assert {'text/html', 'image/png'} <= kinds
    assert '<mujoco' in outputs[-1].text
