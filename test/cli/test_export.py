# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

import json

import pytest
import yaml

from pendubot_identification.cli.export import FORMATS as NAMED
from pendubot_identification.results.export import FORMATS
from test.identified import plain


@pytest.fixture
def result(tmp_path):
    path = tmp_path / 'result.yaml'
    path.write_text(yaml.safe_dump(plain(('weak',))))
    return path


def test_help_names_every_format():
    assert tuple(FORMATS) == NAMED


@pytest.mark.parametrize(('suffix', 'name'), [('.m', 'matlab'), ('.h', 'c'), ('.json', 'json'), ('.yaml', 'yaml')])
def test_the_suffix_says_which_format_and_force_replaces_a_file(result, tmp_path, run, suffix, name):
    output = tmp_path / f'parameters{suffix}'
    output.write_text('mine')
    assert run('export', result, '--output', output, '--force')[:2] == (0, f'written to {output}\n')
    assert run('export', result, '--format', name)[:2] == (0, output.read_text())


@pytest.mark.parametrize('name', NAMED)
def test_parameters_that_no_rig_has_are_said_to_be_so(result, run, name):
    """Beside what the result says of itself; its numbers may be those of a hand, which YAML takes for words."""
    data = yaml.safe_load(result.read_text()) | {'level': 'WARN', 'warnings': ['so so']}
    data['parameters']['P1']['value'] = '-22e-4'
    result.write_text(yaml.safe_dump(data))
    status, out, err = run('export', result, '--format', name)
    assert status == 0
    assert err.startswith('level ERROR: so so; not physical: P1 = -0.0022 is not positive')
    assert 'not physical: P1 = -0.0022 is not positive' in out
    if name == 'json':
        assert json.loads(out)['parameters']['P1']['value'] == -0.0022
