# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The subcommand excite."""

import re

import numpy as np
import yaml

from pendubot_identification.excitation.excitation import read_exciter
from pendubot_identification.recordings.bag_reader import read_trajectory
from test.conftest import ROOT
from test.identified import plain, write

QUICK = ('--torque', '1', '--speed', '20', '--duration', '2')


def test_a_design_is_shown_and_written_as_a_parameter_file_of_the_exciter(tmp_path, run):
    result, output = tmp_path / 'result.yaml', tmp_path / 'exciter.yaml'
    write(result, plain(('weak',)))
    status, shown, _ = run('excite', '--design', *QUICK, '--from', result, '--output', output)
    assert status == 0
    assert f'written to {output}' in shown
    config = yaml.safe_load((ROOT / 'config' / 'exciter.yaml').read_text())['/**/exciter']['ros__parameters']
    written = yaml.safe_load(output.read_text())['/**/exciter']['ros__parameters']
    assert {name: type(value) for name, value in written.items()} == {n: type(v) for n, v in config.items()}
    assert (written['duration'], written['arm']) == (2.0, False)

    status, checked, _ = run('excite', '--check', output, '--from', result, '--torque', '1')
    assert status == 0
    assert checked.splitlines()[:2] == shown.splitlines()[:2], 'the file must contain the simulated design'

    write(result, plain(('weak',)) | {'level': 'ERROR', 'warnings': ['so so']})
    assert run('excite', '--check', output, '--from', result) == (0, checked, 'level ERROR: so so\n')

    assert run('simulate', '--output', tmp_path / 'bag', '--samples', '200', '--excitation', output)[0] == 0
    train, duration = read_exciter(output)
    assert duration == 2.0
    recorded = read_trajectory(tmp_path / 'bag').trajectory
    np.testing.assert_array_equal(recorded.tau[:, 0], train.torques(np.arange(200) / 100))


def test_check_names_exactly_the_exceeded_limits(tmp_path, run):
    """The paper's pulses reach 1 N m; limits do not change the rest of the output."""
    file, never = ROOT / 'config' / 'exciter.yaml', tmp_path / 'never.yaml'

    def check(*limits):
        return run('excite', '--check', file, *limits)

    status, shown, err = check()
    assert (status, err) == (0, '')
    assert check('--torque', '1', '--speed', '1000', '--angle', '1000', '1000') == (0, shown, '')
    status, out, err = check('--torque', '0.5', '--output', never)
    assert (status, out) == (1, shown)
    assert 'exceeds the limits: torque up to 1 N m, limit 0.5 N m; use smaller' in err
    assert not never.exists()
    err = check('--speed', '0.25', '--angle', '0.125', '1000')[2]
    assert re.findall(r'(\w+ of the \w+) up to [.\d]+ \S+, limit ([.\d]+) ', err) == [
        ('speed of the shoulder', '0.25'),
        ('speed of the elbow', '0.25'),
        ('angle of the shoulder', '0.125'),
    ]
    assert 'torque up' not in err


def test_a_file_in_which_a_parameter_of_the_exciter_is_misspelt_or_missing_is_refused(tmp_path, run):
    file = tmp_path / 'mine.yaml'
    for content, refused in (
        ('/**/exciter: {ros__parameters: {amplitude_mx: 9.0}}', 'exciter has no parameter amplitude_mx; is'),
        ('/**/exciter: {ros__parameters: {}}', 'holds no parameters of the node exciter'),
        ('/**/exciter: {ros__parameters: {seed: 1, use_sim_time: true}}\n/**: {ros__parameters: {rate: 1.0}}', ''),
        ('/**/exciter: {ros__parameters: {seed: 1}}\n/**/my_exciter: {ros__parameters: {rate: 1.0}}', ''),
        ('/**/exciter: {ros__parameters: {seed: 2026-13-45}}', 'is no YAML file; expected is a file like'),
    ):
        file.write_text(content)
        status, _, err = run('excite', '--check', file)
        assert (status, refused in err) == (bool(refused), True), err


def test_pulses_beyond_any_simulation_are_refused_and_are_not_a_best_case(tmp_path, run):
    config, file = (ROOT / 'config' / 'exciter.yaml').read_text(), tmp_path / 'strong.yaml'
    file.write_text(config.replace('amplitude_max: 1.0', 'amplitude_max: 900.0'))
    status, out, err = run('excite', '--check', file)
    assert (status, out) == (1, '')
    assert 'the simulation diverges; use smaller torques' in err
    # The paper's pulses diverge, the design does not.
    _, out, _ = run('excite', '--design', '--torque', '900', '--speed', '100', '--duration', '2')
    assert re.search(r'^the worst +- +[\d.e-]+ +-$', out, re.MULTILINE)
