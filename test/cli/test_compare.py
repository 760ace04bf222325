# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""pendubot compare from outside."""

import json
import math

import pytest
import yaml

from pendubot_identification.recordings.bag_reader import BagReader
from test.conftest import ROOT
from test.identified import plain, write

SAMPLE = ROOT / 'bags' / 'paper_experiment'


@pytest.fixture
def compared(run, tmp_path, monkeypatch):
    """Runs compare with --json on two criteria's answers from the same 4 s, and others; returns what it prints."""
    monkeypatch.chdir(tmp_path)
    for name, criterion in (('a', 'energy'), ('b', 'weak')):
        write(tmp_path / f'{name}.yaml', plain((criterion,)))

    def compared(*arguments):
        status, out, err = run('compare', *arguments, '--json')
        assert (status, err) == (0, '')
        return json.loads(out)

    return compared


def by_hand(name, **changes):
    """Write parameters alone, those of b but for changes."""
    values = {n: {'value': entry['value']} for n, entry in plain(('weak',))['parameters'].items()}
    values |= {n: {'value': value} for n, value in changes.items()}
    with open(name, 'w') as file:
        yaml.safe_dump({'schema': 1, 'parameters': values}, file)


def test_differences_are_in_standard_errors_of_both_together(compared):
    rows = compared('a.yaml', 'b.yaml')['parameters']
    a, b = (plain((criterion,))['parameters'] for criterion in ('energy', 'weak'))
    assert list(rows) == list(a)
    for name, row in rows.items():
        assert row['value'] == [a[name]['value'], b[name]['value']]
        if None not in row['std_error']:
            together = math.hypot(a[name]['std_error'], b[name]['std_error'])
            assert row['apart'] == [0.0, pytest.approx((b[name]['value'] - a[name]['value']) / together)]
            assert row['p'][0] == 1.0
            assert math.erfc(abs(row['apart'][1]) / math.sqrt(2)) < row['p'][1] < 1, 'few degrees of freedom'


def test_they_stand_side_by_side_with_what_each_predicts_of_a_bag(compared, run):
    status, out, _ = run('compare', 'a.yaml', 'b.yaml', '--on', f'{SAMPLE}@9:18')
    assert status == 0
    assert out.startswith('A  a.yaml\nB  b.yaml\n')
    found = compared('a.yaml', 'b.yaml', '--on', f'{SAMPLE}@9:18')
    assert all(w < e < s for e, w, s in zip(*found['error'], found['persistence'], strict=True))


@pytest.mark.parametrize(('window', 'shared'), [('0:4', True), ('3:7', True), ('4:8', False)])
def test_results_of_the_same_motion_are_named(tmp_path, compared, window, shared):
    data = plain(('weak',))
    data['bags'][0]['bag'] = f'swing@{window}'
    write(tmp_path / 'c.yaml', data)
    notes = compared('a.yaml', 'c.yaml')['notes']
    assert any('estimated from the same motion' in note for note in notes) is shared


@pytest.mark.parametrize(('window', 'named'), [('', True), ('@3.9:', True), ('@4:', False)])
def test_a_bag_that_one_was_estimated_from_is_named(tmp_path, compared, window, named):
    """It was from the first four seconds."""
    data = plain(('weak',))
    data['bags'][0]['sha256'] = BagReader(SAMPLE).content_hash
    write(tmp_path / 'c.yaml', data)
    notes = compared('a.yaml', 'c.yaml', '--on', f'{SAMPLE}{window}')['notes']
    assert [note.startswith('c.yaml was estimated from a part of ') for note in notes] == [True] * named


def test_models_of_different_size_and_parameters_by_hand(compared):
    """What a hand left out is 0 in its own place: without Fc2, J2 is still J2."""
    by_hand('short.yaml', Fc1=0.001, J2=0.0003)
    by_hand('long.yaml', Fc1=0.001, J2=0.0003, Fc2=0)
    found = compared('a.yaml', 'short.yaml', 'long.yaml', '--on', f'{SAMPLE}@9:12')
    nothing = dict.fromkeys(('std_error', 'apart', 'p'), [None] * 3)
    assert found['parameters']['Fc1'] == {'unit': 'N m', 'value': [None, 0.001, 0.001], **nothing}
    assert found['error'][1] == found['error'][2]


def test_parameters_that_no_rig_has_are_named(compared):
    by_hand('c.yaml', P1=-0.0022)
    first, *others = compared('a.yaml', 'c.yaml', '--on', f'{SAMPLE}@9:12')['notes']
    assert first == 'c.yaml: not physical: P1 = -0.0022 is not positive'
    assert first not in others
