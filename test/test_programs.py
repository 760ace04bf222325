# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The start and the end of programs: without ROS, with a closed output, and with a parent that ends."""

import os
import re
import select
import signal
import subprocess
import sys

import pytest

from pendubot_identification.nodes.shutdown import LAUNCH
from test.conftest import SAMPLE
from test.processes import Program, until

CHILD = """
import sys
# A None entry makes the import of a module fail.
sys.modules.update(dict.fromkeys(sys.argv.pop(1).split()))
from pendubot_identification import programs
sys.exit(getattr(programs, sys.argv.pop(1))())
"""


def run(missing, *words, stdout=subprocess.PIPE, **env):
    command = [sys.executable, '-c', CHILD, missing, *words]
    return subprocess.run(
        command, stdout=stdout, stderr=subprocess.PIPE, text=True, env={**os.environ, **env}, timeout=60
    )


@pytest.mark.parametrize(
    ('missing', 'program', 'message'),
    [
        ('rclpy', ('bridge',), r"bridge: .*needs ROS 2.*pip install '.\[ros\]'.*\n"),
        ('aiohttp', ('pendubot', 'studio'), r'pendubot: .*the studio needs aiohttp: pip install aiohttp\n'),
        # A part of the package is not attributed to ROS.
        ('pendubot_identification.setting', ('virtual_board',), r'(?s)Traceback.*pendubot_identification\.setting.*'),
    ],
)
def test_a_missing_module_is_named_with_its_remedy(missing, program, message):
    ended = run(missing, *program)
    assert ended.returncode == 1
    assert re.fullmatch(message, ended.stderr), ended.stderr


@pytest.mark.parametrize(
    ('unbuffered', 'words'),
    [
        ('', ('virtual_board', '--duration', '0')),
        ('1', ('pendubot', '--help')),
        ('', ('pendubot', 'info', SAMPLE)),
    ],
)
def test_an_output_closed_by_its_reader_is_no_failure_and_a_full_disk_is_reported(unbuffered, words):
    """Like head: during the output, or before the final flush."""
    reads, writes = os.pipe()
    os.close(reads)
    ended = run('', *words, stdout=writes, PYTHONUNBUFFERED=unbuffered)
    os.close(writes)
    assert (ended.returncode, ended.stderr) == (0, '')
    with open('/dev/full', 'w') as full:
        ended = run('', *words, stdout=full, PYTHONUNBUFFERED=unbuffered)
    known = words != ('pendubot', '--help')  # argparse ignores the failure
    assert ended.returncode == known
    assert bool(re.fullmatch(r'.*No space left on device; correct that and try again\n', ended.stderr)) == known


#: Starts a program from a thread that ends, and waits for the program.
PARENT = """
import subprocess, sys, threading
children = []
starter = threading.Thread(target=lambda: children.append(subprocess.Popen(sys.argv[1:])))
starter.start()
starter.join()
print('child', children[0].pid, flush=True)
children[0].wait()
"""


def ended(board, timeout=10.0):
    """Return whether the process of a pidfd ends within a timeout [s]."""
    return bool(select.select([board], [], [], timeout)[0])


@pytest.fixture
def parent(tmp_path):
    """Starts a virtual board, without ROS, from another program; returns that program and the board's pidfd."""
    board = None

    def start(*, before=(), env=None):
        nonlocal board
        file = tmp_path / 'parent.py'
        file.write_text(PARENT)
        words = ['-c', CHILD, 'rclpy', 'virtual_board', '--link', tmp_path / 'board', '--trace', tmp_path / 'trace.csv']
        program = Program(file, sys.executable, *words, before=before, env=env)
        board = os.pidfd_open(int(program.wait_for('child').split()[1]))
        program.wait_for('virtual board on')
        return program, board

    yield start
    if board is not None and not ended(board, 0):
        signal.pidfd_send_signal(board, signal.SIGKILL)


def test_a_program_ends_cleanly_when_its_parent_ends(parent, tmp_path):
    """The end of the thread that started it does not end the program."""
    program, board = parent()
    program.kill()
    assert ended(board)
    assert not (tmp_path / 'board').is_symlink(), 'the program was killed'


def test_a_program_started_with_nohup_outlives_its_parent_and_terminal(parent, tmp_path):
    program, board = parent(before=('nohup',))
    program.kill()
    signal.pidfd_send_signal(board, signal.SIGHUP)
    trace = tmp_path / 'trace.csv'
    least = trace.read_bytes().count(b'\n') + 100
    until(lambda: trace.read_bytes().count(b'\n') >= least)
    assert not ended(board, 0)
    signal.pidfd_send_signal(board, signal.SIGTERM)
    assert ended(board)


def test_a_program_of_a_launch_file_ends_with_launch_even_with_nohup_and_another_parent(parent):
    with subprocess.Popen(['sleep', '1000']) as launch:
        _, board = parent(before=('nohup',), env={LAUNCH: str(launch.pid)})
        launch.kill()
        assert ended(board)


def test_a_program_whose_launch_has_already_ended_stops_at_once(tmp_path):
    launch = subprocess.Popen(['true'])
    launch.wait()
    ended = run('', 'virtual_board', '--trace', tmp_path / 'trace.csv', **{LAUNCH: str(launch.pid)})
    assert ended.returncode == 0
    assert not (tmp_path / 'trace.csv').exists() or len((tmp_path / 'trace.csv').read_text().splitlines()) <= 1
