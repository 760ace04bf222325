# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""pendubot excite from outside."""

import re
from dataclasses import asdict, replace

import numpy as np
import pytest
import yaml

from pendubot_identification.excitation.excitation import PulseTrain
from pendubot_identification.excitation.exciter_file import read_exciter
from pendubot_identification.model.parameters import NAMES, PAPER
from pendubot_identification.recordings.bag_reader import read_trajectory
from test.conftest import ROOT
from test.identified import plain

QUICK = ('--torque', '1', '--speed', '20', '--duration', '2', '--generations', '1')


def test_a_design_is_shown_and_written_as_the_exciters_file(tmp_path, run):
    result, output = tmp_path / 'result.yaml', tmp_path / 'exciter.yaml'
    result.write_text(yaml.safe_dump(plain(('weak',))))
    status, shown, _ = run('excite', '--design', *QUICK, '--from', result, '--output', output)
    assert status == 0
    for word in ('rad/s', 'turns', 'now', "paper's pulses", 'ratio', 'P5', 'the worst', f'written to {output}'):
        assert word in shown
    config = yaml.safe_load((ROOT / 'config' / 'exciter.yaml').read_text())['/**/exciter']['ros__parameters']
    written = yaml.safe_load(output.read_text())['/**/exciter']['ros__parameters']
    assert {name: type(value) for name, value in written.items()} == {n: type(v) for n, v in config.items()}
    assert (written['duration'], written['arm']) == (2.0, False)

    status, checked, _ = run('excite', '--check', output, '--from', result, '--torque', '1')
    assert status == 0
    assert checked.splitlines()[:2] == shown.splitlines()[:2], 'what is written is what was simulated'

    assert run('simulate', '--output', tmp_path / 'bag', '--samples', '200', '--excitation', output)[0] == 0
    train, duration = read_exciter(output)
    assert duration == 2.0
    recorded = read_trajectory(tmp_path / 'bag').trajectory
    np.testing.assert_array_equal(recorded.tau[:, 0], train.torques(np.arange(200) / 100))


def test_the_error_of_what_is_0_is_no_percentage_and_what_no_pendubot_tells_has_no_row(tmp_path, run):
    entries = {name: {'value': value} for name, value in asdict(replace(PAPER, b2=0.0, Fs2=1e-4)).items() if value}
    (tmp_path / 'hand.yaml').write_text(yaml.safe_dump({'schema': 1, 'parameters': entries | {'b2': {'value': 0.0}}}))
    status, shown, _ = run('excite', '--design', *QUICK, '--from', tmp_path / 'hand.yaml')
    assert status == 0
    rows = {line.split()[0]: line.split()[1:] for line in shown.splitlines() if line}
    assert rows['b2'][1:4] == ['N', 'm', 's/rad']
    assert len(rows['P1']) == 3
    assert ('k1' in rows, 'k2' in rows) == (True, False)
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
        (['--design', *QUICK, '--seed', '-1'], 2, 'the seed is -1'),
        (['--design', *QUICK, '--generations', '0'], 2, '0 generations were asked for'),
        (['--design', *QUICK, '--output', 'taken.yaml'], 1, 'exists already'),
        (['--design', *QUICK, '--from', 'missing.yaml'], 1, 'there is no file missing.yaml'),
        (['--check', 'taken.yaml'], 1, 'no parameters of the node exciter'),
        (['--check', 'wrong.yaml'], 1, 'numbers are expected'),
        (['--check', 'noise.yaml', '--output', 'noise.yaml', '--force'], 1, 'so it cannot be written as well'),
    ],
)
def test_a_mistake_is_one_sentence(tmp_path, monkeypatch, refused, arguments, status, sentence):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'taken.yaml').write_text('bridge: {}\n')
    (tmp_path / 'wrong.yaml').write_text('exciter: {ros__parameters: {period: often}}\n')
    (tmp_path / 'noise.yaml').write_text('{{{')
    before = {path: path.read_text() for path in tmp_path.iterdir()}
    assert sentence in refused('excite', *arguments, status=status)
    assert before == {path: path.read_text() for path in tmp_path.iterdir()}


def test_what_is_checked_is_held_against_the_limits_that_are_given(tmp_path, run):
    """The paper's pulses, 1 N m: each limit is said that is exceeded, and nothing else changes by it."""
    file, never = ROOT / 'config' / 'exciter.yaml', tmp_path / 'never.yaml'

    def check(*limits):
        return run('excite', '--check', file, *limits)

    status, shown, said = check()
    assert (status, said) == (0, '')
    assert check('--torque', '1', '--speed', '1000', '--angle', '1000', '1000') == (0, shown, '')
    status, out, said = check('--torque', '0.5', '--output', never)
    assert (status, out) == (1, shown)
    assert 'exceeds the limits: torque up to 1 N m where 0.5 N m are allowed; give it smaller' in said
    assert not never.exists()
    said = check('--speed', '0.25', '--angle', '0.125', '1000')[2]
    assert re.findall(r'(\w+ of the \w+) up to [.\d]+ \S+ where ([.\d]+) ', said) == [
        ('speed of the shoulder', '0.25'),
        ('speed of the elbow', '0.25'),
        ('angle of the shoulder', '0.125'),
    ]
    assert 'torque up' not in said
