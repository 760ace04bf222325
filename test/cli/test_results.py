# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The subcommands compare and export."""

import json
import math
from dataclasses import replace

import pytest

from pendubot_identification.formats.export import FORMATS, ROBOTS
from pendubot_identification.model.parameters import BALANCE
from pendubot_identification.recordings.bag_reader import BagReader
from test.conftest import SAMPLE
from test.identified import plain, write, written


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """The working directory, with results of two criteria from the same 4 s of the sample bag."""
    monkeypatch.chdir(tmp_path)
    for name, criterion in (('a', 'energy'), ('b', 'weak')):
        write(tmp_path / f'{name}.yaml', plain((criterion,)))
    return tmp_path


@pytest.fixture
def by_hand(folder):
    """Writes the balancing rig's parameters with some changes to a file; returns its path."""

    def by_hand(**others):
        return written(folder / 'hand.yaml', replace(BALANCE, **others))

    return by_hand


@pytest.fixture
def compared(run):
    def compared(*arguments):
        status, out, err = run('compare', *arguments, '--json')
        assert (status, err) == (0, '')
        return json.loads(out)

    return compared


def test_differences_are_divided_by_the_combined_standard_error(compared):
    rows = compared('a.yaml', 'b.yaml')['parameters']
    a, b = (plain((criterion,))['parameters'] for criterion in ('energy', 'weak'))
    assert list(rows) == list(a)
    for name, row in rows.items():
        assert row['value'] == [a[name]['value'], b[name]['value']]
        if None not in row['std_error']:
            combined = math.hypot(a[name]['std_error'], b[name]['std_error'])
            assert row['apart'] == [0.0, pytest.approx((b[name]['value'] - a[name]['value']) / combined)]
            assert row['p'][0] == 1.0
            assert math.erfc(abs(row['apart'][1]) / math.sqrt(2)) < row['p'][1] < 1, 'normal instead of t distribution'


def test_compare_shows_the_prediction_errors_of_each_result_on_a_bag(compared, run):
    status, out, _ = run('compare', 'a.yaml', 'b.yaml', '--on', f'{SAMPLE}@9:18')
    assert status == 0
    assert out.startswith('A  a.yaml\nB  b.yaml\n')
    found = compared('a.yaml', 'b.yaml', '--on', f'{SAMPLE}@9:18')
    assert all(w < e < s for e, w, s in zip(*found['error'], found['persistence'], strict=True))


@pytest.mark.parametrize(('window', 'shared'), [('0:4', True), ('3.9:7', True), ('4:8', False)])
def test_results_from_the_same_motion_and_a_bag_that_a_result_used_are_noted(folder, compared, window, shared):
    """The results use the first four seconds."""
    c, d = plain(('weak',)), plain(('weak',))
    c['bags'][0]['bag'] = f'swing@{window}'
    d['bags'][0]['sha256'] = BagReader(SAMPLE).content_hash
    write(folder / 'c.yaml', c)
    write(folder / 'd.yaml', d)
    notes = compared('a.yaml', 'c.yaml')['notes']
    assert any('estimated from the same motion' in note for note in notes) is shared
    notes = compared('c.yaml', 'd.yaml', '--on', f'{SAMPLE}@{window}')['notes']
    assert any(note.startswith('d.yaml was estimated from a part of ') for note in notes) is shared


def test_parameters_written_by_hand_are_compared_and_noted_if_unphysical(compared, by_hand):
    first, *others = compared('a.yaml', by_hand(P1=-0.0022, Fc1=0.001), '--on', f'{SAMPLE}@9:12')['notes']
    assert 'hand.yaml: not physical: P1 = -0.0022 is not positive' in first
    assert first not in others
    rows = compared('a.yaml', by_hand(Fc1=0.001))['parameters']
    nothing = dict.fromkeys(('std_error', 'apart', 'p'), [None] * 2)
    assert rows['Fc1'] == {'unit': 'N m', 'value': [None, 0.001], **nothing}


@pytest.mark.parametrize('name', FORMATS)
def test_the_suffix_selects_the_format_and_force_replaces_a_file(by_hand, folder, run, refused, name):
    output = folder / f'parameters.{"xml" if name == "mjcf" else name}'
    output.write_text('mine')
    assert 'exists already' in refused('export', by_hand(), '--output', output)
    assert run('export', by_hand(), '--output', output, '--force')[:2] == (0, f'written to {output}\n')
    assert run('export', by_hand(), '--format', name)[:2] == (0, output.read_text())


def test_unphysical_parameters_are_exported_with_level_error(folder, run):
    """The result's own warning is kept; -22e-4 is a string in YAML."""
    data = plain(('weak',)) | {'level': 'WARN', 'warnings': ['so so']}
    data['parameters']['P1']['value'] = '-22e-4'
    write(folder / 'c.yaml', data)
    for name in set(FORMATS) - set(ROBOTS):
        status, out, err = run('export', 'c.yaml', '--format', name)
        assert status == 0
        assert err.startswith('level ERROR: so so; not physical: P1 = -0.0022 is not positive')
        assert 'not physical: P1 = -0.0022 is not positive' in out


@pytest.mark.parametrize(
    ('others', 'options', 'status', 'message'),
    [
        ({'P3': 0.02}, 'urdf', 1, 'no rig has these parameters: M(q) is not positive definite'),
        ({'P5': -0.03}, 'urdf', 1, 'give link 1 no length P3 / P5 above 0; measure it and add --link-length'),
        ({'P5': 0.0}, 'mjcf', 1, 'measure it and add --link-length'),
        ({}, 'urdf --link-length 0.5', 1, 'a length above 0 and below sqrt(P1 P2) / |P5| = 0.2867 m is expected'),
        ({'P5': 0.0}, 'urdf --link-length nan', 1, 'a length above 0 is expected'),
        ({}, 'urdf --torque-limit 0', 2, 'the torque limit is 0 N m; a number above 0 is expected'),
        ({}, 'yaml --link-length 0.2', 2, '--link-length belongs to mjcf, urdf, and yaml ignores it'),
        ({}, 'mjcf --revolute', 2, '--revolute belongs to urdf, and mjcf ignores it'),
        ({}, 'usd', 2, "invalid choice: 'usd'"),
    ],
)
def test_an_invalid_export_is_refused(by_hand, refused, folder, others, options, status, message):
    words = ('--output', 'rig', '--format', *options.split())
    assert message in refused('export', by_hand(**others), *words, status=status)
    assert not (folder / 'rig').exists()


def test_joints_of_a_urdf_are_revolute_on_request(by_hand, run):
    for limit, options in ((1000.0, ()), (0.5, ('--torque-limit', '0.5'))):
        out = run('export', by_hand(), '--format', 'urdf', '--revolute', *options)[1]
        assert out.count('type="revolute"') == 2
        assert f'lower="-1000" upper="1000" effort="{limit}"' in out


@pytest.mark.parametrize(('name', 'armature'), [('mjcf', True), ('urdf', False)])
def test_assumptions_and_omissions_of_a_robot_model_are_in_the_file_and_on_stderr(by_hand, run, name, armature):
    _, out, err = run('export', by_hand(Fc1=0.01, J2=0.001, k1=0.1), '--format', name, '--link-length', '0.16')
    for note in ('link 1 is 0.16 m long, as given', 'the rig moves in the same way', 'Fc tanh(v / 0.05)', 'k1 = 0.1'):
        assert note in err
    assert ('J2 = 0.001' in err) is not armature
    assert all(line in out for line in err.splitlines())
