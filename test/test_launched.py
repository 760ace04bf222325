# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The launch files by the real launch library, with real programs; skipped where the library is not installed."""

import importlib.util
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml

from test.conftest import ROOT
from test.processes import Program
from test.test_launch import INSTALLED, NEEDED, PACKAGE, RANGE, files_and_values, launch

pytestmark = [
    pytest.mark.ros,
    pytest.mark.skipif(importlib.util.find_spec('launch_ros') is None, reason='no launch library: no ROS workspace'),
]
#: What ros2 launch does, from a terminal.
LAUNCH = """
import sys
from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

path, *words = sys.argv[1:]
arguments = [word.split(':=', 1) for word in words]
service = LaunchService(argv=words)
source = PythonLaunchDescriptionSource(path)
service.include_launch_description(
    LaunchDescription([IncludeLaunchDescription(source, launch_arguments=arguments)])
)
sys.exit(service.run())
"""
CLOSED = b'\x89MCAP0\r\n'
#: A program of this package as it is installed, and one that only says how it was started.
REAL = 'import sys\nfrom pendubot_identification.programs import {name}\nsys.exit({name}())\n'
TELLS = """
import json, os, sys, time
from pathlib import Path
partial = Path('{folder}/{name}.partial')
partial.write_text(json.dumps([sys.argv[1:], dict(os.environ)]))
partial.rename('{folder}/{name}.json')
time.sleep(100)
"""


@pytest.fixture
def launched(tmp_path):
    """Launches a file with programs of a given source in the place of the installed ones."""
    script = tmp_path / 'start.py'
    script.write_text(LAUNCH)
    index = tmp_path / 'prefix/share/ament_index/resource_index/packages'
    index.mkdir(parents=True)
    programs = []

    def start(name, source, *arguments, before=()):
        for package, program in INSTALLED:
            file = tmp_path / 'prefix/lib' / package / program
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(f'#!{sys.executable}\n{source.format(name=program, folder=tmp_path)}')
            file.chmod(0o755)
            (index / package).touch()
        path = os.pathsep.join([str(ROOT), *sys.path[1:]])
        env = {'AMENT_PREFIX_PATH': str(tmp_path / 'prefix'), 'PYTHONPATH': path}
        programs.append(Program(script, ROOT / 'launch' / f'{name}.launch.py', *arguments, env=env, before=before))
        return programs[-1]

    yield start
    for each in programs:
        each.__exit__()


@pytest.fixture
def rig(launched, tmp_path):
    """Launches the rig on a virtual board that launch does not know of; returns torque and armed of its last sample."""
    trace, own = tmp_path / 'trace.csv', tmp_path / 'own.yaml'
    # Timeouts that outlast what else a busy machine does.
    patient = {'watchdog_ms': 500, 'link_timeout': 2.0, 'command_timeout': 1.0}
    own.write_text(yaml.safe_dump({'/**/bridge': {'ros__parameters': {'confirm_zeros': False, **patient}}}))
    given = {'bridge': own, 'port': tmp_path / 'rig', 'output': tmp_path / 'bag', 'arm': 'true', 'view': 'false'}
    words = [f'{name}:={value}' for name, value in {**given, 'duration': 100.0}.items()]

    def last():
        *_, torque, status = trace.read_text().rpartition('\n')[0].splitlines()[-1].split(',')
        return int(torque), int(status) & 1

    with Program('virtual_board', '--link', tmp_path / 'rig', '--trace', trace) as board:
        board.wait_for('virtual board on')
        yield lambda *arguments, **how: launched('rig', REAL, *words, *arguments, **how), last


def until(condition, timeout=30.0):
    deadline = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


