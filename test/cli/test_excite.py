# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

import re
from dataclasses import asdict, replace

import numpy as np
import pytest
import yaml

from pendubot_identification.cli.main import main
from pendubot_identification.excitation.excitation import PulseTrain
from pendubot_identification.excitation.exciter_file import read_exciter
from pendubot_identification.model.parameters import NAMES, PAPER
from pendubot_identification.recordings.bag_reader import read_trajectory
from test.conftest import ROOT
from test.identified import plain

QUICK = ['--torque', '1', '--speed', '20', '--duration', '2', '--generations', '1']


def test_a_design_is_shown_and_written_as_the_exciters_file(tmp_path, capsys):
    result, output = tmp_path / 'result.yaml', tmp_path / 'exciter.yaml'
    result.write_text(yaml.safe_dump(plain(('weak',))))
    assert main(['excite', '--design', *QUICK, '--from', str(result), '--output', str(output)]) == 0
    shown = capsys.readouterr().out
    for word in ('rad/s', 'turns', 'now', "paper's pulses", 'ratio', 'P5', 'the worst', f'written to {output}'):
        assert word in shown
    config = yaml.safe_load((ROOT / 'config' / 'exciter.yaml').read_text())['/**/exciter']['ros__parameters']
    written = yaml.safe_load(output.read_text())['/**/exciter']['ros__parameters']
    assert set(written) == set(config)
    assert {name: type(value) for name, value in written.items()} == {n: type(v) for n, v in config.items()}
    assert written['duration'] == 2.0
    assert written['arm'] is False

    assert main(['excite', '--check', str(output), '--from', str(result), '--torque', '1']) == 0
    checked = capsys.readouterr().out
    assert checked.splitlines()[:2] == shown.splitlines()[:2], 'what is written is what was simulated'

    assert main(['simulate', '--output', str(tmp_path / 'bag'), '--samples', '200', '--excitation', str(output)]) == 0
    train, duration = read_exciter(output)
    assert duration == 2.0
    recorded = read_trajectory(tmp_path / 'bag').trajectory
    np.testing.assert_array_equal(recorded.tau[:, 0], train.torques(np.arange(200) / 100))


def test_the_error_of_what_is_0_is_no_percentage_and_what_no_pendubot_tells_has_no_row(tmp_path, capsys):
    entries = {name: {'value': value} for name, value in asdict(replace(PAPER, b2=0.0, Fs2=1e-4)).items() if value}
    (tmp_path / 'hand.yaml').write_text(yaml.safe_dump({'schema': 1, 'parameters': entries | {'b2': {'value': 0.0}}}))
    assert main(['excite', '--design', *QUICK, '--from', str(tmp_path / 'hand.yaml')]) == 0
    rows = {line.split()[0]: line.split()[1:] for line in capsys.readouterr().out.splitlines() if line}
    assert rows['b2'][1:4] == ['N', 'm', 's/rad']
    assert len(rows['P1']) == 3
    assert 'k1' in rows
    assert 'k2' not in rows
    told = [float(cells[1]) for name, cells in rows.items() if len(cells) == 3 and name in NAMES]
    assert float(rows['the'][2]) == max(told)


@pytest.mark.ros
def test_the_exciter_takes_a_written_file(tmp_path):
    import rclpy
    from rclpy.node import Node

    from pendubot_identification.excitation.exciter_file import write_exciter
    from pendubot_identification.nodes.exciter import Exciter
    from pendubot_identification.nodes.runtime import descriptor

    path, train = tmp_path / 'exciter.yaml', PulseTrain(0.7, 0.31, -0.2, 1.0, 1e-3, 12)
    write_exciter(path, train, 9, ['for a rig'])
    context = rclpy.Context()
    rclpy.init(context=context)
    node = Node('exciter', context=context, cli_args=['--ros-args', '--params-file', str(path)])
    try:
        values = {s.name: node.declare_parameter(s.name, s.default, descriptor(s)).value for s in Exciter.SETTINGS}
    finally:
        node.destroy_node()
        context.try_shutdown()
    assert PulseTrain(**{n: values[n] for n in values if n not in ('duration', 'arm', 'recorded')}) == train
    assert values['duration'] == 9.0


