# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What a terminal shows of a result: everything that matters, within its width, from the plain data alone."""

import json
import re
from dataclasses import asdict

import pytest

from pendubot_identification.model.parameters import NAMES, PAPER
from pendubot_identification.report.tables import (
    comparison_table,
    criterion_table,
    parameter_table,
    verdict,
    whole,
    zero_table,
)
from test.identified import made, plain, result

TRUTH = asdict(PAPER)


def columns(text):
    """The cells of every line, by its first."""
    return {cells[0]: cells[1:] for line in text.splitlines() if (cells := re.split(r'  +', line.strip()))}


@pytest.mark.parametrize('truth', [None, TRUTH])
@pytest.mark.parametrize('arguments', [(), (('energy',), 'auto', 'mde'), (('energy', 'weak'), 'geared')])
def test_everything_fits_a_terminal_and_needs_the_plain_data_alone(arguments, truth):
    data = json.loads(json.dumps(plain(*arguments)))
    text = whole(result(data), truth)
    assert max(map(len, text.splitlines())) <= 120
    assert f'published: the answer of {data["criterion"]}, {data["model"]} model' in text
    for name in data['parameters']:
        assert re.search(rf'^{name} ', text, re.MULTILINE)
    assert ('true value' in text) == (truth is not None)
    assert 'None' not in text
    assert 'nan' not in text


def test_a_parameter_is_shown_with_its_interval_beside_the_truth():
    rows = columns(parameter_table(made(), TRUTH))
    assert rows['P4'][2] == 'kg m'
    for name in NAMES[:7]:
        value, interval, _, true, error = rows[name]
        low, high = map(float, interval.split(' to '))
        assert low <= float(value) <= high
        assert float(true) == pytest.approx(TRUTH[name], abs=1e-7)
        assert float(error.rstrip(' %')) == pytest.approx(100 * (float(value) / float(true) - 1), abs=0.2)


def test_doubts_are_marked():
    data = plain(('energy',))
    rows = columns(parameter_table(result(data)))
    marks = {name: rows[name][-1] for name in data['parameters']}
    for name, entry in data['parameters'].items():
        expected = 'on its bound' if entry['on_bound'] else entry['unit'] if entry['determined'] else 'undetermined'
        assert marks[name] == expected
    assert {'on its bound', 'undetermined'} <= set(marks.values())


def test_criteria_stand_side_by_side():
    found = made()
    rows = columns(comparison_table(found))
    assert rows['energy'] == ['weak', 'trajectory']
    assert len(rows['P1 [kg m^2]']) == 3
    assert all('±' in cell for cell in rows['P1 [kg m^2]'])
    assert '± ' not in comparison_table(found, TRUTH)
    rows = columns(whole(found))
    assert rows['energy'] == ['weak', 'trajectory, published', 'standing still']
    assert len(rows['error after 0.5 s']) == 4
    assert rows['level'] == [entry.level.name for entry in found.criteria.values()]


def test_J_of_energy_where_there_are_runs():
    table = criterion_table(made(('energy',), 'auto', 'mde'))
    assert [line.split()[0] for line in table.splitlines()[1:]] == ['training', 'validation']
    assert 'paper' not in table, 'its J is of its own rig'
    assert criterion_table(made(('weak',))) == criterion_table(made()) == ''


def test_the_choice_of_the_model_is_shown_with_its_reason():
    text = whole(made(('energy',), 'auto', 'mde'))
    assert re.search(r'^(viscous|coulomb|rotor|geared) was chosen: the smallest model', text, re.MULTILINE)
    assert 'energy, each of 5 blocks of time' in ' '.join(text.split())
    assert 'was chosen' not in whole(made())


def test_warnings_come_last_and_the_level_first():
    found = made(('energy',))
    last = ' '.join(whole(found).split()).rsplit(f'{found.level.name}: ', len(found.warnings))[1:]
    assert [warning.strip() for warning in last] == [' '.join(w.split()) for w in found.warnings]
    trajectory, ok = whole(made()), 'OK: nothing speaks against these parameters'
    assert 'energy alone, ' in trajectory.split(ok)[1]


def test_what_a_level_of_ok_does_not_cover_is_named_also_of_results_that_only_mark_it():
    data = plain()
    data['not_covered'] = {'b2': 'its 95 % interval reaches 0'}
    assert verdict(result(data)) == 'use these parameters, but do not rely on b2 (its 95 % interval reaches 0)'
    del data['not_covered']
    assert verdict(result(data)) == 'nothing speaks against these parameters'
    data['parameters']['b1']['on_bound'], data['parameters']['b2']['determined'] = True, False
    assert verdict(result(data)) == 'use these parameters, but do not rely on b1 (on its bound), b2 (undetermined)'


def test_where_a_fault_explains_the_rest_little_else_is_shown():
    data = plain()
    data |= {'level': 'ERROR', 'warnings': ['the elbow is turned'], 'consequences': ['P2 is 0'], 'advice': []}
    for entry in data['criteria'].values():
        entry |= {'level': 'ERROR', 'warnings': data['warnings'], 'consequences': ['P2 is 0', 'P3 is 0']}
    text = whole(result(data))
    assert text.count('\n') < 20
    assert text.index('ERROR: the elbow is turned') < text.index('6 more follow from that')
    assert 'P2 is 0' not in text


def test_zeros_are_shown_with_their_errors_where_a_criterion_tells_them():
    data = plain(('energy',))
    assert zero_table(result(data)) == ''
    zero = {'recording': 'swing', 'q1': -3.26, 'q1_std_error': 0.12, 'q2': None, 'q2_std_error': None}
    text = zero_table(result({**data, 'zeros': [zero]}))
    assert columns(text) == {'zeros are off by [degrees]': ['q1', 'q2'], 'swing': ['-3.3 ± 0.1', '-']}
    assert text in whole(result({**data, 'zeros': [zero]}))
