# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot demo``: runs the complete chain on a virtual rig; the only subcommand that needs ROS."""

from __future__ import annotations

import argparse
import json
import os
import random
import shlex
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pendubot_identification.errors import PendubotError
from pendubot_identification.files import OutputFolder
from pendubot_identification.model.parameters import PAPER
from pendubot_identification.report import tables
from pendubot_identification.results.result import Parameter, PartialResult, read_complete_result

#: Environment variables that extend discovery beyond this computer, or join another domain.
OUTWARD = (
    *('ROS_STATIC_PEERS', 'ROS_LOCALHOST_ONLY', 'ROS_DISCOVERY_SERVER', 'ROS_SUPER_CLIENT', 'CYCLONEDDS_URI'),
    *('FASTDDS_DEFAULT_PROFILES_FILE', 'FASTRTPS_DEFAULT_PROFILES_FILE'),
)
#: Domains whose ports are free on every system, without the default domain 0.
DOMAINS = range(1, 101)
#: Time for the discovery of the programs in a domain [s]: usually 0.2 s, but Fast DDS repeats a lost announcement only
#: after 3 s.
DISCOVERY = 4.0
#: Number of domains that are tried.
TRIES = 5
#: Interval at which conditions are checked [s].
POLL = 0.02
#: Sampling rate [Hz], and samples of the recording.
RATE, SAMPLES = 100, 1800
#: Longest pause of the computer that ends no program, while the virtual rig waits [s].
PAUSE = 2.0


def run_demo(args: argparse.Namespace) -> int:
    """Record the paper's experiment, identify, receive the parameters late, and print them beside the truth."""
    if args.output is not None and args.output.exists():
        raise PendubotError(f'{args.output} exists already and was left as it is; name a new folder')
    with own_ros() as (rclpy, domain):
        folder = Path(tempfile.mkdtemp(prefix='pendubot-demo-')) if args.output is None else args.output.absolute()
        OutputFolder(folder)
        bag, written = folder / 'paper_experiment', folder / 'result.yaml'
        print(f'virtual rig in ROS domain {domain}, files in {folder}')
        print(f'virtual board: {RATE} Hz, 4000 counts per turn, the parameters of the paper', flush=True)
        with Programs(folder) as programs:
            _record(programs, folder / 'board', bag)
        with Programs(folder) as programs:
            begin = time.monotonic()
            # The bridge holds its torques, so the selection of the hold, which takes some seconds, is unnecessary.
            identifier = programs.start('identifier', bags=[str(bag)], output=written, hold='zero')
            programs.wait(identifier, written.exists, 'wrote no result', 120.0)
            print(f'identified in {time.monotonic() - begin:.1f} s, start of the node included', flush=True)
            names = _late_subscriber(rclpy)
            programs.wait(identifier, lambda: names() != '', 'published nothing on /pendubot/params')
    result = read_complete_result(written)
    print(f'a subscriber that joined afterwards received /pendubot/params ({names()}): {result.criterion}\n')
    truth = PartialResult(parameters={name: Parameter(value=value) for name, value in asdict(PAPER).items()})
    print(tables.parameter_table(result, (truth, 'true value')).text(), tables.summary(result), sep='\n\n')
    print(
        f'\nThe first {SAMPLES // 2} samples are for training, the others for validation. Encoder counts\n'
        'and central differences move the minimum of energy away from the truth; MDE finds that minimum exactly.\n'
        f'\ntry: {shlex.join([sys.argv[0], "identify", str(bag)])}'
    )
    return 0


@contextmanager
def own_ros() -> Iterator[tuple[Any, int]]:
    """Initialise ROS on this computer only, in a random empty domain; yield rclpy and the number of the domain.

    Domain and discovery range of the environment are not used, because they may reach a rig. Programs that start within
    the context use the same domain.

    Raises:
        PendubotError: ROS is missing, or other programs are in every domain that was tried.
    """
    exported = os.environ.get('ROS_DOMAIN_ID', '').strip()
    tried = random.sample([each for each in DOMAINS if str(each) != exported], TRIES)
    for name in OUTWARD:
        os.environ.pop(name, None)
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    try:
        import rclpy
        from rclpy.signals import SignalHandlerOptions
    except ImportError as error:
        raise PendubotError(
            f'rclpy cannot be imported ({error}), and the demo needs ROS 2, unlike pendubot simulate and identify; '
            "source your ROS workspace, or install the package with pip install '.[ros]'"
        ) from error
    try:
        for domain in tried:
            os.environ['ROS_DOMAIN_ID'] = str(domain)
            # Without its signal handlers, which would end ROS before the programs are ended.
            rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
            # The node remains, so that another demo does not use this domain.
            node, deadline, alone = rclpy.create_node('demo'), time.monotonic() + DISCOVERY, True
            while alone and time.monotonic() < deadline:
                time.sleep(POLL)
                alone = len(node.get_node_names()) == 1 and not node.count_publishers('/joint_states')
            if alone:
                yield rclpy, domain
                return
            rclpy.shutdown()
        raise PendubotError(
            f'other ROS programs are in each of the domains {", ".join(map(str, tried))}, and the demo arms only in an '
            'empty domain; nothing was armed; end those programs, or try again'
        )
    finally:
        rclpy.try_shutdown()


