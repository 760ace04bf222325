"""What a terminal shows of a result: everything that matters, within its width, from the plain data alone."""

import json
import re
from dataclasses import asdict

import pytest

from pendubot_identification.core.model.parameters import NAMES, PAPER
from pendubot_identification.report.tables import comparison_table, criterion_table, parameter_table, whole, zero_table
from test.results import plain

TRUTH = asdict(PAPER)


def columns(text):
    """The cells of every line, by its first."""
    return {cells[0]: cells[1:] for line in text.splitlines() if (cells := re.split(r'  +', line.strip()))}


@pytest.mark.parametrize('truth', [None, TRUTH])
@pytest.mark.parametrize('arguments', [(), (('energy',), 'auto', 'mde'), (('energy', 'weak'), 'geared')])
def test_everything_fits_a_terminal_and_needs_the_plain_data_alone(arguments, truth):
    result = json.loads(json.dumps(plain(*arguments)))
    text = whole(result, truth)
    assert max(map(len, text.splitlines())) <= 120
    assert f'published: the answer of {result["criterion"]}, {result["model"]} model' in text
    for name in result['parameters']:
        assert re.search(rf'^{name} ', text, re.MULTILINE)
    assert ('true value' in text) == (truth is not None)
    assert 'None' not in text
    assert 'nan' not in text


def test_a_parameter_is_shown_with_its_interval_beside_the_truth():
    result = plain()
    rows = columns(parameter_table(result, TRUTH))
    assert rows['P4'][2] == 'kg m'
    for name in NAMES[:7]:
        value, interval, _, true, error = rows[name]
        low, high = map(float, interval.split(' to '))
        assert low <= float(value) <= high
        assert float(true) == pytest.approx(TRUTH[name], abs=1e-7)
        assert float(error.rstrip(' %')) == pytest.approx(100 * (float(value) / float(true) - 1), abs=0.2)


def test_what_is_not_in_the_model_has_no_row_and_is_named():
    shown = parameter_table(plain(('weak',), 'geared'))
    assert 'not in the model: k2, for the effort of the elbow is zero throughout' in shown
    assert [line.split()[0] for line in shown.splitlines()[1:-1]] == list(NAMES[:13])


def test_doubts_are_marked():
    result = plain(('energy',))
    rows = columns(parameter_table(result))
    marks = {name: rows[name][-1] for name in result['parameters']}
    for name, entry in result['parameters'].items():
        expected = 'on its bound' if entry['on_bound'] else entry['unit'] if entry['determined'] else 'undetermined'
        assert marks[name] == expected
    assert {'on its bound', 'undetermined'} <= set(marks.values())


def test_criteria_stand_side_by_side():
    result = plain()
    rows = columns(comparison_table(result))
    assert rows['energy'] == ['weak', 'trajectory']
    assert len(rows['P1 [kg m^2]']) == 3
    assert all('±' in cell for cell in rows['P1 [kg m^2]'])
    assert '± ' not in comparison_table(result, TRUTH)
    rows = columns(whole(result))
    assert rows['energy'] == ['weak', 'trajectory, published', 'standing still']
    assert len(rows['error after 0.5 s']) == 4
    assert rows['level'] == [entry['level'] for entry in result['criteria'].values()]


def test_the_papers_J_stands_beside_that_of_energy_where_there_are_runs():
    table = criterion_table(plain(('energy',), 'auto', 'mde'))
    assert len(re.findall('the paper, on its own rig', table)) == 2
    assert all(number in table for number in ('2.37e-03', '2.39e-03', '3.03e-03'))
    assert criterion_table(plain(('weak',))) == criterion_table(plain()) == ''


def test_the_choice_of_the_model_is_shown_with_its_reason():
    text = whole(plain(('energy',), 'auto', 'mde'))
    assert re.search(r'^(viscous|coulomb|rotor|geared) was chosen: the smallest model', text, re.MULTILINE)
    assert 'energy, each of 5 blocks of time' in ' '.join(text.split())
    assert 'was chosen' not in whole(plain())


def test_warnings_come_last_and_the_level_first():
    result = plain(('energy',))
    last = ' '.join(whole(result).split()).rsplit(f'{result["level"]}: ', len(result['warnings']))[1:]
    assert [warning.strip() for warning in last] == [' '.join(w.split()) for w in result['warnings']]
    trajectory = whole(plain())
    assert 'OK: no warnings' in trajectory
    assert 'energy alone, ' in trajectory.split('OK: no warnings')[1]


def test_zeros_are_shown_with_their_errors_where_a_criterion_tells_them():
    result = plain(('energy',))
    assert zero_table(result) == ''
    zero = {'recording': 'swing', 'q1': -3.26, 'q1_std_error': 0.12, 'q2': None, 'q2_std_error': None}
    text = zero_table({**result, 'zeros': [zero]})
    assert columns(text) == {'zeros are off by [degrees]': ['q1', 'q2'], 'swing': ['-3.3 ± 0.1', '-']}
    assert text in whole({**result, 'zeros': [zero]})
