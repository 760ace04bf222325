# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

import json

import pytest
import yaml

from pendubot_identification.cli.export import FORMATS as NAMED
from pendubot_identification.cli.main import main
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
def test_the_suffix_says_which_format(result, tmp_path, capsys, suffix, name):
    output = tmp_path / f'parameters{suffix}'
    assert main(['export', str(result), '--output', str(output)]) == 0
    assert f'written to {output}' in capsys.readouterr().out
    assert main(['export', str(result), '--format', name]) == 0
    assert capsys.readouterr().out == output.read_text()


def test_an_existing_file_stays_and_force_replaces_it(result, tmp_path, capsys):
    output = tmp_path / 'parameters.json'
    output.write_text('mine')
    assert main(['export', str(result), '--output', str(output)]) == 1
    assert 'exists already' in capsys.readouterr().err
    assert output.read_text() == 'mine'
    assert main(['export', str(result), '--output', str(output), '--force']) == 0
    assert json.loads(output.read_text())['schema'] == 1


def test_the_result_itself_is_never_written_over(result, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    before = result.read_text()
    (tmp_path / 'link.yaml').symlink_to(result)
    for output in ('result.yaml', './result.yaml', 'link.yaml'):
        assert main(['export', str(result), '--output', output, '--force']) == 1
        assert f'{output.removeprefix("./")} is read, so it cannot be written as well' in capsys.readouterr().err
    assert result.read_text() == before


def test_a_doubtful_result_is_exported_and_said_to_be_doubtful(result, tmp_path, capsys):
    data = yaml.safe_load(result.read_text()) | {'level': 'ERROR', 'warnings': ['not physical: P1']}
    result.write_text(yaml.safe_dump(data))
    assert main(['export', str(result), '--format', 'c']) == 0
    printed = capsys.readouterr()
    assert 'level ERROR: not physical: P1' in printed.err
    assert 'level: ERROR' in printed.out


@pytest.mark.parametrize('name', NAMED)
def test_parameters_that_no_rig_has_are_said_to_be_so(result, capsys, name):
    data = yaml.safe_load(result.read_text())
    data['parameters']['P1']['value'] = -0.0022
    result.write_text(yaml.safe_dump(data))
    assert main(['export', str(result), '--format', name]) == 0
    printed = capsys.readouterr()
    for text in printed:
        assert 'not physical: P1 = -0.0022 is not positive' in text
    assert 'level ERROR' in printed.err


def test_numbers_that_a_hand_wrote_are_numbers(tmp_path, capsys):
    names = ('P1', 'P2', 'P4', 'P5', 'b1', 'b2')
    entries = ', '.join(f'{name}: {{value: 4e-4}}' for name in names)
    (tmp_path / 'hand.yaml').write_text(f'schema: 1\nparameters: {{{entries}, P3: {{value: 0}}}}\n')
    assert main(['export', str(tmp_path / 'hand.yaml'), '--format', 'json']) == 0
    parameters = json.loads(capsys.readouterr().out)['parameters']
    assert [parameters[name]['value'] for name in names] == [4e-4] * 6
    assert parameters['P1']['determined'] is None, 'nobody said so'


@pytest.mark.parametrize(
    ('arguments', 'status', 'sentence'),
    [
        (['result.yaml'], 2, 'no format was given'),
        (['result.yaml', '--output', 'parameters.txt'], 2, 'no suffix that names a format'),
        (['missing.yaml', '--format', 'c'], 1, 'cannot be read'),
        (['empty.yaml', '--format', 'c'], 1, 'no parameter vector'),
        (['result.yaml', '--output', 'no/such/folder/p.h'], 1, 'cannot be written'),
    ],
)
def test_what_a_user_can_do_wrong_is_explained(result, tmp_path, monkeypatch, capsys, arguments, status, sentence):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'empty.yaml').write_text('schema: 1\n')
    assert main(['export', *arguments]) == status
    error = capsys.readouterr().err
    assert sentence in error
    assert 'Traceback' not in error
