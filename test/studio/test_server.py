# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The studio's server: access, storage of files, concurrent pages, and files too large."""

import gzip
import json
import re
import shlex
import signal
import stat
from pathlib import Path

import numpy as np
import pytest
import yaml

from pendubot_identification.cli.main import main
from pendubot_identification.model.parameters import BALANCE, PAPER
from pendubot_identification.model.simulation import HANGING, simulate
from pendubot_identification.trajectories.trajectory import Trajectory
from test.conftest import SAMPLE
from test.identified import swing, written
from test.recordings.bags import csv
from test.studio.client import Studio

QUICK = {'criterion': 'weak', 'model': 'viscous'}


@pytest.fixture(scope='module')
def studio(tmp_path_factory):
    folder = tmp_path_factory.mktemp('temporary')
    with Studio(env={'TMPDIR': str(folder)}) as program:
        program.folder = folder
        yield program


@pytest.fixture(scope='module')
def page(studio):
    page = studio.open()
    yield page
    studio.request('POST', f'{page.path}end').read()


def test_requests_need_the_token_the_host_name_and_the_local_address(studio):
    policy = studio.request('GET', '').getheader('Content-Security-Policy')
    assert policy.startswith("default-src 'none'")
    assert 'http' not in policy
    for root in ('/', '/x/', studio.root[:-2] + '/', studio.root.upper()):
        for method, path in (('GET', ''), ('POST', 'sessions'), ('PUT', 'sessions/x/files/y')):
            assert studio.request(method, path, root=root).status == 403
    for host in ('evil.example', f'evil.example:{studio.port}', '127.0.0.1'):
        assert studio.request('GET', '', headers={'Host': host}).status == 403
    assert studio.request('GET', '', headers={'Host': f'localhost:{studio.port}'}).status == 200
    with pytest.raises(ConnectionRefusedError):
        studio.request('GET', '', host='127.0.0.2')


@pytest.mark.parametrize(
    'name', ['../up.csv', '.hidden', '-rf', 'a/b/c.csv', 'a\\b', 'a/..', 'x' * 300, 'ü' * 199, 'a\nb']
)
def test_a_file_name_outside_the_folder_is_refused(page, name):
    status, message = page.give(name, b'x')
    assert status in (400, 403, 404, 507)
    assert status == 404 or 'rename' in message or 'token' in message


def test_files_are_private_and_deleted_with_their_page_and_with_the_program(tmp_path):
    """A recording may also be given on the command line."""
    with Studio(SAMPLE, env={'TMPDIR': str(tmp_path)}) as program:
        pages = program.open(), program.open()
        assert pages[0].about['given'] == ['paper_experiment']
        assert pages[0].do('describe', 'paper_experiment')['done']['joints'] == ['shoulder', 'elbow']
        for each in pages:
            assert each.give('run.csv', csv(swing()))[0] == 200
        (root,) = tmp_path.iterdir()
        assert stat.S_IMODE(root.stat().st_mode) == 0o700
        assert len([*root.rglob('run.csv')]) == 2
        program.request('POST', f'{pages[0].path}end').read()
        assert len([*root.rglob('run.csv')]) == 1
        assert pages[0].post('check', 'run.csv').status == 400
        program.halt()
        for number in (signal.SIGHUP, signal.SIGTERM, signal.SIGCONT):
            program.process.send_signal(number)
        assert program.process.wait(30) == 0
        assert [*tmp_path.iterdir()] == []
    assert 'Traceback' not in program.output


def test_a_window_of_a_long_recording_is_identified_and_the_shown_command_gives_the_same_result(
    page, tmp_path, monkeypatch
):
    """Exported files are equal, too; the page of the result is sandboxed."""
    t = np.arange(0, 700, 0.01)
    q, tau = (
        np.column_stack([np.interp(t % 18, swing().t, x) for x in values.T]) for values in (swing().q, swing().tau)
    )
    names = '"Zeit, [ms]"', 'a', 'q2', 'tau1'
    text = csv(Trajectory(1000 * t, q, tau), names=names, convert=lambda q: q * (1, -1))
    assert len(text) > 2 << 20, 'the server keeps a smaller request in memory'
    assert page.give(' run 1.csv', text)[0] == 200
    columns = {'columns': 't=Zeit, [ms],q1=a', 'time_unit': 'ms', 'negate': 'q2'}
    found = page.do('describe', ' run 1.csv', **columns)['done']
    assert 'take windows of it' in found['problem']['sentence']
    assert found['problem']['window'] == ':60'
    assert found['taken'] == {'t': 'Zeit, [ms]', 'q1': 'a', 'q2': 'q2', 'tau1': 'tau1'}
    columns |= {'delay': '-0.01:0.02', 'bounds': 'b2=0, P1=0:0.5', **QUICK}
    done = page.do('identify', ' run 1.csv', windows={'start': '0', 'end': '17'}, **columns)['done']
    assert done['missing'] == {}
    answer = page.studio.request('GET', f'{page.path}output/report.html')
    assert answer.getheader('Content-Security-Policy').startswith('sandbox allow-scripts')
    assert 'same-origin' not in answer.getheader('Content-Security-Policy')
    monkeypatch.chdir(tmp_path)
    Path(' run 1.csv').write_text(text)
    words = shlex.split(done['command'])
    assert ' run 1.csv@0:17' in words
    assert main([*words[1:], '--output', 'result.yaml']) == 0
    by_shell = Path('result.yaml').read_text()
    assert page.output('result.yaml') == by_shell
    assert yaml.safe_load(by_shell)['parameters']['P4']['value'] == pytest.approx(PAPER.P4, rel=0.05)
    assert main(['export', 'result.yaml', '--output', 'rig.urdf']) == 0
    assert page.output('pendubot.urdf') == Path('rig.urdf').read_text()


