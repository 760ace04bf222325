# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Programs of this package in processes of their own, in a ROS domain of their own."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from pendubot_identification.errors import PendubotError

#: Variables that extend discovery beyond this computer, or join another domain.
OUTWARD = (
    *('ROS_STATIC_PEERS', 'ROS_LOCALHOST_ONLY', 'ROS_DISCOVERY_SERVER', 'ROS_SUPER_CLIENT', 'CYCLONEDDS_URI'),
    *('FASTDDS_DEFAULT_PROFILES_FILE', 'FASTRTPS_DEFAULT_PROFILES_FILE'),
)
#: Domains whose ports are free on every system, without the default domain 0, and how many of them are tried.
DOMAINS, TRIES = range(1, 101), 5
#: Programs in a domain are discovered within this time [s]: usually in 0.2 s, but if first announcements are lost, by
#: the next, which Fast DDS sends every 3 s.
DISCOVERY = 4.0
#: The computer may pause for so long without ending a program [s]; the virtual rig waits.
PAUSE = 2.0
#: Interval at which conditions are checked [s].
POLL = 0.02


@contextmanager
def own_ros(domains: Sequence[int] = ()) -> Iterator[tuple[Any, int]]:
    """Initialise ROS on this computer alone, in an empty domain; yield rclpy and the number of the domain.

    Domain and discovery range of the environment are not used, because a rig may be there. Programs that are started
    within the context are in the same domain. ``domains`` are tried in this order; without them, random ones.

    Raises:
        PendubotError: there is no ROS, or other programs are in every domain.
    """
    given = os.environ.get('ROS_DOMAIN_ID', '').strip()
    exported = int(given) if given.isdecimal() else 0
    for name in OUTWARD:
        os.environ.pop(name, None)
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    try:
        import rclpy
        from rclpy.signals import SignalHandlerOptions
    except ImportError as error:
        raise PendubotError(
            f'rclpy cannot be imported ({error}), and the demo needs ROS 2: source your ROS workspace, or install the '
            "package with pip install '.[ros]'; pendubot simulate and pendubot identify need no ROS"
        ) from error
    tried = [domain for domain in domains or random.sample(DOMAINS, TRIES + 1) if domain != exported][:TRIES]
    try:
        for domain in tried:
            os.environ['ROS_DOMAIN_ID'] = str(domain)
            # Without its signal handlers, which would end ROS before the programs are ended.
            rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
            # The node stays, so that another demo finds this domain taken.
            node, deadline = rclpy.create_node('demo'), time.monotonic() + DISCOVERY
            taken = False
            while not taken and time.monotonic() < deadline:
                time.sleep(POLL)
                taken = len(node.get_node_names()) > 1 or node.count_publishers('/joint_states') > 0
            if not taken:
                yield rclpy, domain
                return
            rclpy.shutdown()
        raise PendubotError(
            f'other ROS programs are in each of the domains {", ".join(map(str, tried))}, and the demo arms only in '
            'one of its own; nothing was armed; end those programs, or try again'
        )
    finally:
        rclpy.try_shutdown()


def parameters(**values: object) -> list[str]:
    """Return the arguments that set a node's parameters."""
    return ['--ros-args', *(word for name, value in values.items() for word in ('-p', f'{name}:={value}'))]


class Program:
    """A program in a process of its own, with its output in a file."""

    def __init__(self, folder: Path, name: str, arguments: Sequence[object]) -> None:
        self.name, self.log = name, folder / f'{name}.log'
        with self.log.open('ab') as output:
            self.process = subprocess.Popen(
                [sys.executable, '-m', f'pendubot_identification.nodes.{name}', *map(str, arguments)],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
            )

    def failure(self, reason: str) -> PendubotError:
        """Return an error with the reason and the last line of the output."""
        last = self.log.read_text(errors='replace').strip().splitlines()[-1:] or ['it said nothing']
        return PendubotError(f'{self.name} {reason}: {last[0]} (all it said: {self.log})')

    def end(self) -> None:
        """Interrupt it, and kill it after 10 s."""
        self.process.send_signal(signal.SIGINT)
        try:
            self.process.wait(10.0)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()


class Programs(ExitStack):
    """Programs that run until the end of the context, with their output in a folder; the last one is ended first.

    ``meanwhile`` is called again and again during :meth:`wait`.
    """

    def __init__(self, folder: Path, meanwhile: Callable[[], object] = lambda: time.sleep(POLL)) -> None:
        super().__init__()
        self._folder, self._meanwhile, self._running = folder, meanwhile, list[Program]()

    def start(self, name: str, *arguments: object) -> Program:
        """Start a program of this package."""
        program = Program(self._folder, name, arguments)
        self.callback(program.end)
        self._running.append(program)
        return program

    def start_rig(self, rate: float, *board: object) -> None:
        """Start a virtual board with a sampling rate [Hz] and further options, and a bridge; both outlast a pause."""
        port = self._folder / 'board'
        program = self.start('virtual_board', '--patient', '--link', port, '--rate', rate, *board)
        self.wait(program, port.exists, 'opened no port')
        self.start('bridge', *parameters(port=port, link_timeout=PAUSE, confirm_zeros='false'))

    def end(self, program: Program) -> None:
        """End a program before the end of the context."""
        self._running.remove(program)
        program.end()

    def wait(self, program: Program, condition: Callable[[], bool], otherwise: str, timeout: float = 20.0) -> None:
        """Wait until a program has brought about a condition.

        Raises:
            PendubotError: it takes longer than ``timeout`` [s], or a program has ended early.
        """
        deadline = time.monotonic() + timeout
        while not condition():
            for each in self._running:
                if each.process.poll() is not None and not (each is program and condition()):
                    raise each.failure('ended early')
            if time.monotonic() > deadline:
                raise program.failure(otherwise)
            self._meanwhile()
