# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The shutdown of a program: at a signal, or at the end of its parent process. Needs no ROS."""

import math
import os
import select
import signal
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache

#: Signals that end a program; the system sends SIGHUP when its terminal is closed or its connection is lost.
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
#: The environment variable with the process id of a launch file.
LAUNCH = 'PENDUBOT_LAUNCH_PID'
#: Polling period of a thread that waits for the end of the program [s].
POLL = 0.02


class Shutdown:
    """A flag for the end of the program; threads and signal handlers may set it, and threads may wait for it.

    Unlike threading.Event it has no lock, because a handler that interrupts its own thread in a lock waits forever.
    """

    def __init__(self) -> None:
        self._set = False

    def set(self) -> None:
        """Set the flag permanently."""
        self._set = True

    def is_set(self) -> bool:
        """Return whether the flag is set."""
        return self._set

    def wait(self, timeout: float = math.inf) -> bool:
        """Wait for the flag, at most ``timeout`` [s]; return whether it is set."""
        deadline = time.monotonic() + timeout
        while not self._set and (left := deadline - time.monotonic()) > 0:
            time.sleep(min(left, POLL))
        return self._set


def at_signal(end: Callable[[], object]) -> None:
    """Call ``end`` at every signal of :data:`SIGNALS` and at the end of the parent; ``end`` has to be reentrant."""
    for number in SIGNALS:
        # A program that was started with nohup outlives its terminal.
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, lambda *_: end())
    _terminate_with_parent()


@cache  # one thread is enough
def _terminate_with_parent() -> None:
    """Send SIGTERM to this process when its parent ends, or at once if it has ended already.

    The parent is the process in ``LAUNCH`` if that is set, even if a ``launch-prefix`` lies in between. Otherwise it is
    the process that started this one, unless that used nohup. PR_SET_PDEATHSIG is unsuitable, because it reports the
    end of the thread that started this process.
    """
    launch = int(os.environ.get(LAUNCH, 0))
    nohup = signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    parent = launch or (0 if nohup else os.getppid())
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
    """Ignore the signals from now on, because a signal during the interpreter's exit would change the exit status."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
