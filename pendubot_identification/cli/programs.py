# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Programs of this package, run by a demonstration in processes of their own."""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, TypeVar

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
#: The computer may pause for so long [s] and end nothing: the virtual rig waits meanwhile.
PAUSE = 2.0
#: How often it is looked how things stand [s].
LOOK = 0.02

Result = TypeVar('Result')


@contextmanager
def own_ros(domains: Sequence[int] = ()) -> Iterator[tuple[Any, int]]:
    """Initialise ROS on this computer alone, in a domain in which nobody is; yield rclpy and the domain's number.

    Neither the domain nor the range of discovery that the environment names is used: a rig may be there. What is
    started within is in the same domain. ``domains`` are tried in this order; without them, some drawn at random.

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
        from rclpy.signals import SignalHandlerOptions
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
            rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
            # It stays, so that others who look for a domain of their own find this one taken.
            node, deadline = rclpy.create_node('demo'), time.monotonic() + DISCOVERY
            met = False
            while not met and time.monotonic() < deadline:
                time.sleep(LOOK)
                met = len(node.get_node_names()) > 1 or node.count_publishers('/joint_states') > 0
            if not met:
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
    """A program of this package in a process of its own, its output in a file; a ``finite`` one ends by itself."""

    def __init__(self, folder: Path, name: str, arguments: Sequence[object], finite: bool) -> None:
        self.name, self.finite, self.log = name, finite, folder / f'{name}.log'
        with self.log.open('ab') as output:
            self.process = subprocess.Popen(
                [sys.executable, '-m', f'pendubot_identification.nodes.{name}', *map(str, arguments)],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
            )

    @property
    def ended(self) -> bool:
        """Whether it has ended well."""
        return self.process.poll() == 0

    def failure(self, reason: str) -> PendubotError:
        """Return the error that says what it said last."""
        last = self.log.read_text(errors='replace').strip().splitlines()[-1:] or ['it said nothing']
        return PendubotError(f'{self.name} {reason}: {last[0]} (all it said: {self.log})')

    def end(self) -> None:
        """Interrupt it, and kill it where that does not end it."""
        self.process.send_signal(signal.SIGINT)
        try:
            self.process.wait(10.0)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()


class Programs(ExitStack):
    """Programs that run until the end of the block, their output in the folder; the last is ended first."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self._folder, self._started = folder, list[Program]()

    def start(self, name: str, *arguments: object, finite: bool = False) -> Program:
        """Start a program of this package."""
        program = Program(self._folder, name, arguments, finite)
        self.callback(program.end)
        self._started.append(program)
        return program

    def wait(
        self,
        program: Program,
        condition: Callable[[], bool],
        otherwise: str,
        timeout: float = 20.0,
        meanwhile: Callable[[], object] = lambda: time.sleep(LOOK),
    ) -> None:
        """Wait for what a program brings about.

        Raises:
            PendubotError: that takes too long, or any of the programs has ended early.
        """
        deadline = time.monotonic() + timeout
        while not condition():
            for each in self._started:
                if each.process.poll() is not None and not (each.finite and each.ended):
                    raise each.failure('ended early')
            if time.monotonic() > deadline:
                raise program.failure(otherwise)
            meanwhile()

    def start_rig(self, rate: int, *options: object) -> None:
        """Start a virtual board and a bridge that outlast a pause of this computer."""
        port = self._folder / 'board'
        board = self.start('virtual_board', '--patient', '--link', port, '--rate', rate, *options)
        self.wait(board, port.exists, 'opened no port')
        self.start('bridge', *parameters(port=port, link_timeout=PAUSE, confirm_zeros='false'))


def once_more(attempt: Callable[[], Result]) -> Result:
    """Return what an attempt returns, or where it fails, as on a computer that pauses, a second one, announced."""
    try:
        return attempt()
    except PendubotError as error:
        print(f'{error}\nonce more:', flush=True)
        return attempt()


def record_excitation(
    rclpy: Any, bag: Path, samples: int, rate: int, options: Sequence[object] = (), **pulses: object
) -> None:
    """Excite a virtual rig and record it, in a new bag or in place of what a failed attempt left.

    The programs' output lies beside the bag. ``options`` are the board's, beside its rate [Hz]; ``pulses`` are
    parameters of the exciter.

    Raises:
        PendubotError: a program ended early, or the bag was not complete in time.
    """
    from sensor_msgs.msg import JointState
    from tqdm import tqdm

    if bag.exists():
        shutil.rmtree(bag)
    node = rclpy.create_node('demo_progress')
    with Programs(bag.parent) as programs, tqdm(total=samples, unit=' samples', disable=None, leave=False) as bar:
        programs.callback(node.destroy_node)
        node.create_subscription(JointState, '/joint_states', lambda _: bar.update(min(1, samples - bar.n)), 1000)
        programs.start_rig(rate, *options)
        recorder = programs.start('recorder', *parameters(output=bag, max_messages=samples), finite=True)
        programs.start('exciter', *parameters(arm='true', duration=0.0, **pulses))
        print(f'exciting and recording for {samples / rate:g} s', flush=True)
        programs.wait(
            recorder,
            lambda: recorder.ended,
            'did not finish its bag',
            samples / rate + 40.0,
            lambda: rclpy.spin_once(node, timeout_sec=LOOK),
        )
    print(f'recorded {bag}', flush=True)
