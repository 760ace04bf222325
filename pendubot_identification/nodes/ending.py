"""The signals that end a program, from its start to its very end. Needs no ROS."""

from __future__ import annotations

import signal
from collections.abc import Callable

#: The last comes when a terminal is closed, or a connection over which the program was started is lost.
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def at_signal(end: Callable[[], object]) -> None:
    """Have this called at every signal that ends a program."""
    for number in SIGNALS:
        # Who starts it by nohup wants it to go on.
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, lambda *_: end())


def ended() -> None:
    """Ignore signals from now on: while the interpreter takes itself apart, one would change the exit status."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
