# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""pendubot export from outside."""

import pytest
import yaml

from pendubot_identification.cli.arguments import FORMATS as NAMED
from pendubot_identification.formats.export import FORMATS, ROBOTS
from pendubot_identification.model.parameters import BALANCE, NAMES
from test.identified import plain


@pytest.fixture
def result(tmp_path):
    path = tmp_path / 'result.yaml'
    path.write_text(yaml.safe_dump(plain(('weak',))))
    return path


@pytest.fixture
def by_hand(tmp_path):
    """Writes a file of the balancing rig's parameters but for some; returns its path."""

    def by_hand(**others):
        values = {name: getattr(BALANCE, name) for name in NAMES} | others
        path = tmp_path / 'hand.yaml'
        path.write_text(yaml.safe_dump({'schema': 1, 'parameters': {n: {'value': v} for n, v in values.items()}}))
        return path

    return by_hand


def test_help_names_every_format():
    assert FORMATS == NAMED


@pytest.mark.parametrize(
    ('suffix', 'name'),
    [(f'.{name}', name) for name in NAMED if name != 'mjcf'] + [('.xml', 'mjcf'), ('.m', 'matlab'), ('.h', 'c')],
)
def test_the_suffix_says_which_format_and_force_replaces_a_file(result, by_hand, tmp_path, run, refused, suffix, name):
    given = by_hand() if name in ROBOTS else result
    output = tmp_path / f'parameters{suffix}'
    output.write_text('mine')
    assert 'exists already' in refused('export', given, '--output', output)
    assert run('export', given, '--output', output, '--force')[:2] == (0, f'written to {output}\n')
    assert run('export', given, '--format', name)[:2] == (0, output.read_text())


@pytest.mark.parametrize('name', [name for name in NAMED if name not in ROBOTS])
def test_parameters_that_no_rig_has_are_of_level_error(result, run, name):
    """Beside what the result says of itself; its numbers may be those of a hand, which YAML takes for words."""
    data = yaml.safe_load(result.read_text()) | {'level': 'WARN', 'warnings': ['so so']}
    data['parameters']['P1']['value'] = '-22e-4'
    result.write_text(yaml.safe_dump(data))
    status, out, err = run('export', result, '--format', name)
    assert status == 0
    assert err.startswith('level ERROR: so so; not physical: P1 = -0.0022 is not positive')
    assert 'not physical: P1 = -0.0022 is not positive' in out


@pytest.mark.parametrize(
    ('others', 'length', 'said'),
    [
        ({'P3': 0.02}, None, 'no rig moves like this: M(q) is not positive definite'),
        ({'P5': -0.03}, None, 'give link 1 no length P3 / P5 above 0; measure it and add --link-length'),
        ({'P5': 0.0}, None, 'measure it and add --link-length'),
        ({}, '0.5', 'a length above 0 and below sqrt(P1 P2) / |P5| = 0.2867 m is expected'),
        ({'P5': 0.0}, 'nan', 'a length above 0 is expected'),
    ],
)
def test_what_makes_no_simulated_rig_is_refused(by_hand, refused, tmp_path, others, length, said):
    options = () if length is None else ('--link-length', length)
    for name in ROBOTS:
        output = tmp_path / f'rig.{name}'
        assert said in refused('export', by_hand(**others), '--output', output, '--format', name, *options)
        assert not output.exists()


def test_joints_of_a_urdf_are_revolute_on_request(by_hand, run, refused):
    _, out, _ = run('export', by_hand(), '--format', 'urdf', '--revolute')
    assert (out.count('type="revolute"'), out.count('lower="-1000" upper="1000" effort="1000.0"')) == (2, 2)
    _, out, _ = run('export', by_hand(), '--format', 'urdf', '--revolute', '--torque-limit', '0.5')
    assert 'upper="1000" effort="0.5"' in out
    assert '--revolute is of urdf' in refused('export', by_hand(), '--format', 'mjcf', '--revolute', status=2)


def test_a_missing_result_is_named_before_a_missing_format(refused):
    assert 'there is no file nothere.yaml' in refused('export', 'nothere.yaml')


@pytest.mark.parametrize(('name', 'armature'), [('mjcf', True), ('urdf', False)])
def test_what_was_chosen_and_left_out_is_said_beside_the_file_and_in_it(by_hand, run, name, armature):
    given = by_hand(Fc1=0.01, J2=0.001, k1=0.1)
    _, out, err = run('export', given, '--format', name, '--link-length', '0.16')
    for said in ('link 1 is 0.16 m long, as given', 'the rig moves in the same way', 'Fc tanh(v / 0.05)', 'k1 = 0.1'):
        assert said in err
    assert ('J2 = 0.001' in err) is not armature
    assert all(line in out for line in err.splitlines())


def test_options_of_simulators_and_unknown_formats_are_wrong_usage(result, refused):
    said = refused('export', result, '--format', 'yaml', '--link-length', '0.2', status=2)
    assert '--link-length is of mjcf, urdf, and yaml does without' in said
    for limit in ('0', 'inf'):
        said = refused('export', result, '--format', 'mjcf', '--torque-limit', limit, status=2)
        assert said == f'pendubot: the torque limit is {limit} N m; a number above 0 is expected'
    assert "invalid choice: 'usd'" in refused('export', result, '--format', 'usd', status=2)
