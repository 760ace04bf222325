# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Result files: content, order, provenance, reading, and errors."""

import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import yaml

from pendubot_identification.errors import ResultError
from pendubot_identification.identification.estimate import Zeros
from pendubot_identification.identification.settings import CRITERIA, Settings
from pendubot_identification.model.parameters import NAMES, Bounds
from pendubot_identification.recordings.datasets import load_datasets
from pendubot_identification.results.computation import assemble_result
from pendubot_identification.results.provenance import recordings, settings
from pendubot_identification.results.result import (
    Parameter,
    PartialResult,
    estimate_of,
    read_complete_result,
    read_result,
    result_text,
)
from pendubot_identification.results.result import plain as plain_of
from test.conftest import SAMPLE
from test.identified import SOURCE, identified, made, plain, write


def test_a_written_result_is_read_back(tmp_path):
    result, path = made(), tmp_path / 'result.yaml'
    path.write_text(result_text(result))
    assert read_result(path) == read_complete_result(path) == result
    assert json.loads(json.dumps(plain_of(result), allow_nan=False)) == yaml.safe_load(path.open())
    text = path.read_text()
    assert result_text(read_complete_result(path)) == text
    assert max(map(len, text.splitlines())) < 130
    assert '&id' not in text, 'no aliases, for readability'


def test_parameters_of_a_missing_elbow_motor_are_not_in_the_model(tmp_path):
    result = made(('weak',), 'geared')
    assert result.not_in_model == ['k2, because the effort of the elbow is always zero']
    assert 'k2' not in result.not_covered
    assert np.shape(result.covariance) == np.shape(result.criteria['weak'].correlation) == (13, 13)
    (tmp_path / 'result.yaml').write_text(result_text(result))
    parameters, std_error = estimate_of(read_result(tmp_path / 'result.yaml'))
    assert parameters.vector('geared').tolist() == identified(('weak',), 'geared').best.theta.tolist()
    assert std_error.tolist() == [*(entry.std_error for entry in result.parameters.values()), 0.0]
    assert made(('weak',), 'rotor').not_in_model == []


def test_every_number_has_its_uncertainty():
    best, data = identified().best, plain()
    for k, entry in enumerate(data['parameters'].values()):
        assert (entry['value'], entry['std_error']) == (best.theta[k], best.std_error[k])
        assert entry['interval'] == tuple(best.intervals[k])
        assert not entry['on_bound']
    assert data['effort']['linear_lag'] == pytest.approx(data['effort']['delay'] + 0.005, rel=1e-3)
    np.testing.assert_allclose(data['prediction']['fit']['dq2'], best.prediction.fit[:, 3])
    assert data['prediction']['method'] == 'on data that was not used for estimation'
    assert data['criteria'][data['criterion']]['J'] == data['J']
    assert list(data['criteria']) == list(CRITERIA)


def test_unknown_numbers_are_null_and_parameters_on_a_bound_are_marked():
    best, data = identified(('energy',), validate=False).best, plain(('energy',), validate=False)
    on_bound = [entry['on_bound'] for entry in data['parameters'].values()]
    assert on_bound == (~best.free).tolist()
    assert any(on_bound), 'the recording is too short for this criterion'
    assert data['covariance'][on_bound.index(True)] == [None] * 7
    assert data['J']['validation'] is None
    assert data['effort']['delay_std_error'] is None


def test_zeros_are_in_degrees_by_recording():
    angles, errors = np.radians([[1.0, np.nan], [-2.0, 0.5]]), np.radians([[0.1, np.nan], [0.2, 0.3]])
    found = identified(('energy',))
    best = replace(found.best, zeros=Zeros(('first', 'second'), angles, errors))
    first, second = assemble_result(replace(found, estimates=(best,)), [SOURCE]).zeros
    assert (first.recording, first.unit, second.q1) == ('first', 'degree', None)
    np.testing.assert_allclose([first.q1, first.q1_std_error, first.q2, first.q2_std_error], [1, 0.1, -2, 0.2])
    assert made(('energy',)).zeros == []


def test_handwritten_numbers_are_read(tmp_path):
    """YAML reads 4e-4 without a point as text, and 1 as an integer."""
    path = tmp_path / 'r.yaml'
    others = ', '.join(f'{name}: {{value: 1}}' for name in ('P1', 'P3', 'P4', 'P5', 'b1', 'b2'))
    entry = '{value: 4e-4, std_error: 2e-5, interval: [36e-5, .inf]}'
    path.write_text(f'schema: 1\nparameters: {{P2: {entry}, {others}}}\n')
    given = read_result(path)
    assert type(given) is PartialResult
    assert tuple(given.parameters) == NAMES[:7], 'in the order of theta'
    assert given.parameters['P2'] == Parameter(value=4e-4, std_error=2e-5, interval=(36e-5, None))
    assert all(isinstance(entry.value, float) for entry in given.parameters.values())


