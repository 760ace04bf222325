# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The launch files with the real launch library and real programs; skipped without the library."""

import importlib.util
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from test.conftest import ROOT
from test.processes import Program, until
from test.test_launch import INSTALLED, NEEDED, PACKAGE, RANGE, files_and_values, launch

pytestmark = [
    pytest.mark.ros,
    pytest.mark.skipif(importlib.util.find_spec('launch_ros') is None, reason='no launch library: no ROS workspace'),
]
#: Executes a launch file like ros2 launch in a terminal.
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
#: A program of this package as installed, and a program that writes its arguments and environment to a file.
REAL = 'import sys\nfrom pendubot_identification.programs import {name}\nsys.exit({name}())\n'
REPORTING = """
import json, os, sys, time
from pathlib import Path
partial = Path('{folder}/{name}.partial')
partial.write_text(json.dumps([sys.argv[1:], dict(os.environ)]))
partial.rename('{folder}/{name}.json')
time.sleep(100)
"""


@pytest.fixture
def launched(tmp_path):
    """Launches a file with programs of a given source in place of the installed ones."""
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
    """Launches the rig with an independent virtual board; yields also a function for its last torque and armed bit."""
    trace, own = tmp_path / 'trace.csv', tmp_path / 'own.yaml'
    # Long timeouts for a busy machine.
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


@pytest.mark.parametrize('name', NEEDED)
def test_the_library_starts_the_planned_programs_with_their_parameters(launched, tmp_path, monkeypatch, name):
    given = {**NEEDED[name], 'namespace': '/lab1', **({'rviz': 'true'} if name == 'view' else {})}
    program = launched(name, REPORTING, *(f'{argument}:={value}' for argument, value in given.items()))
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


def test_a_failed_program_ends_the_launch_with_status_1(launched, tmp_path):
    (tmp_path / 'own.yaml').write_text('/**/bridge: {ros__parameters: {watchdog_ms: 3}}')
    given = {'bridge': tmp_path / 'own.yaml', 'output': tmp_path / 'bag', 'view': 'false'}
    program = launched('rig', REAL, *(f'{name}:={value}' for name, value in given.items()))
    program.wait_for('failed, with status 1: all programs end')
    assert program.process.wait(30) == 1


#: Makes launch the first process of a container.
CONTAINER = 'unshare', '--pid', '--fork', '--mount-proc', '--kill-child'


@pytest.mark.parametrize(
    ('number', 'before'),
    [(signal.SIGINT, ()), (signal.SIGTERM, ()), (signal.SIGKILL, ()), (signal.SIGTERM, CONTAINER)],
    ids=['SIGINT', 'SIGTERM', 'SIGKILL', 'SIGTERM in a container'],
)
def test_a_signal_to_launch_alone_ends_every_program_and_disarms(rig, tmp_path, number, before):
    """The launch library itself forwards SIGINT after 5 s, and other signals never.

    The system ignores an unhandled SIGTERM of the first process of a container, and kills all others when it ends.
    """
    if before and subprocess.run([*before, 'true'], capture_output=True).returncode:
        pytest.skip('no right to make a PID namespace')
    start, last = rig
    program = start(before=before)
    program.wait_for('exciting for')
    (pid,) = program.children() if before else [program.process.pid]
    os.kill(pid, number)
    until(lambda: last() == (0, 0), 4.0)
    program.process.wait(20)
    (file,) = (tmp_path / 'bag').glob('*.mcap')
    until(lambda: file.read_bytes().endswith(CLOSED), 20.0)
    assert "after receiving 'SIGTERM'" not in program.output


#: A user's launch file with an additional argument.
USERS = f"""
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

def generate_launch_description():
    rig = PythonLaunchDescriptionSource({str(ROOT / 'launch' / 'rig.launch.py')!r})
    return LaunchDescription([DeclareLaunchArgument('speed', default_value='1'), IncludeLaunchDescription(rig)])
"""


def test_a_launch_file_that_includes_ours_may_have_more_arguments(launched, tmp_path):
    file = tmp_path / 'users.launch.py'
    file.write_text(USERS)
    program = launched(str(file).removesuffix('.launch.py'), REPORTING, 'speed:=3', 'amplitude:=0.05', 'l1:=0.3')
    until(lambda: (tmp_path / 'exciter.json').exists() or program.process.poll() is not None)
    assert (tmp_path / 'exciter.json').exists(), program.output
    program.stop()
