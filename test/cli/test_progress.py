# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The bar: on a terminal what is done, how long it still takes and the best J; in a pipe or a file nothing."""

import contextlib
import fcntl
import os
import pty
import re
import struct
import subprocess
import sys
import termios
import threading

from pendubot_identification.cli.progress import progress_bar
from test.conftest import ROOT

SAMPLE = ROOT / 'bags' / 'paper_experiment'
#: Long enough to be seen on any machine: without the kernel, and no run of MDE stops before its last generation.
LONG = ('--criterion', 'energy', '--model', 'viscous', '--optimizer', 'mde', '--runs', '3', '--generations', '12000')
LONG += ('--spread', '0')


def on_a_terminal(*arguments):
    """Run pendubot with a terminal for its stderr; return what was drawn there and what came out of stdout."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack('HHHH', 24, 120, 0, 0))
    drawn = []

    def read():
        with contextlib.suppress(OSError):  # the other end was closed
            while True:
                drawn.append(os.read(ours, 4096))

    reader = threading.Thread(target=read)
    reader.start()
    command = [sys.executable, '-m', 'pendubot_identification.cli.main', *map(str, arguments)]
    env = {**os.environ, 'COLUMNS': '120', 'PENDUBOT_KERNEL': 'off'}
    done = subprocess.run(
        command, stdout=subprocess.PIPE, stderr=theirs, stdin=subprocess.DEVNULL, timeout=120, env=env, check=True
    )
    os.close(theirs)
    reader.join(10)
    os.close(ours)
    return b''.join(drawn).decode(), done.stdout.decode()


def test_a_terminal_shows_how_far_how_long_and_how_good():
    drawn, out = on_a_terminal('identify', SAMPLE, *LONG)
    bars = re.findall(r'energy: MDE .*? (\d+)/12000, J = (\S+) \[[\d:]+, [\d:?]+ left\]', drawn)
    assert len(bars) > 2
    done, best = [int(n) for n, _ in bars], [float(J) for _, J in bars]
    assert done == sorted(done)
    assert best == sorted(best, reverse=True)
    assert 'MDE' not in drawn.rsplit('\r', 1)[-1], 'it is gone when the work is done'
    assert '\r' not in out


def test_a_pipe_gets_nothing(capfd):
    with progress_bar() as progress:
        progress('energy: MDE', 1, 2, 0.5)
    assert capfd.readouterr() == ('', '')


def test_a_program_that_reads_json_gets_nothing_else_even_on_a_terminal():
    drawn, _ = on_a_terminal('identify', SAMPLE, *LONG[:-1], '1', '--json')
    assert drawn == ''
