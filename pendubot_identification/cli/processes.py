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
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from pendubot_identification.errors import PendubotError

#: Variables that extend discovery beyond this computer, or join another domain.
OUTWARD = (
    *('ROS_STATIC_PEERS', 'ROS_LOCALHOST_ONLY', 'ROS_DISCOVERY_SERVER', 'ROS_SUPER_CLIENT', 'CYCLONEDDS_URI'),
    *('FASTDDS_DEFAULT_PROFILES_FILE', 'FASTRTPS_DEFAULT_PROFILES_FILE'),
)
#: Domains whose ports are free on every system, without the default domain 0.
DOMAINS = range(1, 101)
#: Programs in a domain are discovered within this time [s]: usually in 0.2 s, but if first announcements are lost, by
#: the next, which Fast DDS sends every 3 s.
DISCOVERY = 4.0
#: Interval at which conditions are checked [s].
POLL = 0.02


@contextmanager
def own_ros() -> Iterator[tuple[Any, int]]:
    """Initialise ROS on this computer alone, in a random empty domain; yield rclpy and the number of the domain.

    Domain and discovery range of the environment are not used, because a rig may be there. Programs that are started
    within the context are in the same domain.

    Raises:
        PendubotError: there is no ROS, or other programs are in the domain.
    """
    exported = os.environ.get('ROS_DOMAIN_ID', '').strip()
    domain = random.choice([each for each in DOMAINS if str(each) != exported])
    for name in OUTWARD:
        os.environ.pop(name, None)
    os.environ |= {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST', 'ROS_DOMAIN_ID': str(domain)}
    try:
        import rclpy
        from rclpy.signals import SignalHandlerOptions
    except ImportError as error:
        raise PendubotError(
            f'rclpy cannot be imported ({error}), and the demo needs ROS 2: source your ROS workspace, or install the '
            "package with pip install '.[ros]'; pendubot simulate and pendubot identify need no ROS"
        ) from error
    # Without its signal handlers, which would end ROS before the programs are ended.
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        # The node stays, so that another demo finds this domain taken.
        node, deadline = rclpy.create_node('demo'), time.monotonic() + DISCOVERY
        while time.monotonic() < deadline:
            if len(node.get_node_names()) > 1 or node.count_publishers('/joint_states'):
                raise PendubotError(
                    f'other ROS programs are in domain {domain}, and the demo arms only in one of its own; nothing was '
                    'armed; try again, which takes another domain'
                )
            time.sleep(POLL)
        yield rclpy, domain
    finally:
        rclpy.try_shutdown()


class Program(subprocess.Popen[bytes]):
    """A program in a process of its own, with its output in a file."""

    def __init__(self, folder: Path, name: str, arguments: list[str]) -> None:
        self.name, self.log = name, folder / f'{name}.log'
        command = [sys.executable, '-m', 'pendubot_identification.programs', name, *arguments]
        with self.log.open('ab') as output:
            super().__init__(command, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT)

    def failure(self, reason: str) -> PendubotError:
        """Return an error with the reason and the last line of the output."""
        last = self.log.read_text(errors='replace').strip().splitlines()[-1:] or ['it said nothing']
        return PendubotError(f'{self.name} {reason}: {last[0]} (all it said: {self.log})')

    def end(self) -> None:
        """Interrupt it, and kill it after 10 s."""
        self.send_signal(signal.SIGINT)
        try:
            self.wait(10.0)
        except subprocess.TimeoutExpired:
            self.kill()
            self.wait()


class Programs(ExitStack):
    """Programs that run until the end of the context, with their output in a folder; the last one is ended first.

    ``meanwhile`` is called again and again during :meth:`wait`.
    """

    def __init__(self, folder: Path, meanwhile: Callable[[], object] = lambda: time.sleep(POLL)) -> None:
        super().__init__()
        self.meanwhile = meanwhile
        self._folder, self._running = folder, list[Program]()

    def start(self, name: str, *arguments: object, **parameters: object) -> Program:
        """Start a program of this package with arguments and, if it is a node, parameters."""
        given = [word for key, value in parameters.items() for word in ('-p', f'{key}:={value}')]
        program = Program(self._folder, name, [*map(str, arguments), *(['--ros-args'] if given else []), *given])
        self.callback(program.end)
        self._running.append(program)
        return program

    def wait(self, program: Program, condition: Callable[[], bool], otherwise: str, timeout: float = 20.0) -> None:
        """Wait until a program has brought about a condition.

        Raises:
            PendubotError: it takes longer than ``timeout`` [s], or a program has ended early.
        """
        deadline = time.monotonic() + timeout
        while not condition():
            for each in self._running:
                if each.poll() is not None and not (each is program and condition()):
                    raise each.failure('ended early')
            if time.monotonic() > deadline:
                raise program.failure(otherwise)
            self.meanwhile()
