"""Programs of this package, run by a demonstration in processes of their own."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from pendubot_identification.errors import PendubotError

#: What would reach beyond this computer, or lead into a domain that is none.
OUTWARD = (
    *('ROS_STATIC_PEERS', 'ROS_LOCALHOST_ONLY', 'ROS_DISCOVERY_SERVER', 'ROS_SUPER_CLIENT', 'CYCLONEDDS_URI'),
    *('FASTDDS_DEFAULT_PROFILES_FILE', 'FASTRTPS_DEFAULT_PROFILES_FILE'),
)
#: Domains whose ports every system leaves free, 0 being everyone's, and how many of them are tried.
DOMAINS, TRIES = range(1, 101), 5
#: Whoever is in a domain is discovered within this [s]: mostly in 0.2 s, but where first announcements are missed, with
#: the next, which Fast DDS sends every 3 s.
DISCOVERY = 4.0


@contextmanager
def own_ros(domains: Sequence[int] = ()) -> Iterator[tuple[Any, int]]:
    """Initialise ROS in a domain in which nobody is, on this computer alone, and give it up at the end.

    Neither the domain nor the range of discovery that the environment names is used: a rig may be there. What is
    found and started meanwhile is in the same domain.

    Args:
        domains: to be tried, in this order; none: some drawn at random.

    Yields:
        rclpy, and the number of the domain.

    Raises:
        PendubotError: there is no ROS, or somebody is in every domain.
    """
    given = os.environ.get('ROS_DOMAIN_ID', '').strip()
    exported = int(given) if given.isdecimal() else 0
    for name in OUTWARD:
        os.environ.pop(name, None)
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    try:
        import rclpy
        import rclpy.signals
    except ImportError as error:
        raise PendubotError(
            f'rclpy cannot be imported ({error}), and the demo needs ROS 2: source your ROS workspace, or install the '
            "package with pip install '.[ros]'; pendubot simulate and pendubot identify need no ROS"
        ) from error
    others = [domain for domain in domains or random.sample(DOMAINS, TRIES + 1) if domain != exported][:TRIES]
    try:
        for domain in others:
            os.environ['ROS_DOMAIN_ID'] = str(domain)
            # Without its handlers, which would end ROS beneath the demo before the demo knows of it.
            rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
            # It stays, so that others who look for a domain of their own find this one taken.
            if _alone(rclpy.create_node('demo')):
                yield rclpy, domain
                return
            rclpy.shutdown()
        raise PendubotError(
            f'other ROS programs are in each of the domains {", ".join(map(str, others))}, and the demo arms only in '
            'one of its own; nothing was armed; end those programs, or try again'
        )
    finally:
        rclpy.try_shutdown()


@contextmanager
def interruptible(bag: Path) -> Iterator[None]:
    """Let SIGTERM do what Ctrl-C does, and say where the bag is that was being recorded."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    except KeyboardInterrupt:
        if bag.exists():
            print(f'what was recorded so far is kept in {bag}', file=sys.stderr)
        raise
    finally:
        signal.signal(signal.SIGTERM, before)


def _alone(node: Any) -> bool:
    """Return whether nobody else is discovered in the node's domain, and nobody publishes joint states there."""
    deadline = time.monotonic() + DISCOVERY
    while time.monotonic() < deadline:
        if len(node.get_node_names()) > 1 or node.count_publishers('/joint_states'):
            return False
        time.sleep(0.02)
    return True


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
    """A program of this package in a process of its own, its output in a file beside the bag.

    ``finite``: it ends by itself when its work is done.
    """

    def __init__(self, name: str, process: subprocess.Popen[bytes], log: Path, finite: bool) -> None:
        self.name, self.process, self.log, self.finite = name, process, log, finite

    @property
    def ended(self) -> bool:
        """Whether it has ended well."""
        return self.process.poll() == 0

    @property
    def failed(self) -> bool:
        """Whether it has ended otherwise than it should."""
        status = self.process.poll()
        return status is not None and not (status == 0 and self.finite)

    def failure(self, reason: str) -> PendubotError:
        """Return the error that says what it said last."""
        last = self.log.read_text(errors='replace').strip().splitlines()[-1:] or ['it said nothing']
        return PendubotError(f'{self.name} {reason}: {last[0]} (all it said: {self.log})')


class Programs(ExitStack):
    """Programs that run until the end of the block, their output in the folder; the last is ended first."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self._folder, self._started = folder, list[Program]()

    def start(self, name: str, *arguments: object, finite: bool = False) -> Program:
        """Start a program of this package."""
        self._started.append(self.enter_context(_program(self._folder, name, *arguments, finite=finite)))
        return self._started[-1]

    def wait(
        self,
        program: Program,
        condition: Callable[[], bool],
        otherwise: str,
        timeout: float = 20.0,
        meanwhile: Callable[[], object] | None = None,
    ) -> None:
        """Wait for what a program brings about.

        Raises:
            PendubotError: that takes too long, or any of the programs has ended early.
        """
        deadline = time.monotonic() + timeout
        while not condition():
            for each in self._started:
                if each.failed:
                    raise each.failure('ended early')
            if time.monotonic() > deadline:
                raise program.failure(otherwise)
            if meanwhile is None:
                time.sleep(0.02)
            else:
                meanwhile()


@contextmanager
def _program(folder: Path, name: str, *arguments: object, finite: bool) -> Iterator[Program]:
    log = folder / f'{name}.log'
    with log.open('wb') as output:
        process = subprocess.Popen(
            [sys.executable, '-m', f'pendubot_identification.nodes.{name}', *map(str, arguments)],
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
        )
        try:
            yield Program(name, process, log, finite)
        finally:
            process.send_signal(signal.SIGINT)
            try:
                process.wait(10.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
