# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Signals at every bytecode step of a wait, and signals to another thread."""

import subprocess
import sys

from test.conftest import ROOT

#: The handler runs in the interrupted thread, so a lock that both acquire would hang.
AT_EVERY_STEP = """
import signal, sys, threading
from pendubot_identification.nodes.shutdown import Shutdown, at_signal

step, remaining = 0, 0
while remaining <= 0:
    step += 1
    remaining = step

    def trace(frame, event, _):
        global remaining
        frame.f_trace_opcodes = True
        remaining -= 1
        if remaining == 0:
            signal.raise_signal(signal.SIGTERM)
        return trace

    both = Shutdown()
    at_signal(both.set)
    sys.settrace(trace)
    both.wait(0.0), both.set()
    sys.settrace(None)
    assert both.is_set() and both.wait(), step
assert step > 5

# The signal goes to another thread while the main thread sleeps.
woken = Shutdown()
at_signal(woken.set)
threading.Timer(0.1, lambda: signal.pthread_kill(threading.get_ident(), signal.SIGINT)).start()
assert woken.wait()
"""


def test_a_signal_at_any_step_and_to_any_thread_ends_the_wait():
    subprocess.run([sys.executable, '-c', AT_EVERY_STEP], cwd=ROOT, check=True, timeout=60)