def _record(programs: Programs, port: Path, bag: Path) -> None:
    """Record an excited rig, whose board and bridge tolerate a pause of the computer.

    Raises:
        PendubotError: a program ended early, or the bag was not complete in time.
    """
    board = programs.start('virtual_board', '--patient', '--link', port, '--rate', RATE)
    programs.wait(board, port.exists, 'opened no port')
    programs.start('bridge', port=port, link_timeout=PAUSE, confirm_zeros=False)
    recorder = programs.start('recorder', output=bag, max_messages=SAMPLES)
    programs.start('exciter', arm=True, duration=0.0)
    print(f'exciting and recording for {SAMPLES / RATE:g} s', flush=True)
    programs.wait(recorder, lambda: recorder.poll() == 0, 'did not finish its bag', SAMPLES / RATE + 40.0)
    print(f'recorded {bag}', flush=True)


def _late_subscriber(rclpy: Any) -> Callable[[], str]:
    """Subscribe to ``/pendubot/params``; return a function that returns the received names, '' before."""
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from std_msgs.msg import Float64MultiArray

    node, received = rclpy.create_node('demo_subscriber', enable_rosout=False), list[Any]()
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    node.create_subscription(Float64MultiArray, '/pendubot/params', received.append, latched)

    def names() -> str:
        if not received:
            rclpy.spin_once(node, timeout_sec=POLL)
        return received[0].layout.dim[0].label if received else ''

    return names


class Program(subprocess.Popen[bytes]):
    """A program in a separate process, with its output in a file."""

    def __init__(self, folder: Path, name: str, arguments: list[str]) -> None:
        self.name, self.log = name, folder / f'{name}.log'
        command = [sys.executable, '-m', 'pendubot_identification.programs', name, *arguments]
        with self.log.open('ab') as output:
            super().__init__(command, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT)

    def failure(self, reason: str) -> PendubotError:
        """Return an error with the reason and the last line of the output."""
        last = self.log.read_text(errors='replace').strip().splitlines()[-1:] or ['it had no output']
        return PendubotError(f'{self.name} {reason}: {last[0]}; see {self.log}')

    def end(self) -> None:
        """Interrupt it, and kill it after 10 s."""
        self.send_signal(signal.SIGINT)
        try:
            self.wait(10.0)
        except subprocess.TimeoutExpired:
            self.kill()
            self.wait()


class Programs(ExitStack):
    """Programs that run until the end of the context, with their output in a folder; they end in reverse order."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self._folder, self._running = folder, list[Program]()

    def start(self, name: str, *arguments: object, **parameters: object) -> Program:
        """Start a program of this package with arguments and, if it is a node, parameters."""
        # ROS reads values as YAML, and JSON quotes a path with an apostrophe, # or : in it.
        values = {key: json.dumps(value, default=str, ensure_ascii=False) for key, value in parameters.items()}
        settings = [word for key, value in values.items() for word in ('-p', f'{key}:={value}')]
        program = Program(self._folder, name, [*map(str, arguments), *(['--ros-args'] if settings else []), *settings])
        self.callback(program.end)
        self._running.append(program)
        return program

    def wait(self, program: Program, condition: Callable[[], bool], otherwise: str, timeout: float = 20.0) -> None:
        """Wait for a condition that a program has to fulfil.

        Raises:
            PendubotError: the wait takes longer than ``timeout`` [s], or a program has ended early.
        """
        deadline = time.monotonic() + timeout
        while not condition():
            for each in self._running:
                if each.poll() is not None and not (each is program and condition()):
                    raise each.failure('ended early')
            if time.monotonic() > deadline:
                raise program.failure(otherwise)
            time.sleep(POLL)
