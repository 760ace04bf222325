# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What a user can do wrong: one sentence, the exit status that goes with it, and no file made or changed."""

import shutil

import pytest
import yaml

from test.cli.conftest import contents
from test.conftest import ROOT

FILES = {
    'empty.yaml': 'schema: 1\n',
    'other.yaml': 'schema: 2\nparameters: {}\n',
    'list.yaml': '[1, 2]',
    'broken.yaml': ': : :',
    'few.yaml': 'schema: 1\nparameters: {P1: {value: 1}}\n',
    'file': 'in the way',
    'run.csv': 'time,a,b,u\n0.0,1,2,3\n0.1,2,3,4\n',
    'late.csv': 't,q1,q2,tau1\n' + ''.join(f'{0.01 * k},1,2,3\n' for k in range(100)) + '9.3e9,0,0,0\n',
}
PULSES = f'simulate --output never --excitation {ROOT}/config/exciter.yaml'

#: Command lines, and a part of what is said. Of these, what is read or written makes no sense.
FAILURES = {
    'identify /nowhere': 'there is no bag /nowhere',
    'identify run.csv': "has no column 't' for t; its columns are time, a, b, u: name",
    'identify nowhere.csv': 'nowhere.csv cannot be read: No such file',
    f'identify {"b" * 300}': 'there is no bag bbb',
    'identify swing --topic /imu': 'holds nothing on /imu; its topics are /joint_states',
    'identify swing --joints a,b': "has no joint 'a'; its joints are shoulder, elbow",
    'identify swing@1e300:': '@1e+300:: the window holds no sample',
    'identify swing@1:1.1': '10 samples over 0.090 s are too few',
    'identify swing --sliding 100': 'shorter than the sliding window',
    'identify swing --output file': 'exists already',
    'identify swing --start /nowhere.yaml': '/nowhere.yaml cannot be read',
    'identify swing --report look': 'look exists already and holds something',
    'identify swing --output swing/metadata.yaml --force': 'is read, so it cannot be written as well',
    'identify swing --output swing/paper_experiment_0.mcap --force': 'is read, so it cannot be written as well',
    'identify swing --output result.yaml --start result.yaml --force': 'is read, so it cannot be written as well',
    'identify swing --report . --reference result.yaml --force': 'is read, so it cannot be written as well',
    # Before anything is read.
    'identify /nowhere --output /nowhere/r.yaml': '/nowhere/r.yaml cannot be written (No such file',
    'identify /nowhere --output swing --force': 'swing is a folder; name a file in it',
    'identify /nowhere --report file/look': 'cannot be written (Not a directory); choose a folder that can be',
    'identify /nowhere --report /proc/look': '/proc/look cannot be written (',
    'report result.yaml --output file': 'file cannot be written (File exists); choose a folder that can be',
    'report result.yaml --output look': 'look exists already and holds something',
    'report result.yaml --reference result.yaml --output . --force': 'is read, so it cannot be written as well',
    'report result.yaml --reference other.yaml': 'no result of schema 1',
    'report none.yaml': 'cannot be read (No such file or directory); name a file that pendubot identify wrote',
    'report list.yaml': 'is no result of schema 1',
    'report broken.yaml': 'is no YAML file',
    'report few.yaml': 'has no parameter vector: check P2, P3, P4, P5, b1, b2; one number each is expected',
    'compare result.yaml none.yaml': 'none.yaml cannot be read (No such file or directory)',
    'compare result.yaml other.yaml': 'other.yaml is no result of schema 1',
    'compare result.yaml look/result.yaml --on /nowhere': 'there is no bag /nowhere',
    'compare result.yaml look/result.yaml --on swing@90:99': 'the window holds no sample',
    'export empty.yaml --format c': 'no parameter vector',
    'export result.yaml --output no/such/folder/p.h': 'cannot be written',
    'export result.yaml --output file --format c': 'exists already',
    'export result.yaml --output ./result.yaml --force': 'is read, so it cannot be written as well',
    'export result.yaml --output link.yaml --force': 'link.yaml is read, so it cannot be written as well',
    'import-csv run.csv --output new': "no column 't' for t; its columns are time, a, b, u",
    'import-csv late.csv --output new': 'a stamp of ROS ends in 2038',
    'import-csv run.csv --output swing --columns t=time,q1=a,q2=b,tau1=u': 'exists already',
    'simulate --output swing': 'exists already',
    'simulate --output never --samples 300 --amplitude 1e300 1e301': 'N m are too large',
    'simulate --output never --parameters negative.yaml': 'friction Fc2 = -0.1 is negative',
    'simulate --output never --parameters few.yaml': 'b1',
    'info nowhere': 'there is no bag',
    'repair nowhere': 'there is no bag nowhere',
    'repair swing --output swing --force': 'is the bag itself',
    'repair swing --output look': 'exists already',
}
#: What can be told from the command line alone.
WRONG_USAGE = {
    'compare result.yaml other.yaml --degrees': '--degrees says how a recording is read, and none is; add --on BAG',
    'identify swing --fix Fc1=0.1': 'Fc1 from 0.1 to 0.1 is of models that have it',
    'identify swing --fix J2=1e-3 --model auto': 'add --model rotor, or another that has it',
    'help me': "there is no subcommand 'me'; those that there are: identify, track, report",
    '': 'required: SUBCOMMAND',
    'fly': "invalid choice: 'fly'",
    'identify x --fly': 'unrecognized arguments: --fly; pendubot identify --help says what there is',
    'identify': 'required: BAG',
    'identify x --model magic': "invalid choice: 'magic'",
    'identify x --runs magic': "invalid int value: 'magic'",
    'identify x --delay magic': "'magic' is not understood; LOW:HIGH or one number",
    'identify x --joints elbow,elbow': 'names 1 joints; two are expected',
    'identify x --runs 100000000': 'runs is 100000000; a whole number from 1 to 100000 is expected',
    'identify x@9:2': 'reversed',
    'identify x@one:2': 'must be numbers of seconds',
    'identify x --fix b2': "--fix 'b2' is not understood; NAME=VALUE is expected, such as b2=0",
    'identify x --model viscous --fix Fc1=0': '--fix Fc1=0 is of a parameter that --model viscous does not have',
    'identify x --bounds P1=2:1': 'bounds of P1 are inverted',
    'identify x --bounds P1=2': 'NAME=LOW:HIGH is expected',
    'identify x --bounds P8=0:1': "no parameter 'P8'",
    'identify x --bounds Fc1=0:1 --model viscous': 'that --model viscous does not have',
    'identify x --criterion energy,magic': 'criterion is magic; one of energy, weak, likelihood is',
    'identify x --criterion energy,': 'criterion is empty; one of energy, weak, likelihood is expected',
    'identify x --smoothing 11': 'smoothing is 11.0; a number with a decimal point from 0 to 10 s is expected',
    'identify x --delay 0.02:0.01': 'searched from 0.02 to 0.01 s',
    'identify x --runs 3 --optimizer lsq': '--runs is of MDE, and --optimizer lsq does without',
    'identify x --per-vector --optimizer lsq': '--per-vector is of MDE',
    'identify x --criterion trajectory': 'the criterion trajectory was replaced by likelihood; ask for likelihood',
    'identify x --criterion energy --delay 0:0.02': '--delay is of weak and likelihood, and --criterion energy does',
    'identify x --criterion energy,weak --start r.yaml': '--start is of likelihood, and --criterion energy,weak does',
    'identify x --reference result.yaml': 'add --report DIR',
    'compare result.yaml': 'is one result alone; name two or more to be compared',
    'compare result.yaml result.yaml': 'the same result is named twice',
    'compare result.yaml look/result.yaml --on swing --joints one': 'two are expected',
    'export result.yaml': 'no format was given',
    'export result.yaml --output parameters.txt': 'no suffix that names a format',
    **{f'import-csv run.csv --output new --columns {c}': 't=NAME,q1=NAME' for c in ('time', 't=', '=time', 't=a,t=b')},
    'import-csv run.csv --output new --columns q1=a,q2=a': "column 'a' stands for both q1 and q2; name one column for",
    'import-csv run.csv --output new --columns q3=a': "--columns does not know the quantity 'q3'; t, q1",
    'simulate --output never --samples 0': '0 samples at 100 Hz',
    'simulate --output never --rate nan': 'a rate from 1 to 100000 Hz',
    'simulate --output never --rate 1e-9': 'a rate from 1 to 100000 Hz',
    'simulate --output never --width 2': 'width',
    'simulate --output never --amplitude 1 -1': 'amplitude',
    f'{PULSES} --amplitude -1 1': 'and so does --amplitude; give one of the two',
    f'{PULSES} --seed 0': 'and so does --seed; give one of the two',
    'demo --output new --seed=-1': "'-1' is no seed; a whole number from 0 to 2147483647 is expected",
    'demo --output new --seed=2147483648': "'2147483648' is no seed",
}


