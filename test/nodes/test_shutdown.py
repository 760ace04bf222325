# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A signal at every step of a wait, and one to another thread: none hangs, none is lost."""

import subprocess
import sys

from test.conftest import ROOT

#: A lock that is taken both there and by the handler would hang: the handler runs in the thread that it interrupts.
AT_EVERY_STEP = """
import signal, sys, threading
from pendubot_identification.nodes.shutdown import Shutdown, at_signal

step, left = 0, 0
while left <= 0:
    step += 1
    left = step

    def trace(frame, event, _):
        global left
        frame.f_trace_opcodes = True
        left -= 1
        if left == 0:
            signal.raise_signal(signal.SIGTERM)
        return trace

    both = Shutdown()
    at_signal(both.set)
    sys.settrace(trace)
    both.wait(0.0), both.set()
    sys.settrace(None)
    assert both.is_set() and both.wait(), step
assert step > 5

# The system gives it to another thread, while the main one sleeps.
woken = Shutdown()
at_signal(woken.set)
threading.Timer(0.1, lambda: signal.pthread_kill(threading.get_ident(), signal.SIGINT)).start()
assert woken.wait()
"""


def test_a_signal_at_any_step_and_to_any_thread_hangs_nothing_and_wakes_who_waits():
    subprocess.run([sys.executable, '-c', AT_EVERY_STEP], cwd=ROOT, check=True, timeout=60)
