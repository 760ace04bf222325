# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Signals at every step of what waits for them and of what another of them has begun: none hangs, none is lost."""

import subprocess
import sys

import pytest

from test.conftest import ROOT

#: Does something again and again, each time with a signal at another of its steps, until there is no further step.
AT_EVERY_STEP = """
import signal
import sys
from pathlib import Path
from pendubot_identification.link.pty_server import PtyServer
from pendubot_identification.link.virtual_board import VirtualBoard
from pendubot_identification.model.parameters import PAPER
from pendubot_identification.model.simulation import Plant
from pendubot_identification.nodes.shutdown import Shutdown

def at_every_step(prepare, number):
    step, left = 0, 0
    while left <= 0:
        step += 1
        left = step

        def trace(frame, event, _):
            nonlocal left
            frame.f_trace_opcodes = True
            left -= 1
            if left == 0:
                signal.raise_signal(number)
            return trace

        action, check = prepare()
        sys.settrace(trace)
        action()
        sys.settrace(None)
        assert left > 0 or check(), step
    print(step, 'steps')

def waits():
    ending = Shutdown()
    ending.set_at_signal()
    return lambda: ending.wait(0.0), lambda: ending.is_set() and ending.wait()

def ends():
    ending = Shutdown()
    ending.set_at_signal()
    return ending.set, lambda: ending.is_set() and ending.wait()

def pulls():
    signal.signal(signal.SIGUSR2, lambda *_: server.plug())
    return server.pull, lambda: True

with PtyServer(VirtualBoard(Plant(PAPER))) as server:
    at_every_step(*{'waits': (waits, signal.SIGTERM), 'ends': (ends, signal.SIGINT), 'pulls': (pulls, signal.SIGUSR2)}[
        sys.argv[1]])
"""


@pytest.mark.parametrize('what', ['waits', 'ends', 'pulls'])
def test_a_signal_at_any_step_hangs_nothing(what):
    """A lock that is taken both there and by the handler would: the handler runs in the thread that it interrupts."""
    done = subprocess.run(
        [sys.executable, '-c', AT_EVERY_STEP, what], cwd=ROOT, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    assert int(done.stdout.split()[0]) > 5


#: Signals that the system gives to another thread, while the main one sleeps.
TO_ANOTHER_THREAD = """
import signal
import threading
from pathlib import Path
from pendubot_identification.nodes.shutdown import Shutdown

def signal_to_this_thread(main):
    while Path(f'/proc/self/task/{main}/stat').read_text().rsplit(')')[-1].split()[0] != 'S':
        pass
    signal.pthread_kill(threading.get_ident(), signal.SIGINT)

for _ in range(5):
    ending = Shutdown()
    ending.set_at_signal()
    threading.Thread(target=signal_to_this_thread, args=(threading.get_native_id(),), daemon=True).start()
    assert ending.wait()
"""


def test_a_signal_wakes_the_main_thread_whichever_thread_it_comes_to():
    subprocess.run([sys.executable, '-c', TO_ANOTHER_THREAD], cwd=ROOT, check=True, timeout=60)
