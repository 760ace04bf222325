# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""pendubot compare from outside."""

import json
import math

import pytest
import yaml

from pendubot_identification.cli.main import main
from pendubot_identification.results.result_file import write_result
from test.conftest import ROOT
from test.identified import plain

SAMPLE = ROOT / 'bags' / 'paper_experiment'


@pytest.fixture(scope='module')
def results(tmp_path_factory):
    """Two criteria's answers from the same 4 s of the sample bag."""
    folder = tmp_path_factory.mktemp('results')
    for name, criteria in (('a', ('energy',)), ('b', ('weak',))):
        write_result(folder / f'{name}.yaml', plain(criteria))
    return folder


def compare(capsys, *arguments):
    status = main(['compare', *map(str, arguments)])
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def test_differences_are_in_standard_errors_of_both_together(results, capsys):
    status, out, _ = compare(capsys, results / 'a.yaml', results / 'b.yaml', '--json')
    assert status == 0
    rows = json.loads(out)['parameters']
    a, b = (yaml.safe_load((results / f'{name}.yaml').read_text())['parameters'] for name in 'ab')
    assert list(rows) == list(a)
    for name, row in rows.items():
        assert row['value'] == [a[name]['value'], b[name]['value']]
        if None not in row['std_error']:
            together = math.hypot(a[name]['std_error'], b[name]['std_error'])
            assert row['apart'] == [0.0, pytest.approx((b[name]['value'] - a[name]['value']) / together)]


def test_they_stand_side_by_side(results, capsys):
    status, out, _ = compare(capsys, results / 'a.yaml', results / 'b.yaml')
    assert status == 0
    lines = out.splitlines()
    assert lines[0] == f'A  {results / "a.yaml"}'
    assert 'B - A' in out
    assert sum(line.startswith(('P', 'b')) and '±' in line for line in lines) >= 6
    assert 'estimated from the same motion' in ' '.join(out.split())


def test_what_each_predicts_of_a_bag(results, capsys):
    named = (results / 'a.yaml', results / 'b.yaml', '--on', f'{SAMPLE}@9:18')
    status, out, _ = compare(capsys, *named, '--json')
    assert status == 0
    found = json.loads(out)
    energy, weak = found['error']
    assert all(w < e < still for e, w, still in zip(energy, weak, found['standing_still'], strict=True))
    status, out, _ = compare(capsys, *named)
    assert 'error after 0.5 s' in out
    assert 'persistence' in out


def test_a_bag_that_one_was_estimated_from_is_named(results, tmp_path, capsys):
    from pendubot_identification.recordings.bag_reader import BagReader

    data = plain(('weak',))
    data['bags'][0]['sha256'] = BagReader(SAMPLE).content_hash
    write_result(tmp_path / 'c.yaml', data)
    status, out, _ = compare(capsys, results / 'a.yaml', tmp_path / 'c.yaml', '--on', SAMPLE, '--json')
    assert status == 0
    (note,) = json.loads(out)['notes']
    assert f'{tmp_path / "c.yaml"} was estimated from a part of {SAMPLE}' in note
    for window, named in (('3.9:', 1), ('4:', 0)):
        _, out, _ = compare(capsys, results / 'a.yaml', tmp_path / 'c.yaml', '--on', f'{SAMPLE}@{window}', '--json')
        assert len(json.loads(out)['notes']) == named, 'it was estimated from the first four seconds'


def test_two_parts_of_one_recording_have_nothing_in_common(tmp_path, capsys):
    data = plain(('weak',))
    for name, window in (('a', '0:4'), ('b', '3:7'), ('c', '4:8')):
        data['bags'][0]['bag'] = f'swing@{window}'
        write_result(tmp_path / f'{name}.yaml', data)
    for other, shared in (('b', True), ('c', False)):
        _, out, _ = compare(capsys, tmp_path / 'a.yaml', tmp_path / f'{other}.yaml')
        assert ('estimated from the same motion' in ' '.join(out.split())) is shared


def test_models_of_different_size_and_parameters_by_hand(results, tmp_path, capsys):
    by_hand = {name: {'value': entry['value']} for name, entry in plain(('weak',))['parameters'].items()}
    by_hand['Fc1'] = {'value': 0.001}
    (tmp_path / 'hand.yaml').write_text(yaml.safe_dump({'schema': 1, 'parameters': by_hand}))
    named = (results / 'a.yaml', tmp_path / 'hand.yaml')
    status, out, _ = compare(capsys, *named, '--on', f'{SAMPLE}@9:18', '--json')
    assert status == 0
    found = json.loads(out)
    assert found['parameters']['Fc1'] == {
        'unit': 'N m',
        'value': [None, 0.001],
        'std_error': [None, None],
        'apart': [None, None],
    }
    assert all(error > 0 for error in found['error'][1])
    assert compare(capsys, *named)[0] == 0


def test_what_a_hand_left_out_is_0_in_its_own_place(results, tmp_path, capsys):
    """Without Fc2, J2 is still J2."""
    values = {name: {'value': entry['value']} for name, entry in plain(('weak',))['parameters'].items()}
    values |= {'Fc1': {'value': 0.001}, 'J2': {'value': 0.0003}}
    for name, left_out in (('short', {}), ('long', {'Fc2': {'value': 0}})):
        text = yaml.safe_dump({'schema': 1, 'parameters': values | left_out})
        (tmp_path / f'{name}.yaml').write_text(text)
    named = (tmp_path / 'short.yaml', tmp_path / 'long.yaml', '--on', f'{SAMPLE}@9:12', '--json')
    status, out, _ = compare(capsys, *named)
    short, long = json.loads(out)['error']
    assert (status, short) == (0, long)


@pytest.mark.parametrize('options', [[], ['--on', f'{SAMPLE}@9:12']])
def test_parameters_that_no_rig_has_are_said_to_be_so(results, capsys, options):
    data = yaml.safe_load((results / 'b.yaml').read_text())
    data['parameters']['P1']['value'] = -0.0022
    (results / 'c.yaml').write_text(yaml.safe_dump(data))
    status, out, _ = compare(capsys, results / 'a.yaml', results / 'c.yaml', '--json', *options)
    assert status == 0
    notes = json.loads(out)['notes']
    assert notes[0] == f'{results / "c.yaml"}: not physical: P1 = -0.0022 is not positive'
    assert len(set(notes)) == len(notes)


@pytest.mark.parametrize(
    ('named', 'status', 'sentence'),
    [
        (['a.yaml'], 2, 'is one result alone; name two or more to be compared'),
        (['a.yaml', 'a.yaml'], 2, 'the same result is named twice'),
        (['a.yaml', 'none.yaml'], 1, 'none.yaml cannot be read (No such file or directory)'),
        (['a.yaml', 'other.yaml'], 1, 'other.yaml is no result of schema 1'),
        (['a.yaml', 'b.yaml', '--on', '/nowhere'], 1, 'there is no bag /nowhere'),
        (['a.yaml', 'b.yaml', '--on', f'{SAMPLE}@90:99'], 1, 'the window holds no sample'),
        (['a.yaml', 'b.yaml', '--on', str(SAMPLE), '--joints', 'one'], 2, 'two are expected'),
    ],
)
def test_bad_input_gets_one_sentence(results, capsys, named, status, sentence):
    (results / 'other.yaml').write_text('schema: 2\n')
    ended, out, err = compare(capsys, *(results / n if n.endswith('.yaml') else n for n in named))
    assert (ended, out) == (status, '')
    (line,) = err.strip().splitlines()
    assert sentence in line
