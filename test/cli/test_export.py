# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""pendubot export from outside."""

import pytest

from pendubot_identification.formats.export import FORMATS, ROBOTS
from pendubot_identification.model.parameters import BALANCE, NAMES
from test.identified import plain, write


@pytest.fixture
def by_hand(tmp_path):
    """Writes a file of the balancing rig's parameters but for some; returns its path."""

    def by_hand(**others):
        values = {name: getattr(BALANCE, name) for name in NAMES} | others
        write(tmp_path / 'hand.yaml', {'schema': 1, 'parameters': {n: {'value': v} for n, v in values.items()}})
        return tmp_path / 'hand.yaml'

    return by_hand


@pytest.mark.parametrize('name', FORMATS)
def test_the_suffix_says_which_format_and_force_replaces_a_file(by_hand, tmp_path, run, refused, name):
    output = tmp_path / f'parameters.{"xml" if name == "mjcf" else name}'
    output.write_text('mine')
    assert 'exists already' in refused('export', by_hand(), '--output', output)
    assert run('export', by_hand(), '--output', output, '--force')[:2] == (0, f'written to {output}\n')
    assert run('export', by_hand(), '--format', name)[:2] == (0, output.read_text())


def test_parameters_that_no_rig_has_are_of_level_error(tmp_path, run):
    """Beside what the result says of itself; its numbers may be those of a hand, which YAML takes for words."""
    data = plain(('weak',)) | {'level': 'WARN', 'warnings': ['so so']}
    data['parameters']['P1']['value'] = '-22e-4'
    write(tmp_path / 'result.yaml', data)
    for name in set(FORMATS) - set(ROBOTS):
        status, out, err = run('export', tmp_path / 'result.yaml', '--format', name)
        assert status == 0
        assert err.startswith('level ERROR: so so; not physical: P1 = -0.0022 is not positive')
        assert 'not physical: P1 = -0.0022 is not positive' in out


@pytest.mark.parametrize(
    ('others', 'options', 'said'),
    [
        ({'P3': 0.02}, '', 'no rig moves like this: M(q) is not positive definite'),
        ({'P5': -0.03}, '', 'give link 1 no length P3 / P5 above 0; measure it'),
        ({'P5': 0.0}, '', 'give it by --link-length'),
        ({}, '--link-length 0.5', 'a length above 0 and below sqrt(P1 P2) / |P5| = 0.2867 m is expected'),
        ({'P5': 0.0}, '--link-length nan', 'a length above 0 is expected'),
        ({}, '--torque-limit 0', 'the torque limit is 0 N m; a number above 0 is expected'),
        ({}, '--torque-limit inf', 'the torque limit is inf N m'),
    ],
)
def test_what_makes_no_simulated_rig_is_refused(by_hand, refused, tmp_path, others, options, said):
    output, status = tmp_path / 'rig.urdf', 2 if 'torque' in options else 1
    assert said in refused('export', by_hand(**others), '--output', output, *options.split(), status=status)
    assert not output.exists()


def test_joints_of_a_urdf_are_revolute_on_request(by_hand, run):
    for limit, options in ((1000.0, ()), (0.5, ('--torque-limit', '0.5'))):
        out = run('export', by_hand(), '--format', 'urdf', '--revolute', *options)[1]
        assert out.count('type="revolute"') == 2
        assert f'lower="-1000" upper="1000" effort="{limit}"' in out


@pytest.mark.parametrize(('name', 'armature'), [('mjcf', True), ('urdf', False)])
def test_what_was_chosen_and_left_out_is_said_beside_the_file_and_in_it(by_hand, run, name, armature):
    given = by_hand(Fc1=0.01, J2=0.001, k1=0.1)
    _, out, err = run('export', given, '--format', name, '--link-length', '0.16')
    for said in ('link 1 is 0.16 m long, as given', 'the rig moves in the same way', 'Fc tanh(v / 0.05)', 'k1 = 0.1'):
        assert said in err
    assert ('J2 = 0.001' in err) is not armature
    assert all(line in out for line in err.splitlines())


@pytest.mark.parametrize(
    ('options', 'said'),
    [
        ('yaml --link-length 0.2', '--link-length is of mjcf, urdf, and yaml does without'),
        ('mjcf --revolute', '--revolute is of urdf, and mjcf does without'),
        ('usd', "invalid choice: 'usd'"),
    ],
)
def test_options_of_simulators_and_unknown_formats_are_wrong_usage(by_hand, refused, options, said):
    assert said in refused('export', by_hand(), '--format', *options.split(), status=2)
