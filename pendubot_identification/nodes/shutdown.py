# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What ends a program, from its start to its very end: a signal, or the end of its parent. Needs no ROS."""

from __future__ import annotations

import os
import select
import signal
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import cache

from . import PARENT

#: The last comes when a terminal is closed, or a connection over which the program was started is lost.
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
#: The environment variable in which the launch files name their own process.
LAUNCH = 'PENDUBOT_LAUNCH_PID'


class Shutdown:
    """That a program is to end: said by any thread and by any signal's handler, for good, and waited for by any thread.

    Not threading.Event: that takes a lock, for which a handler that interrupts its own thread holding it would wait
    forever. And a signal given to another thread than the main one wakes that only through a pipe.
    """

    def __init__(self) -> None:
        self._set = False
        self._woken, self._wake = os.pipe()
        os.set_blocking(self._wake, False)

    def set(self) -> None:
        """Say it; whoever waits goes on."""
        self._set = True
        with suppress(BlockingIOError):  # full, which wakes as well
            os.write(self._wake, b'\0')

    def set_at_signal(self) -> None:
        """Have every signal that ends a program say it, whichever thread it comes to."""
        signal.set_wakeup_fd(self._wake, warn_on_full_buffer=False)
        at_signal(self.set)

    def is_set(self) -> bool:
        """Tell whether it was said."""
        return self._set

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until it is said, or for so long [s], or until any signal came; return whether it was."""
        select.select([self._woken], [], [], timeout)
        return self._set


def at_signal(end: Callable[[], object]) -> None:
    """Call ``end`` at every signal that ends a program and when its parent ends; it may interrupt itself."""
    for number in SIGNALS:
        # Who starts it by nohup wants it to go on.
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, lambda *_: end())
    _terminate_with_parent()


@cache  # one thread is enough
def _terminate_with_parent() -> None:
    """Have this process sent SIGTERM when its parent ends, or has ended, whatever the reason.

    The parent is launch where the launch files name it, even if a ``launch-prefix`` stands in between. Otherwise it is
    the process that started this one, unless that used nohup. PR_SET_PDEATHSIG would not do: it tells the end of the
    thread that started this process.
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


def ended() -> None:
    """Ignore signals from now on: while the interpreter takes itself apart, one would change the exit status."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
