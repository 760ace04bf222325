# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot demo``: runs the complete chain on a virtual rig; the only subcommand that needs ROS.

``--balance`` then balances the rig with the identified parameters.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from pendubot_identification.control.plan import HELD, deviation, held_since
from pendubot_identification.errors import PendubotError
from pendubot_identification.files import OutputFolder
from pendubot_identification.model.parameters import BALANCE, PAPER
from pendubot_identification.report import tables
from pendubot_identification.results.result import Parameter, PartialResult, read_complete_result, read_result
from pendubot_identification.trajectories.trajectory import Trajectory

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


@dataclass(frozen=True)
class Rig:
    """A virtual rig, the length of its recording, and the parameters of the exciter."""

    description: str
    rate: int  #: [Hz]
    samples: int
    board: tuple[object, ...] = ()
    pulses: Mapping[str, object] = field(default_factory=dict)


#: The torque limit of the rig for balancing [N m].
LIMIT = 2.0
PAPER_RIG = Rig('the parameters of the paper', 100, 1800)
BALANCE_RIG = Rig(
    f'a motor 4 ms late, {LIMIT:g} N m',
    200,
    2400,
    ('--preset', 'balance', '--delay', 0.004, '--torque-limit', LIMIT),
    {'amplitude_min': -LIMIT, 'amplitude_max': LIMIT},
)
#: Duration of balancing, and the longest wait for the balancer [s].
HOLD, PATIENCE = 10.0, 60.0
#: Longest pause of the computer that ends no program, while the virtual rig waits [s].
PAUSE = 2.0


def run_demo(args: argparse.Namespace) -> int:
    """Run one of the demonstrations in a new folder."""
    if args.output is not None and args.output.exists():
        raise PendubotError(f'{args.output} exists already and was left as it is; name a new folder')
    folder = Path(tempfile.mkdtemp(prefix='pendubot-demo-')) if args.output is None else args.output.absolute()
    OutputFolder(folder)
    demonstrate, rig = (_balance, BALANCE_RIG) if args.balance else (_identify, PAPER_RIG)
    with _interruptible(folder), own_ros() as (rclpy, domain):
        print(f'virtual rig in ROS domain {domain}, files in {folder}')
        print(f'virtual board: {rig.rate} Hz, 4000 counts per turn, {rig.description}', flush=True)
        demonstrate(rclpy, folder)
    return 0


@contextmanager
def _interruptible(folder: Path) -> Iterator[None]:
    """Treat SIGTERM like Ctrl-C, and print the folder with the recording."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    except KeyboardInterrupt:
        print(f'the recordings so far are kept in {folder}', file=sys.stderr)
        raise
    finally:
        signal.signal(signal.SIGTERM, before)


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


def _identify(rclpy: Any, folder: Path) -> None:
    """Record the paper's experiment, identify, receive the parameters late, and print them beside the truth."""
    bag, written = folder / 'paper_experiment', folder / 'result.yaml'
    _twice(lambda: _record(bag, PAPER_RIG))
    with Programs(folder) as programs:
        identifier = _start_identifier(programs, bag, written)
        late = Observer(rclpy)
        programs.meanwhile = late.spin
        programs.wait(identifier, lambda: late.parameters != '', 'published nothing on /pendubot/params')
    result = read_complete_result(written)
    print(f'a subscriber that joined afterwards received /pendubot/params ({late.parameters}): {result.criterion}\n')
    truth = PartialResult(parameters={name: Parameter(value=value) for name, value in asdict(PAPER).items()})
    print(tables.parameter_table(result, (truth, 'true value')).text(), tables.summary(result), sep='\n\n')
    print(
        f'\nThe first {PAPER_RIG.samples // 2} samples are for training, the others for validation. Encoder counts\n'
        'and central differences move the minimum of energy away from the truth; MDE finds that minimum exactly.\n'
        f'\ntry: {sys.argv[0]} identify {bag}'
    )


def _balance(rclpy: Any, folder: Path) -> None:
    """Record, identify, swing up and balance the rig with the published parameters, and draw the motion."""
    bag, written, picture = folder / 'excitation', folder / 'result.yaml', folder / 'balance.png'
    _twice(lambda: _record(bag, BALANCE_RIG))
    with Programs(folder) as programs:
        _start_identifier(programs, bag, written, model='viscous')
        observer = _twice(lambda: _balanced(rclpy, folder))
    t, q1, q2, tau = np.array(observer.samples).T
    motion = Trajectory(t - t[0], np.column_stack([q1, q2]), np.column_stack([tau, 0 * tau]), name='swing-up')
    from pendubot_identification.report.plots import draw_balance  # imports matplotlib

    draw_balance(picture, motion, LIMIT)
    error = np.abs(read_result(written).theta.vector() / BALANCE.vector() - 1)[:5].max()
    print(f'identified within {100 * error:.2g} % of P1 to P5; picture: {picture}')
    upright = held_since(motion)
    steady = motion.t > upright + 1
    angle, torque = (float(np.sqrt((x[steady] ** 2).mean())) for x in (deviation(motion.q), tau))
    print(
        f'upright after {upright:.1f} s, held for {motion.t[-1] - upright:.1f} s: RMS angle {1e3 * angle:.1f} mrad, '
        f'RMS torque {torque:.3f} N m, at most {abs(tau).max():.3f} of {LIMIT:g} N m'
    )
    print(', '.join(f'{key} {value}' for key, value in observer.balancer_values.items() if 'margin' in key))


