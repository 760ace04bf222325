# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Mistakes of users: one sentence, the exit status, and no file written or changed."""

import shutil

import pytest
import yaml

from test.cli.conftest import contents
from test.conftest import ROOT

FILES = {
    'other.yaml': 'schema: 2\nparameters: {}\n',
    'unknown.yaml': 'modle: viscous\n',
    'often.yaml': 'runs: often\n',
    'vector.yaml': 'per_vector: true\n',
    'started.yaml': 'start: [5]\n',
    'file': 'in the way',
    'run.csv': 'time,a,b,u\n0.0,1,2,3\n0.1,2,3,4\n',
}

#: Command lines with invalid inputs or outputs, and a part of the message.
FAILURES = {
    f'identify {"b" * 300}': 'there is no bag bbb',
    'identify swing --output file': 'exists already',
    'identify swing --start /nowhere.yaml': 'there is no file /nowhere.yaml',
    'identify swing --settings started.yaml': "there is no file ['5']",
    'identify swing --report sim': 'sim exists already and is not empty',
    'identify swing --output swing/metadata.yaml --force': 'is read, so it cannot be written as well',
    # Outputs are checked before inputs are read.
    'identify /nowhere --output /nowhere/r.yaml': '/nowhere/r.yaml cannot be written (No such file',
    'identify /nowhere --output swing --force': 'swing is a folder; name a file in it',
    'identify /nowhere --output /dev/full --force': '/dev/full is no regular file; choose another name',
    'identify /nowhere --report file/look': 'cannot be written (Not a directory); choose another folder',
    'report result.yaml --reference result.yaml --output . --force': 'is read, so it cannot be written as well',
    'export result.yaml --format h --output sim': 'sim is a folder; name a file in it',
    'export result.yaml --output link.yaml --force': 'link.yaml is read, so it cannot be written as well',
    'import run.csv --output swing --columns t=time,q1=a,q2=b,tau1=u': 'exists already',
    'excite --design --torque 1 --speed 20 --output file': 'exists already',
    'excite --check file --output file --force': 'so it cannot be written as well',
    'simulate --output swing': 'exists already',
    'demo --output swing': 'exists already',
    'simulate --output never --parameters negative.yaml': 'friction Fc2 = -0.1 is negative',
    'reproduce --output file/out': 'cannot be written',
}
#: Invalid command lines and settings files, and a part of the message.
WRONG_USAGE = {
    '': 'required: SUBCOMMAND',
    'fly': "invalid choice: 'fly'",
    'help me': "invalid choice: 'me'",
    'identify': 'required: BAG',
    'identify x --fly': 'unrecognized arguments: --fly; see pendubot identify --help',
    'identify x --model magic': "invalid choice: 'magic'",
    'identify x --delay magic': "'magic' is not understood; LOW:HIGH or one number",
    'identify x --settings none.yaml': 'there is no file none.yaml',
    'identify x --settings file': 'has no options; lines such as "degrees: true" are expected',
    'identify x --settings unknown.yaml': "there is no option 'modle'; the options are criterion, model",
    'identify x --settings often.yaml': 'runs is often; a whole number from 1 to 100000 is expected',
    'identify x --settings vector.yaml --optimizer lsq': 'per_vector belongs to MDE, and --optimizer lsq ignores it',
    'identify x --torque-constant=-1': 'torque_constant is -1.0; a number from 0 to',
    'identify x --joints arm,arm': 'names 1 joints; two are expected, such as shoulder,elbow',
    'identify x --fix b2': "b2 '' is not understood; LOW:HIGH or one number is expected, such as P1=0:0.5 or b2=0",
    'identify x --bounds P8=0:1': "no parameter 'P8'",
    'identify x --fix b2=0 --bounds b2=0:0.1': 'the interval of b2 was given twice; give one of both',
    'identify x --model viscous --fix Fc1=0': '--bounds Fc1: --model viscous does not have this parameter',
    'identify x --criterion energy --delay 0:0.02': '--delay belongs to weak and likelihood, and --criterion energy',
    'identify swing --columns t=x': '--columns t=x is for files with columns; the stamps of a bag',
    'compare result.yaml': 'is the only result; name two or more different results',
    'compare result.yaml other.yaml other.yaml': 'other.yaml is named twice; name two or more different results',
    'excite --design --torque 1': 'add --torque [N m] and --speed [rad/s]',
    'excite --design --torque -1 --speed 5': 'limit of the torque is -1',
    'excite --design --torque 2000 --speed 5': 'torque is 2000 N m; a number above 0, at most 1000, is expected',
    'excite --design --torque 1 --speed 20 --rate 0': 'sampling rate is 0',
    'export result.yaml': 'no format was given',
    'reproduce --runs 0': '--runs is 0; a number from 1 to 67 is expected',
    'reproduce --only table4,figure2': "there is no 'figure2'; name some of table4, figure1, table7",
    'import swing --output new': 'is no file with columns; a name that ends in .csv',
    'import run.csv --output new --columns q1=a,q2=a': "column 'a' stands for both q1 and q2; name one column for",
    'simulate --output never --samples 0': '0 samples at 100 Hz',
    'simulate --output never --seed=-1': 'seed',
    f'simulate --output never --seed 0 --excitation {ROOT}/config/exciter.yaml': 'not allowed with argument --seed',
}


@pytest.fixture(scope='module')
def folder(inputs, tmp_path_factory):
    """A copy of the folder with invalid files, and its contents."""
    folder = tmp_path_factory.mktemp('refusals') / 'inputs'
    shutil.copytree(inputs, folder)
    for name, text in FILES.items():
        (folder / name).write_text(text)
    (folder / 'link.yaml').symlink_to(folder / 'result.yaml')
    negative = yaml.safe_load((folder / 'result.yaml').read_text())
    negative['parameters'] |= {'Fc1': {'value': 0.1}, 'Fc2': {'value': -0.1}}
    (folder / 'negative.yaml').write_text(yaml.safe_dump(negative))
    return folder, contents(folder)


@pytest.mark.parametrize(
    ('command', 'status', 'sentence'),
    [
        *((command, 1, sentence) for command, sentence in FAILURES.items()),
        *((command, 2, sentence) for command, sentence in WRONG_USAGE.items()),
    ],
)
def test_a_mistake_is_reported_and_changes_no_file(folder, monkeypatch, refused, command, status, sentence):
    path, before = folder
    monkeypatch.chdir(path)
    message = refused(*command.split(), status=status)
    assert sentence in message
    assert len(message) < 500
    assert contents(path) == before


@pytest.mark.parametrize(
    ('failure', 'sentence'),
    [(OSError(28, 'No space left on device'), 'the system refused: '), (MemoryError('80 GB'), 'not enough memory')],
)
def test_a_system_error_is_reported_in_one_sentence(refused, monkeypatch, failure, sentence):
    def refuse(args):
        raise failure

    monkeypatch.setattr('pendubot_identification.cli.info.run_info', refuse)
    assert refused('info', 'bag').startswith(f'pendubot: {sentence}')


@pytest.mark.parametrize('arguments', [('--debug', 'info', '/nowhere'), ('info', '/nowhere', '--debug')])
def test_debug_shows_the_traceback(run, arguments):
    status, _, err = run(*arguments)
    assert status == 1
    assert 'Traceback' in err