@pytest.fixture(scope='module')
def folder(made, tmp_path_factory):
    """The same with files that are of no use."""
    folder = tmp_path_factory.mktemp('refusals') / 'made'
    shutil.copytree(made, folder)
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
def test_what_a_user_did_wrong_is_one_sentence(folder, monkeypatch, refused, command, status, sentence):
    path, before = folder
    monkeypatch.chdir(path)
    said = refused(*command.split(), status=status)
    assert sentence in said
    assert len(said) < 500
    assert contents(path) == before


@pytest.mark.parametrize(
    ('failure', 'sentence'),
    [(OSError(28, 'No space left on device'), 'the system refused: '), (MemoryError('80 GB'), 'not enough memory')],
)
def test_what_the_system_refuses_is_one_sentence(refused, monkeypatch, failure, sentence):
    def refuse(args):
        raise failure

    monkeypatch.setattr('pendubot_identification.cli.info.run', refuse)
    assert refused('info', 'bag').startswith(f'pendubot: {sentence}')


@pytest.mark.parametrize('arguments', [('--debug', 'info', '/nowhere'), ('info', '/nowhere', '--debug')])
def test_debug_shows_where(run, arguments):
    status, _, err = run(*arguments)
    assert status == 1
    assert 'Traceback' in err


def test_help_of_every_subcommand_is_worth_reading(run):
    for command in ('', 'identify', 'report', 'compare', 'export', 'import-csv', 'simulate', 'info', 'repair', 'demo'):
        status, out, _ = run(*command.split(), '--help')
        assert status == 0
        assert len(out.splitlines()) > 8
