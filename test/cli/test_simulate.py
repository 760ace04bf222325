# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

import re
from dataclasses import asdict, replace

import numpy as np
import pytest
import yaml

from pendubot_identification.cli.main import main
from pendubot_identification.model.parameters import PAPER
from pendubot_identification.model.simulation import simulate
from pendubot_identification.recordings.bag_reader import read_trajectory
from pendubot_identification.results.result_file import SCHEMA
from test.conftest import ROOT

GEARED = replace(PAPER, Fc1=0.004, Fc2=0.001, J2=1e-4, Fs1=0.002, Fs2=0.0005, k1=0.1, k2=0.1)


@pytest.fixture
def result(tmp_path):
    """Write what ``--parameters`` reads."""

    def write(values):
        path = tmp_path / 'result.yaml'
        path.write_text(yaml.safe_dump({'schema': SCHEMA, 'parameters': {n: {'value': v} for n, v in values.items()}}))
        return path

    return write


def simulated(bag, *options):
    """Return the motion in a new bag."""
    assert main(['simulate', '--output', str(bag), '--samples', '150', *map(str, options)]) == 0
    return read_trajectory(bag).trajectory


def test_the_rig_is_the_papers_or_that_of_a_result(tmp_path, result):
    paper = simulated(tmp_path / 'paper', '--counts', 0)
    same = simulated(tmp_path / 'same', '--counts', 0, '--parameters', result(asdict(PAPER)))
    np.testing.assert_array_equal(same.q, paper.q)
    geared = simulated(tmp_path / 'geared', '--counts', 0, '--parameters', result(asdict(GEARED)))
    np.testing.assert_array_equal(geared.tau, paper.tau)
    expected = simulate(GEARED, np.arange(150) / 100, geared.tau)
    np.testing.assert_allclose(geared.q, expected.q, atol=1e-9)
    assert np.abs(geared.q - paper.q).max() > 0.1


def test_parameters_by_hand_need_not_name_what_is_0(tmp_path, result):
    coulomb = {name: value for name, value in asdict(replace(PAPER, Fc1=0.004)).items() if value}
    motion = simulated(tmp_path / 'coulomb', '--counts', 0, '--parameters', result(coulomb))
    expected = simulate(replace(PAPER, Fc1=0.004), np.arange(150) / 100, motion.tau)
    np.testing.assert_allclose(motion.q, expected.q, atol=1e-9)


@pytest.mark.parametrize(
    ('change', 'sentence'),
    [({'Fc2': -0.1}, 'friction Fc2 = -0.1 is negative'), ({'P3': 1.0}, 'not positive definite'), ({'b1': None}, 'b1')],
)
def test_parameters_that_no_rig_has_are_refused_in_a_sentence(tmp_path, result, capsys, change, sentence):
    options = ['--parameters', str(result(asdict(PAPER) | change))]
    assert main(['simulate', '--output', str(tmp_path / 'never'), *options]) == 1
    assert sentence in capsys.readouterr().err
    assert not (tmp_path / 'never').exists()


@pytest.mark.parametrize('option', ['--amplitude -1 1', '--period 1', '--width 0.05', '--hold 0.01', '--seed 0'])
def test_pulses_are_told_once(tmp_path, capsys, option):
    options = ['--excitation', str(ROOT / 'config' / 'exciter.yaml'), *option.split()]
    assert main(['simulate', '--output', str(tmp_path / 'never'), *options]) == 2
    assert f'and so does {option.split()[0]}; give one of the two' in capsys.readouterr().err
    assert not (tmp_path / 'never').exists()


@pytest.mark.parametrize('amplitude', [('1000', '2000'), ('1e300', '1e301')])
def test_torques_that_no_motion_can_follow_are_refused_in_a_sentence(tmp_path, capsys, amplitude):
    assert main(['simulate', '--output', str(tmp_path / 'never'), '--samples', '300', '--amplitude', *amplitude]) == 1
    assert re.search(r'too fast to be followed 0\.\d+ s after .* N m are too large', capsys.readouterr().err)
    assert not (tmp_path / 'never').exists()


def test_help_shows_how_to_write_parameters_by_hand(capsys):
    with pytest.raises(SystemExit):
        main(['simulate', '--help'])
    assert f'schema: {SCHEMA}\n' in capsys.readouterr().out
