# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The tables of a result, for a terminal and as HTML."""

import json
import re

import pytest

from pendubot_identification.model.parameters import NAMES
from pendubot_identification.report import tables
from pendubot_identification.report.tables import parameter_table, summary
from test.identified import plain
from test.identified import result as typed

MDE = (('energy',), 'auto', 'mde')


def columns(text):
    """Return the cells of every line by its first cell."""
    return {cells[0]: cells[1:] for line in text.splitlines() if (cells := re.split(r'  +', line.strip()))}


@pytest.mark.parametrize('arguments', [(), MDE, (('energy', 'weak'), 'geared')])
def test_the_summary_of_plain_data_fits_a_terminal(arguments):
    result = json.loads(json.dumps(plain(*arguments)))
    text = summary(typed(result))
    assert max(map(len, text.splitlines())) <= 120
    assert f'selected: the criterion {result["criterion"]}, {result["model"]} model' in text
    assert not re.search(r'None|nan|Number', text)
    rows, criteria = columns(text), len(result['criteria'])
    for name, entry in result['parameters'].items():
        cells = rows[f'{name} [{entry["unit"]}]']
        assert criteria == 1 or (len(cells) == criteria and '±' in cells[0])
    assert len(rows['error after 0.5 s']) == criteria + 1, 'and persistence'
    assert rows['level'] == [entry['level'] for entry in result['criteria'].values()]
    assert all(f'not in the model: {entry}' in text for entry in result['not_in_model'])


def test_a_parameter_is_shown_with_its_interval_and_its_reservations():
    result = plain(('energy',))
    rows = columns(parameter_table(typed(result)).text())
    for name, entry in result['parameters'].items():
        value, interval, *reservations = rows[f'{name} [{entry["unit"]}]']
        assert float(value) == pytest.approx(entry['value'], abs=5.1e-5)
        assert reservations == (
            ['on its bound'] if entry['on_bound'] else [] if entry['determined'] else ['undetermined']
        )
        if not entry['on_bound']:
            low, high = map(float, interval.split(' to '))
            assert low <= float(value) <= high
    assert {'on its bound', 'undetermined'} <= {row[-1] for row in rows.values() if row}


def test_a_small_rig_keeps_its_digits():
    result = plain(('weak',), 'viscous')
    for entry in result['parameters'].values():
        entry |= {name: 1e-5 * entry[name] for name in ('value', 'std_error')}
        entry['interval'] = [1e-5 * bound for bound in entry['interval']]
    rows = columns(parameter_table(typed(result)).text())
    for name, entry in result['parameters'].items():
        value, interval, *_ = rows[f'{name} [{entry["unit"]}]']
        assert [float(value), *map(float, interval.split(' to '))] == pytest.approx(
            [entry['value'], *entry['interval']], rel=1e-3
        )


def test_the_papers_estimate_is_shown_beside_the_selected_one():
    result, mde = plain(('weak',), 'auto'), plain(*MDE)['criteria']['energy']
    assert parameter_table(typed(result)).head[3] == 'energy'
    result['criteria']['energy'] = energy = mde
    table = parameter_table(typed(result))
    at = table.head.index('energy by MDE')
    shown = {row[0].split()[0]: row[at] for row in table.rows}
    assert {name for name, value in shown.items() if value == '-'} == set(result['parameters']) - set(NAMES[:7])
    for name, entry in energy['parameters'].items():
        assert float(shown[name]) == pytest.approx(entry['value'], abs=5.1e-5)
    assert 'energy by MDE' not in parameter_table(typed(plain(*MDE))).head


def test_intervals_depend_on_the_degrees_of_freedom_of_the_standard_errors():
    result = plain()
    first = result['parameters']['P1'] | {'std_error': 0.1, 'degrees_of_freedom': 3.0}
    first['interval'] = [first['value'] - 0.318, first['value'] + 0.318]
    for parameters in (result['parameters'], result['criteria'][result['criterion']]['parameters']):
        parameters['P1'] = first
    assert tables.relative_half_width(typed(result).parameters['P1']) == 1.0
    assert tables.estimate(typed(result).parameters['P1'], '.2f').endswith('± 0.32')
    assert '± 0.31' in tables.comparison_table(typed(result)).text()
    first |= {'std_error': 1e-8, 'interval': [first['value'] - 3.18e-8, first['value'] + 3.18e-8]}
    assert tables.estimate(typed(result).parameters['P1'], '.2f').endswith('± 3e-08')


@pytest.mark.parametrize(('accepted', 'status'), [(True, 'compensated'), (False, 'possible')])
def test_effects_are_shown_as_compensated_or_possible(accepted, status):
    effect = {'name': 'dead zone', 'where': 'motor', 'sizes': [0.02], 'gain': 81.2, 'z': 7.3, 'moved': [0.01] * 5}
    result = plain() | {'effects': [effect | {'accepted': accepted}]}
    assert columns(tables.effects_table(typed(result)).text())['dead zone (motor)'] == [status, '81', '7.3']
    assert tables.effects_table(typed(result | {'unmodelled': None, 'effects': []})) is None


def test_the_summary_ends_with_the_warnings_or_the_parameters_that_the_level_ok_does_not_cover():
    result = plain(('energy',))
    last = ' '.join(summary(typed(result)).split()).rsplit(f'{result["level"]}: ', len(result['warnings']))[1:]
    assert [warning.strip() for warning in last] == [' '.join(w.split()) for w in result['warnings']]
    good = plain() | {'not_covered': {'b2': 'its 95 % interval reaches 0'}}
    _, reservations = ' '.join(summary(typed(good)).split()).split('OK: the 95 % intervals hold, given')
    assert 'do not rely on b2 (its 95 % interval reaches 0)' in reservations
    assert 'energy alone, ' in reservations


def test_findings_explained_by_a_fault_are_counted_instead_of_shown():
    result = plain()
    result |= {'level': 'ERROR', 'warnings': ['the elbow is turned'], 'consequences': ['P2 is 0'], 'advice': []}
    for entry in result['criteria'].values():
        entry |= {'level': 'ERROR', 'warnings': result['warnings'], 'consequences': ['P2 is 0', 'P3 is 0']}
    text = summary(typed(result))
    assert text.count('\n') < 20
    assert text.index('ERROR: the elbow is turned') < text.index('6 more follow from that')
    assert 'P2 is 0' not in text


def test_errors_of_the_zeros_are_shown_with_the_half_widths_of_their_intervals():
    result = plain(('energy',))
    assert tables.zero_table(typed(result)) is None
    result['zeros'] = [{'recording': 'swing', 'q1': -3.26, 'q1_std_error': 0.12, 'q2': -0.04, 'q2_std_error': None}]
    text = tables.zero_table(typed(result)).text()
    assert columns(text)['errors of the zeros [degrees]'] == ['q1', 'q2']
    assert columns(text)['swing'] == ['-3.3 ± 0.2', '0.0'], 'a rounded zero has no sign'
    assert text in summary(typed(result))
