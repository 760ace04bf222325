# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The entry points of the nodes, which need ROS, and of the command line. As a module it runs the named node."""

import os

os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')  # before numpy: more threads are slower for small matrices

import importlib
import io
import signal
import sys
from collections.abc import Callable
from functools import partial

from pendubot_identification.errors import sentence
from pendubot_identification.nodes.shutdown import at_signal


def _start(name: str) -> int:
    """Run a node; return the exit status."""
    # During the slow imports a signal may end the program at once, because nothing is open yet.
    at_signal(lambda: os._exit(0))
    try:
        node = importlib.import_module(f'pendubot_identification.nodes.{name}')
    except ImportError as error:
        missing = (error.name or '').split('.')[0]
        if missing == __package__:
            raise
        print(
            f'{name}: {missing or "ROS"} cannot be imported ({error}), and {name} needs ROS 2: source your ROS '
            "workspace, or install the package with pip install '.[ros]'; pendubot needs none, see pendubot --help",
            file=sys.stderr,
        )
        return 1
    return _until_nobody_reads(node.main)


def _until_nobody_reads(main: Callable[[], int]) -> int:
    """Return the exit status; 0 if the reader of the output closes the pipe early, like ``head``, 1 on a full disk."""
    if sys.stdout is None:  # closed by the parent process
        sys.stdout = io.StringIO()
    try:
        try:
            return main()
        finally:
            sys.stdout.flush()
    except OSError as error:
        # Replace stdout, because its flush at exit would fail again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if isinstance(error, BrokenPipeError):
            return 0
        print(sentence(error), file=sys.stderr)
        return 1


def pendubot() -> int:
    """Run the command line; return the exit status."""
    # During the slow imports Ctrl-C may end the program at once, because nothing is open yet.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from pendubot_identification.cli.main import main

    return _until_nobody_reads(main)


bridge = partial(_start, 'bridge')
recorder = partial(_start, 'recorder')
player = partial(_start, 'player')
identifier = partial(_start, 'identifier')
exciter = partial(_start, 'exciter')
balancer = partial(_start, 'balancer')
tracker = partial(_start, 'tracker')
virtual_board = partial(_start, 'virtual_board')

if __name__ == '__main__':
    sys.exit(_start(sys.argv.pop(1)))
