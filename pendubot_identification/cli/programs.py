"""Programs of this package, run by a demonstration in processes of their own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pendubot_identification.core.errors import PendubotError


def own_ros() -> tuple[Any, str]:
    """Return rclpy and the number of a ROS domain of our own.

    Raises:
        PendubotError: there is no ROS.
    """
    domain = os.environ.setdefault('ROS_DOMAIN_ID', str(1 + os.getpid() % 100))
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    try:
        import rclpy
    except ImportError as error:
        raise PendubotError(
            f'rclpy cannot be imported ({error}), and the demo needs ROS 2: source your ROS workspace, or install the '
            "package with pip install '.[ros]'; pendubot simulate and pendubot identify need no ROS"
        ) from error
    return rclpy, domain


def new_folder(wanted: Path | None) -> Path:
    """Return a new folder, a temporary one where none is wanted.

    Raises:
        PendubotError: it exists already, or cannot be made.
    """
    if wanted is None:
        return Path(tempfile.mkdtemp(prefix='pendubot-demo-'))
    try:
        wanted.mkdir(parents=True)
    except FileExistsError:
        raise PendubotError(f'{wanted} exists already and was left as it is; name a folder that does not') from None
    except OSError as error:
        raise PendubotError(f'{wanted} cannot be made ({error.strerror}); name a folder that can') from error
    return wanted.absolute()


def parameters(**values: object) -> list[str]:
    """Return the arguments that set a node's parameters."""
    return ['--ros-args', *(word for name, value in values.items() for word in ('-p', f'{name}:={value}'))]


class Program:
    """A program of this package in a process of its own, its output in a file beside the bag."""

    def __init__(self, name: str, process: subprocess.Popen[bytes], log: Path) -> None:
        self.name, self.process, self.log = name, process, log

    @property
    def ended(self) -> bool:
        """Whether it has ended well."""
        return self.process.poll() == 0

    def wait_until(
        self,
        condition: Callable[[], bool],
        otherwise: str,
        timeout: float = 20.0,
        meanwhile: Callable[[], object] | None = None,
    ) -> None:
        """Wait for a condition, failing where the program does or where it takes too long."""
        deadline = time.monotonic() + timeout
        while not condition():
            if self.process.poll() or time.monotonic() > deadline:
                last = self.log.read_text(errors='replace').strip().splitlines()[-1:] or ['it said nothing']
                raise PendubotError(f'{self.name} {otherwise}: {last[0]} (all it said: {self.log})')
            if meanwhile is None:
                time.sleep(0.02)
            else:
                meanwhile()


@contextmanager
def program(folder: Path, name: str, *arguments: object) -> Iterator[Program]:
    """Run a program of this package until the end of the block, its output in the folder."""
    log = folder / f'{name}.log'
    with log.open('wb') as output:
        process = subprocess.Popen(
            [sys.executable, '-m', f'pendubot_identification.nodes.{name}', *map(str, arguments)],
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
        )
        try:
            yield Program(name, process, log)
        finally:
            process.send_signal(signal.SIGINT)
            try:
                process.wait(10.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
