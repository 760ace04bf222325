# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The end of a program: at a signal, or with the program that started it. Needs no ROS."""

import math
import os
import select
import signal
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache

from . import PARENT

#: SIGHUP comes when a terminal is closed or the connection over which the program was started is lost.
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
#: The environment variable in which the launch files name their own process.
LAUNCH = 'PENDUBOT_LAUNCH_PID'
#: A thread that waits for the end of the program looks this often [s].
POLL = 0.02


class Shutdown:
    """A flag that the program ends, which any thread and any signal handler may set and any thread may wait for.

    It takes no lock, unlike threading.Event: a handler that interrupts its own thread in a lock would wait forever.
    """

    def __init__(self) -> None:
        self._set = False

    def set(self) -> None:
        """Set the flag, for good."""
        self._set = True

    def is_set(self) -> bool:
        """Return whether the flag is set."""
        return self._set

    def wait(self, timeout: float = math.inf) -> bool:
        """Wait for the flag, at most so long [s]; return whether it is set."""
        deadline = time.monotonic() + timeout
        while not self._set and (left := deadline - time.monotonic()) > 0:
            time.sleep(min(left, POLL))
        return self._set


def at_signal(end: Callable[[], object]) -> None:
    """Call ``end`` at every signal that ends a program and when its parent ends; it may interrupt itself."""
    for number in SIGNALS:
        # A program that was started by nohup outlives its terminal.
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, lambda *_: end())
    _terminate_with_parent()


@cache  # one thread is enough
def _terminate_with_parent() -> None:
    """Send SIGTERM to this process when its parent ends, for whatever reason, or if it has ended already.

    The parent is launch where the launch files name it, even if a ``launch-prefix`` stands in between. Otherwise it is
    the process that started this one, unless that used nohup. PR_SET_PDEATHSIG does not serve: it reports the end of
    the thread that started this process.
    """
    launch = int(os.environ.get(LAUNCH, 0))
    nohup = signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    parent = launch or (0 if nohup else PARENT)
    if not parent:  # 0 is also the parent of the first process of a container
        return
    watched = None
    with suppress(ProcessLookupError):
        watched = os.pidfd_open(parent)
    if watched is None or (not launch and os.getppid() != parent):
        signal.raise_signal(signal.SIGTERM)
        return

    def watch() -> None:
        select.select([watched], [], [])
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=watch, daemon=True).start()


def ignore_signals() -> None:
    """Ignore the signals from now on: one that comes while the interpreter exits would change the exit status."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