@pytest.mark.parametrize(
    ('arguments', 'status', 'sentence'),
    [
        (['--design', '--torque', '1'], 2, 'give --torque [N m] and --speed [rad/s]'),
        (['--design', '--torque', '-1', '--speed', '5'], 2, 'limit of the torque is -1'),
        (['--design', *QUICK, '--rate', '0'], 2, 'sampling rate is 0'),
        (['--design', *QUICK, '--duration', '0'], 2, '0 s sampled every 0.01 s cannot be designed'),
        (['--design', *QUICK, '--counts', '1'], 2, 'an encoder of 1 counts per turn'),
        (['--design', *QUICK, '--seed', '-1'], 2, 'the seed is -1'),
        (['--design', *QUICK, '--generations', '0'], 2, '0 generations were asked for'),
        (['--design', *QUICK, '--output', 'taken.yaml'], 1, 'exists already'),
        (['--design', *QUICK, '--from', 'missing.yaml'], 1, 'missing.yaml cannot be read'),
        (['--check', 'missing.yaml'], 1, 'missing.yaml cannot be read'),
        (['--check', 'taken.yaml'], 1, 'no parameters of the node exciter'),
        (['--check', 'wrong.yaml'], 1, 'numbers are expected'),
        (['--check', 'noise.yaml'], 1, 'is no YAML file'),
        (['--design', *QUICK, '--output', 'nowhere/out.yaml'], 1, 'nowhere/out.yaml cannot be written (No such file'),
        (
            ['--design', *QUICK, '--from', 'result.yaml', '--output', 'result.yaml', '--force'],
            1,
            'is read, so it cannot',
        ),
        (['--check', 'noise.yaml', '--output', 'noise.yaml', '--force'], 1, 'so it cannot be written as well'),
    ],
)
def test_what_a_user_can_do_wrong_is_explained(tmp_path, monkeypatch, capsys, arguments, status, sentence):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'taken.yaml').write_text('bridge: {}\n')
    (tmp_path / 'wrong.yaml').write_text('exciter: {ros__parameters: {period: often}}\n')
    (tmp_path / 'noise.yaml').write_text('{{{')
    (tmp_path / 'result.yaml').write_text(yaml.safe_dump(plain(('weak',))))
    before = {path: path.read_text() for path in tmp_path.iterdir()}
    assert main(['excite', *arguments]) == status
    said = capsys.readouterr()
    assert said.out == ''
    assert sentence in said.err
    assert 'Traceback' not in said.err
    assert before == {path: path.read_text() for path in tmp_path.iterdir()}


def test_what_is_checked_is_held_against_the_limits_that_are_given(tmp_path, capsys):
    """The paper's pulses, 1 N m: each limit is said that is exceeded, and nothing else changes by it."""
    file, never = tmp_path / 'exciter.yaml', tmp_path / 'never.yaml'
    file.write_text((ROOT / 'config' / 'exciter.yaml').read_text())

    def check(*limits):
        status = main(['excite', '--check', str(file), *limits])
        printed = capsys.readouterr()
        return status, printed.out, printed.err

    status, shown, said = check()
    assert (status, said) == (0, '')
    assert check('--torque', '1', '--speed', '1000', '--angle', '1000', '1000') == (0, shown, '')
    status, out, said = check('--torque', '0.5', '--output', str(never))
    assert (status, out) == (1, shown)
    assert f'{file} exceeds the limits: torque up to 1 N m where 0.5 N m are allowed; give it smaller' in said
    assert not never.exists()
    said = check('--speed', '0.25', '--angle', '0.125', '1000')[2]
    assert re.findall(r'(\w+ of the \w+) up to [.\d]+ \S+ where ([.\d]+) ', said) == [
        ('speed of the shoulder', '0.25'),
        ('speed of the elbow', '0.25'),
        ('angle of the shoulder', '0.125'),
    ]
    assert 'torque up' not in said
    status, out, said = check('--speed', '-1')
    assert (status, out) == (2, '')
    assert 'limit of the speed is -1' in said