def test_two_pages_work_concurrently_and_independently(studio, tmp_path):
    """The fit of one starts from a result."""
    t = np.arange(0, 18, 0.005)
    tau = np.column_stack([0.6 * np.sign(np.sin(9 * t)) * (np.sin(2.3 * t) > 0), np.zeros_like(t)])
    motions, pages = (swing(), simulate(BALANCE, t, tau, HANGING)), (studio.open(), studio.open())
    for page, each, name in zip(pages, motions, ('phi', 'q1'), strict=True):
        assert page.give('run.csv', csv(each, names=('t', name, 'q2', 'tau1')))[0] == 200
    pages[0].give('before it.yaml', written(tmp_path / 'before.yaml', PAPER).read_bytes())
    starting = QUICK | {'criterion': 'likelihood', 'start': 'before it.yaml', 'columns': 'q1=phi'}
    answers = [page.post('identify', 'run.csv', **how) for page, how in zip(pages, (starting, QUICK), strict=True)]
    first = [json.loads(answer.readline()) for answer in answers]
    assert all('progress' in event for event in first), 'both must run at once'
    commands = [json.loads(answer.read().splitlines()[-1])['done']['command'] for answer in answers]
    assert [command.endswith(" --start='before it.yaml' --columns q1=phi") for command in commands] == [True, False]
    started, other = (yaml.safe_load(page.output('result.yaml')) for page in pages)
    assert started['made_by']['start'][:7] == PAPER.vector().tolist()
    assert other['made_by']['start'] is None
    for found, true in ((started, PAPER), (other, BALANCE)):
        assert found['parameters']['P4']['value'] == pytest.approx(true.P4, rel=0.02)


def test_the_shell_gives_the_same_checks(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    text = csv(swing()[:500], names=('t', 'phi', 'q2', 'tau1'))
    page.give('run.csv', text)
    (tmp_path / 'run.csv').write_text(text)
    options = {'columns': 'q1=phi', 'negate': 'tau1'}
    assert main(['identify', '--check', 'run.csv', '--columns', 'q1=phi', '--negate', 'tau1', '--json']) == 3
    assert json.loads(capsys.readouterr().out) == page.do('check', 'run.csv', **options)['done']
    assert main(['identify', '--check', 'run.csv', '--output', 'result.yaml']) == 2
    assert '--check writes no file' in capsys.readouterr().err


BROKEN = {
    'german.csv': b'Zeit;q1;q2;tau1\n' + b''.join(b'0,%02d;0,1;0,2;0,3\n' % k for k in range(99)),
    'cut.csv.gz': gzip.compress(b't,q1,q2,tau1\n' * 99)[:40],
    'broken.mcap': b'\x89MCAP0\r\n' + bytes(99),
}


def test_an_invalid_file_gives_the_same_message_as_in_the_shell(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for name, content in BROKEN.items():
        Path(name).write_bytes(content)
        assert main(['identify', name]) == 1
        message = ' '.join(capsys.readouterr().err.split())
        page.give(name, content)
        described = page.do('describe', name)['done']['problem']
        assert message == f'pendubot: {described["sentence"]}'
        assert (described['remedy'] == {'decimal': 'comma'}) == (name == 'german.csv')
    (checked,) = page.do('check', name)['done']
    assert checked['sentence'] == described['sentence']


def test_on_a_full_disk_the_message_has_a_remedy_and_no_private_path(tmp_path):
    with Studio(env={'TMPDIR': str(tmp_path)}, before=('prlimit', '--fsize=300000')) as program:
        message = program.open().do('identify', 'paper_experiment', **QUICK)['problem']['sentence']
    assert 'cannot be stored (File too large)' in message
    assert 'free space' in message
    assert str(tmp_path) not in message


def test_a_missing_recording_and_an_invalid_port_on_the_command_line_are_reported(tmp_path, refused):
    line = refused('studio', tmp_path / 'none.csv', '--no-browser')
    assert line == f'pendubot: there is no recording {tmp_path / "none.csv"}; check its name and folder'
    line = refused('studio', '--no-browser', '--port', '70000')
    assert line.startswith('pendubot: port 70000 cannot be opened (')


def test_unknown_options_and_recordings_are_refused(page):
    for wrong in ({'start': '/etc/passwd'}, {'nonsense': '1'}):
        answer = page.post('check', 'paper_experiment', **wrong)
        assert answer.status == 400
        assert re.search('there is no (option|recording)', answer.read().decode())
    for body in ('{', '[]', '{"bags": [1]}'):
        answer = page.studio.request('POST', f'{page.path}check', body)
        assert answer.status == 400
        assert answer.read().decode().endswith('; load the page again')
    assert page.post('check', '/etc/passwd').status == 400
    assert 'is expected' in page.do('check', 'paper_experiment', gear='x')['problem']['sentence']
    for bounds, refused in (('b2', 'is expected'), ('b2=0, b2=1', 'the interval of b2 was given twice')):
        assert refused in page.do('identify', 'paper_experiment', bounds=bounds)['problem']['sentence']
    assert page.do('describe', 'paper_experiment', criterion='weak', bounds='b2=0')['done']