@pytest.mark.parametrize('text', ['', '[]', 'parameters: {P1: {value: 1}}', 'schema: 2', '{'])
def test_a_file_without_a_result_is_refused_in_one_sentence(tmp_path, text):
    (tmp_path / 'r.yaml').write_text(text)
    with pytest.raises(ResultError, match=r'r.yaml is no (result of schema 1|YAML file); name a file that pendubot'):
        read_result(tmp_path / 'r.yaml')


@pytest.mark.parametrize(
    ('path', 'entry', 'sentence'),
    [
        (
            ('parameters', 'b2', 'value'),
            'much',
            "parameters.b2.value is 'much'; a number is expected; name a file that pendubot identify",
        ),
        (('parameters', 'b2', 'value'), None, 'parameters.b2.value is None; .*; name a file that pendubot'),
        (('parameters', 'b2', 'value'), float('nan'), 'parameters.b2.value is nan; a number is expected'),
        (('parameters', 'b2', 'std_error'), -1, 'parameters.b2.std_error is -1; a number of at least 0'),
        (('parameters', 'b2', 'value'), True, 'parameters.b2.value is True; a number is expected'),
        (('parameters', 'b2'), 0.1, 'parameters.b2 is 0.1; .*dict'),
        (('parameters', 'b2', 'interval'), 0.1, 'parameters.b2.interval is 0.1; .*tuple'),
        (('parameters', 'b2', 'interval'), [1, 'b'], "parameters.b2.interval.1 is 'b'; a number is expected"),
        (('parameters', 'b2', 'value'), 'absent', 'parameters.b2.*value.*; name a file'),
        (('parameters', 'b2'), 'absent', 'check b2; one number each is expected for P1, P2'),
        (('level',), 'absent', 'level.*; name a file that pendubot identify wrote, unchanged'),
        (('bags', 0, 'sha256'), 'absent', 'bags.0.*sha256.*; name a file'),
    ],
)
def test_an_invalid_or_absent_entry_is_refused_in_one_sentence(tmp_path, path, entry, sentence):
    inner = data = plain()
    *keys, last = path
    for key in keys:
        inner = inner[key]
    inner[last] = entry
    if entry == 'absent':
        del inner[last]
    write(tmp_path / 'r.yaml', data)
    with pytest.raises(ResultError, match=f'r.yaml:? .*{sentence}'):
        read_complete_result(tmp_path / 'r.yaml')


def test_reading_parameters_imports_no_large_package():
    """A virtual board with the parameters of a result starts at once."""
    code = (
        'import sys, pendubot_identification.results.result\n'
        "assert not {'scipy', 'mcap', 'rosbags'} & set(sys.modules), sorted(sys.modules)"
    )
    subprocess.run([sys.executable, '-c', code], check=True, timeout=60)


@pytest.mark.parametrize(('bags', 'validate'), [(['{}'], []), (['{}@5:9'], []), (['{}@0:6', '{}@12:'], ['{}'])])
def test_recordings_of_a_result_are_divided_as_in_the_identification(bags, validate):
    data = load_datasets([b.format(SAMPLE) for b in bags], [v.format(SAMPLE) for v in validate])
    again = recordings(assemble_result(identified(('weak',)), data.sources))
    for motions, before in zip(again, (data.training, data.validation), strict=True):
        assert [m.name for m in motions] == [m.name for m in before]
        for motion, other in zip(motions, before, strict=True):
            np.testing.assert_array_equal(np.column_stack([motion.t, motion.q]), np.column_stack([other.t, other.q]))


def test_settings_of_a_result_are_read_back():
    options = {'sliding': 0.4, 'smoothing': 0.03, 'hold': 'linear', 'delays': (-0.02, 0.01)}
    options |= {'link_length': 0.2, 'link_mass': 0.3}
    bounds = Bounds(np.zeros(9), np.arange(1.0, 10.0), NAMES[:9])
    original = Settings(('weak', 'energy'), 'coulomb', 'lsq', seed=7, bounds=bounds, **options)
    again = settings(assemble_result(replace(identified(('weak',)), settings=original), []))
    assert repr(again) == repr(original)
