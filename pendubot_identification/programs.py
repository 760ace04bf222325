"""The nodes as programs: where there is no ROS to start them with, a sentence says so."""

from __future__ import annotations

import importlib
import os
import sys
from functools import partial

from pendubot_identification.nodes.ending import at_signal


def _start(name: str) -> int:
    """Run a node; return the exit status."""
    # Importing takes a while, and nothing is open yet that would have to be closed.
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
    return int(node.main())


bridge = partial(_start, 'bridge')
recorder = partial(_start, 'recorder')
player = partial(_start, 'player')
identifier = partial(_start, 'identifier')
exciter = partial(_start, 'exciter')
balancer = partial(_start, 'balancer')
virtual_board = partial(_start, 'virtual_board')