@pytest.mark.parametrize('name', NEEDED)
def test_the_library_starts_the_planned_programs_with_their_parameters(launched, tmp_path, monkeypatch, name):
    given = {**NEEDED[name], 'namespace': '/lab1', **({'rviz': 'true'} if name == 'view' else {})}
    program = launched(name, TELLS, *(f'{argument}:={value}' for argument, value in given.items()))
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path / 'prefix'))
    planned = launch(name, **given)
    until(lambda: len(list(tmp_path.glob('*.json'))) == len(planned) or program.process.poll() is not None)
    for each, plan in planned.items():
        words, environment = json.loads((tmp_path / f'{each}.json').read_text())
        assert '__ns:=/lab1' in words
        assert (f'__node:={each}' in words) == (plan.package == PACKAGE)
        assert environment[RANGE] == plan.additional_env[RANGE]
        *_, typed = [yaml.safe_load(Path(word).read_text()) for word in words if 'launch_params_' in word] or [{}]
        (content,) = typed.values() or [{'ros__parameters': {}}]
        assert content['ros__parameters'] == files_and_values(plan)[1]
        assert words[: len(plan.arguments)] == list(plan.arguments)
    program.stop()


def test_when_a_program_fails_everything_ends_with_1(launched, tmp_path):
    (tmp_path / 'own.yaml').write_text('/**/bridge: {ros__parameters: {watchdog_ms: 3}}')
    given = {'bridge': tmp_path / 'own.yaml', 'output': tmp_path / 'bag', 'view': 'false'}
    program = launched('rig', REAL, *(f'{name}:={value}' for name, value in given.items()))
    program.wait_for('failed, with status 1: everything ends')
    assert program.process.wait(30) == 1


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
def test_a_signal_to_launch_alone_ends_every_program_and_disarms(rig, tmp_path, number):
    """launch itself would tell its programs of a SIGINT after 5 s, and of the others never."""
    start, last = rig
    program = start()
    program.wait_for('exciting for')
    program.process.send_signal(number)
    begin = time.monotonic()
    until(lambda: last() == (0, 0))
    assert time.monotonic() - begin < 4.0
    program.process.wait(20)
    (file,) = (tmp_path / 'bag').glob('*.mcap')
    until(lambda: file.read_bytes().endswith(CLOSED), 20.0)
    assert "after receiving 'SIGTERM'" not in program.output


def can_unshare():
    return subprocess.run(['unshare', '--pid', '--fork', '--mount-proc', 'true'], capture_output=True).returncode == 0


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_launch_as_the_first_process_of_a_container_ends_in_order(rig, tmp_path, number):
    """The system ignores a SIGTERM that such a process does not handle, and kills all others when it ends."""
    if not can_unshare():
        pytest.skip('no right to make a PID namespace')
    start, last = rig
    container = start(before=('unshare', '--pid', '--fork', '--mount-proc', '--kill-child'))
    container.wait_for('exciting for')
    pid = container.process.pid
    (first,) = map(int, Path(f'/proc/{pid}/task/{pid}/children').read_text().split())
    os.kill(first, number)
    begin = time.monotonic()
    until(lambda: last() == (0, 0))
    assert time.monotonic() - begin < 4.0
    container.process.wait(20)
    (file,) = (tmp_path / 'bag').glob('*.mcap')
    assert file.read_bytes().endswith(CLOSED), 'the recorder was killed'


#: A launch file of a user, with an argument of its own.
USERS = f"""
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

def generate_launch_description():
    rig = PythonLaunchDescriptionSource({str(ROOT / 'launch' / 'rig.launch.py')!r})
    return LaunchDescription([DeclareLaunchArgument('speed', default_value='1'), IncludeLaunchDescription(rig)])
"""


def test_a_launch_file_that_includes_ours_may_have_arguments_of_its_own(launched, tmp_path):
    file = tmp_path / 'users.launch.py'
    file.write_text(USERS)
    program = launched(str(file).removesuffix('.launch.py'), TELLS, 'speed:=3', 'amplitude:=0.05', 'l1:=0.3')
    until(lambda: (tmp_path / 'exciter.json').exists() or program.process.poll() is not None)
    assert (tmp_path / 'exciter.json').exists(), program.output
    program.stop()
