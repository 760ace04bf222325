# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Signals at every step of what waits for them and of what another of them has begun: none hangs, none is lost."""

import subprocess
import sys

import pytest

from test.conftest import ROOT

PRELUDE = """
import signal, sys, threading
from pendubot_identification.link.pty_server import PtyServer
from pendubot_identification.link.virtual_board import VirtualBoard
from pendubot_identification.model.parameters import PAPER
from pendubot_identification.model.simulation import Plant
from pendubot_identification.nodes.shutdown import Shutdown, at_signal

def at_every_step(prepare, number):
    '''Do something again and again, each time with a signal at another of its steps, until there is no further one.'''
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
    assert step > 5

def wait_and_set():
    both = Shutdown()
    at_signal(both.set)
    return lambda: (both.wait(0.0), both.set()), lambda: both.is_set() and both.wait()
"""
#: A lock that is taken both there and by the handler would hang: the handler runs in the thread that it interrupts.
WAITS = 'at_every_step(wait_and_set, signal.SIGTERM)'
PULLS = """
with PtyServer(VirtualBoard(Plant(PAPER))) as server:
    signal.signal(signal.SIGUSR2, lambda *_: server.plug())
    at_every_step(lambda: (server.pull, lambda: True), signal.SIGUSR2)
"""
#: The system gives it to another thread, while the main one sleeps.
TO_ANOTHER_THREAD = """
woken = Shutdown()
at_signal(woken.set)
threading.Timer(0.1, lambda: signal.pthread_kill(threading.get_ident(), signal.SIGINT)).start()
assert woken.wait()
"""


@pytest.mark.parametrize('program', [WAITS, PULLS, TO_ANOTHER_THREAD], ids=['waits', 'pulls', 'to another thread'])
def test_a_signal_at_any_step_and_to_any_thread_hangs_nothing_and_wakes_who_waits(program):
    subprocess.run([sys.executable, '-c', PRELUDE + program], cwd=ROOT, check=True, timeout=60)
