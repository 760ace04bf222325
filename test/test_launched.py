# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A launch file by the real launch library, with real programs; skipped where the library is not installed."""

import importlib.util
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from test.conftest import ROOT
from test.processes import Program

pytestmark = [
    pytest.mark.ros,
    pytest.mark.skipif(importlib.util.find_spec('launch_ros') is None, reason='no launch library: no ROS workspace'),
]
PACKAGE = 'pendubot_identification'
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


@pytest.fixture
def prefix(tmp_path):
    """The package as it is installed: its programs where launch looks for them."""
    folder, index = tmp_path / f'prefix/lib/{PACKAGE}', tmp_path / 'prefix/share/ament_index/resource_index/packages'
    for each in (folder, index):
        each.mkdir(parents=True)
    (index / PACKAGE).touch()
    for name in ('bridge', 'recorder', 'exciter'):
        program = f'#!{sys.executable}\nimport sys\nfrom {PACKAGE}.programs import {name}\nsys.exit({name}())\n'
        (folder / name).write_text(program)
        (folder / name).chmod(0o755)
    return tmp_path / 'prefix'


@pytest.fixture
def launched(prefix, tmp_path):
    """Launches the rig on a virtual board that launch does not know of; tells torque and armed of its last sample."""
    script, trace = tmp_path / 'start.py', tmp_path / 'trace.csv'
    script.write_text(LAUNCH)
    own = tmp_path / 'own.yaml'
    own.write_text('/**/bridge: {ros__parameters: {confirm_zeros: false}}')
    given = [
        f'bridge:={own}',
        f'port:={tmp_path / "rig"}',
        f'output:={tmp_path / "bag"}',
        'arm:=true',
        'view:=false',
        'duration:=100.0',
    ]

    def last():
        *_, torque, status = trace.read_text().rpartition('\n')[0].splitlines()[-1].split(',')
        return int(torque), int(status) & 1

    with Program('virtual_board', '--link', tmp_path / 'rig', '--trace', trace) as board:
        board.wait_for('virtual board on')
        programs = []

        def start(*arguments, before=()):
            env = {'AMENT_PREFIX_PATH': str(prefix), 'PYTHONPATH': os.pathsep.join([str(ROOT), *sys.path[1:]])}
            path = ROOT / 'launch' / 'rig.launch.py'
            programs.append(Program.of_file(script, path, *given, *arguments, env=env, before=before))
            return programs[-1]

        yield start, last
        for each in programs:
            each.__exit__()


def until_disarmed(last, timeout=30.0):
    deadline = time.monotonic() + timeout
    while last() != (0, 0):
        assert time.monotonic() < deadline, last()
        time.sleep(0.01)


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
def test_a_signal_to_launch_alone_ends_every_program_and_disarms(launched, tmp_path, number):
    """launch itself would tell its programs of a SIGINT after 5 s, and of the others never."""
    start, last = launched
    launch = start()
    launch.wait_for('exciting for')
    launch.process.send_signal(number)
    begin = time.monotonic()
    until_disarmed(last)
    assert time.monotonic() - begin < 4.0
    launch.process.wait(20)
    deadline = time.monotonic() + 20.0
    (file,) = (tmp_path / 'bag').glob('*.mcap')
    while not file.read_bytes().endswith(CLOSED):
        assert time.monotonic() < deadline, 'the bag was not closed'
        time.sleep(0.01)
    assert "after receiving 'SIGTERM'" not in launch.output


def can_unshare():
    return subprocess.run(['unshare', '--pid', '--fork', '--mount-proc', 'true'], capture_output=True).returncode == 0


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_launch_as_the_first_process_of_a_container_ends_in_order(launched, tmp_path, number):
    """The system ignores a SIGTERM that such a process does not handle, and kills all others when it ends."""
    if not can_unshare():
        pytest.skip('no right to make a PID namespace')
    start, last = launched
    container = start(before=('unshare', '--pid', '--fork', '--mount-proc', '--kill-child'))
    container.wait_for('exciting for')
    pid = container.process.pid
    (first,) = map(int, Path(f'/proc/{pid}/task/{pid}/children').read_text().split())
    os.kill(first, number)
    begin = time.monotonic()
    until_disarmed(last)
    assert time.monotonic() - begin < 4.0
    container.process.wait(20)
    (file,) = (tmp_path / 'bag').glob('*.mcap')
    assert file.read_bytes().endswith(CLOSED), 'the recorder was killed'


@pytest.mark.parametrize(
    ('arguments', 'said'),
    [
        (['amplitud:=0.05'], 'this launch has no argument amplitud; is amplitude meant?'),
        (['namespace:=lab1', 'bridge:=MINE'], 'and none of /lab1/bridge; name /lab1/bridge in it'),
    ],
)
def test_what_is_refused_starts_nothing(launched, tmp_path, arguments, said):
    start, _ = launched
    (tmp_path / 'mine.yaml').write_text('bridge: {ros__parameters: {torque_limit: 0.1}}')
    launch = start(*(word.replace('MINE', str(tmp_path / 'mine.yaml')) for word in arguments))
    assert launch.process.wait(30) == 1
    launch.wait_for(f'nothing was started: {"" if "amplitud" in said else "nothing is taken from"}')
    assert said in launch.output
    assert 'process started' not in launch.output