def _balanced(rclpy: Any, folder: Path) -> Observer:
    """Swing up and balance a rig from rest with the published parameters; return the observer of the motion."""
    observer = Observer(rclpy)

    def ended() -> bool:
        return observer.held > HOLD or observer.balancer_message.startswith('stopped')

    with Programs(folder, observer.spin) as programs:
        _start_rig(programs, folder, BALANCE_RIG)
        # Every pause of the computer delays the clock of the patient board, and so the stamps of its samples.
        balancer = programs.start('balancer', torque_limit=LIMIT, max_age=10.0)
        programs.wait(balancer, lambda: observer.balancer_message == 'ready', 'was not ready', PATIENCE)
        observer.samples.clear()
        answer = observer.starter.call_async(observer.starter.srv_type.Request())
        programs.wait(balancer, answer.done, 'did not answer')
        if not answer.result().success:
            raise PendubotError(f'the balancer did not start: {answer.result().message}')
        print('the balancer uses only the parameters on /pendubot/params; it swings the rig up', flush=True)
        programs.wait(balancer, ended, 'did not hold it', PATIENCE)
    if observer.balancer_message.startswith('stopped'):
        raise PendubotError(f'the balancer stopped: {observer.balancer_message.removeprefix("stopped: ")}')
    return observer


def _twice(attempt: Callable[[], Any]) -> Any:
    """Return the result of a first or, if it fails, for example on a computer that pauses, a second attempt."""
    try:
        return attempt()
    except PendubotError as error:
        print(f'{error}\nonce more:', flush=True)
        return attempt()


def _start_rig(programs: Programs, folder: Path, rig: Rig) -> None:
    """Start a virtual board and a bridge that tolerate a pause of the computer."""
    port = folder / 'board'
    board = programs.start('virtual_board', '--patient', '--link', port, '--rate', rig.rate, *rig.board)
    programs.wait(board, port.exists, 'opened no port')
    programs.start('bridge', port=port, link_timeout=PAUSE, confirm_zeros='false')


def _record(bag: Path, rig: Rig) -> None:
    """Record an excited rig, and replace an earlier recording.

    Raises:
        PendubotError: a program ended early, or the bag was not complete in time.
    """
    shutil.rmtree(bag, ignore_errors=True)
    duration = rig.samples / rig.rate
    with Programs(bag.parent) as programs:
        _start_rig(programs, bag.parent, rig)
        recorder = programs.start('recorder', output=bag, max_messages=rig.samples)
        programs.start('exciter', arm='true', duration=0.0, **rig.pulses)
        print(f'exciting and recording for {duration:g} s', flush=True)
        programs.wait(recorder, lambda: recorder.poll() == 0, 'did not finish its bag', duration + 40.0)
    print(f'recorded {bag}', flush=True)


def _start_identifier(programs: Programs, bag: Path, written: Path, **others: object) -> Program:
    """Start the identifier, which keeps running, and wait for its result file."""
    begin = time.monotonic()
    # The bridge holds its torques, so the selection of the hold, which takes some seconds, is unnecessary.
    identifier = programs.start('identifier', bags=f"['{bag}']", output=written, hold='zero', **others)
    programs.wait(identifier, written.exists, 'wrote no result', 120.0)
    print(f'identified in {time.monotonic() - begin:.1f} s, start of the node included', flush=True)
    return identifier


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
    """Programs that run until the end of the context, with their output in a folder; they end in reverse order.

    :meth:`wait` calls ``meanwhile`` repeatedly.
    """

    def __init__(self, folder: Path, meanwhile: Callable[[], object] = lambda: time.sleep(POLL)) -> None:
        super().__init__()
        self.meanwhile = meanwhile
        self._folder, self._running = folder, list[Program]()

    def start(self, name: str, *arguments: object, **parameters: object) -> Program:
        """Start a program of this package with arguments and, if it is a node, parameters."""
        settings = [word for key, value in parameters.items() for word in ('-p', f'{key}:={value}')]
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
            self.meanwhile()


class Observer:
    """A node that subscribes to the topics of rig, parameters and balancer.

    Attributes:
        samples: samples (t [s], q1, q2 [rad], torque [N m]).
        held: time for which the rig has been upright [s].
        parameters: names of the last parameters; empty before the first message.
        balancer_message, balancer_values: the last status of the balancer.
        starter: the client of the balancer's ``~/start``.
    """

    def __init__(self, rclpy: Any) -> None:
        from diagnostic_msgs.msg import DiagnosticArray
        from rclpy.qos import DurabilityPolicy, QoSProfile
        from sensor_msgs.msg import JointState
        from std_msgs.msg import Float64MultiArray
        from std_srvs.srv import Trigger

        self.samples: list[tuple[float, ...]] = []
        self.held = self._not_held = 0.0
        self.parameters = self.balancer_message = ''
        self.balancer_values: dict[str, str] = {}
        self._rclpy, self._node = rclpy, rclpy.create_node('demo_observer', enable_rosout=False)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._node.create_subscription(JointState, '/joint_states', self._on_sample, 1000)
        self._node.create_subscription(Float64MultiArray, '/pendubot/params', self._on_parameters, latched)
        self._node.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 10)
        self.starter = self._node.create_client(Trigger, '/balancer/start')

    def spin(self) -> None:
        """Handle the next message, or wait for :data:`POLL`."""
        self._rclpy.spin_once(self._node, timeout_sec=POLL)

    def _on_sample(self, message: Any) -> None:
        t, q = message.header.stamp.sec + message.header.stamp.nanosec * 1e-9, message.position[:2]
        if not self.samples or deviation(np.array([q]))[0] > HELD:
            self._not_held = t
        self.held = t - self._not_held
        self.samples.append((t, *q, message.effort[0]))

    def _on_parameters(self, message: Any) -> None:
        self.parameters = message.layout.dim[0].label

    def _on_diagnostics(self, message: Any) -> None:
        for status in message.status:
            if status.name == 'balancer':
                self.balancer_message = status.message
                self.balancer_values = {pair.key: pair.value for pair in status.values}
