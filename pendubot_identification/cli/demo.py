# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot demo``: the complete chain, live, on a virtual rig; the one subcommand that needs ROS.

Each demonstration starts board, bridge, recorder and exciter by :func:`_start_recording`. ``--balance`` then balances
the rig by the identified parameters, ``--track`` by those of the tracker.
"""

from __future__ import annotations

import argparse
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from tqdm import tqdm

from pendubot_identification.control.plan import HELD, deviation, held_since
from pendubot_identification.errors import PendubotError
from pendubot_identification.files import OutputFolder
from pendubot_identification.model.parameters import BALANCE, NAMES, PAPER, UNITS
from pendubot_identification.report import tables
from pendubot_identification.report.plots import draw_balance
from pendubot_identification.report.table import Table
from pendubot_identification.results.result_file import read_complete_result, read_parameters
from pendubot_identification.trajectories.trajectory import Trajectory

from .processes import POLL, Program, Programs, own_ros, parameters

Returned = TypeVar('Returned')


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
#: For how long a rig is held [s].
HOLD, HOLD_WITH_PAYLOAD = 10.0, 5.0
#: The payload on link 2 [kg], a fifth of its weight; the times before it and after its detection [s].
PAYLOAD, BEFORE, AFTER = 0.024, 8.0, 6.0
#: Every wait for the balancer or the tracker ends after this [s].
PATIENCE = 60.0


def run_demo(args: argparse.Namespace) -> int:
    """Run one of the demonstrations in a new folder."""
    if args.output is not None and args.output.exists():
        raise PendubotError(f'{args.output} exists already and was left as it is; name a folder that does not')
    folder = Path(tempfile.mkdtemp(prefix='pendubot-demo-')) if args.output is None else args.output.absolute()
    OutputFolder(folder)
    rig = BALANCE_RIG if args.balance or args.track else PAPER_RIG
    demonstrate = _balance if args.balance else _track if args.track else _identify
    with _interruptible(folder), own_ros() as (rclpy, domain):
        print(f'virtual rig in ROS domain {domain}, files in {folder}')
        print(f'virtual board: {rig.rate} Hz, 4000 counts per turn, {rig.description}', flush=True)
        demonstrate(rclpy, folder)
    return 0


@contextmanager
def _interruptible(folder: Path) -> Iterator[None]:
    """Treat SIGTERM like Ctrl-C, and name the folder with the recording."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    except KeyboardInterrupt:
        print(f'what was recorded so far is kept in {folder}', file=sys.stderr)
        raise
    finally:
        signal.signal(signal.SIGTERM, before)


def _identify(rclpy: Any, folder: Path) -> None:
    """Record the paper's experiment, identify, receive the parameters late, and print them beside the truth."""
    bag, written = folder / 'paper_experiment', folder / 'result.yaml'
    _twice(lambda: _record(rclpy, bag, PAPER_RIG))
    with Programs(folder) as programs:
        _start_identifier(programs, bag, written)
        late = Observer(rclpy)
        late.spin_until(lambda: late.parameters is not None, 'nothing came on /pendubot/params, joined late,')
    result, (label, values) = read_complete_result(written), late.parameters
    if values != result.theta.vector(result.model).tolist():
        raise PendubotError(f'/pendubot/params has {values}, the result file other values; please report this')
    print(f'a subscriber that joined afterwards received /pendubot/params ({label}): {result.criterion}\n')
    compared, runs = tables.comparison_table(result, asdict(PAPER)), tables.run_table(result)
    shown = [compared, tables.prediction_table(result), tables.criterion_table(result), *([runs] if runs else [])]
    print(*(table.text() for table in shown), tables.steps(result), tables.judgement(result), sep='\n\n')
    print(
        f'\nThe first {PAPER_RIG.samples // 2} samples estimate, the others validate. Encoder counts and central '
        'differences\nmove the minimum of energy away from the truth; MDE finds that minimum exactly.\n'
        f'\ntry: {sys.argv[0]} identify {bag}'
    )


def _balance(rclpy: Any, folder: Path) -> None:
    """Record, identify, swing up and hold the rig by the published parameters, and draw that."""
    bag, written, picture = folder / 'excitation', folder / 'result.yaml', folder / 'balance.png'
    _twice(lambda: _record(rclpy, bag, BALANCE_RIG))
    with Programs(folder) as programs:
        _start_identifier(programs, bag, written, model='viscous')
        observer = _twice(lambda: _balanced(rclpy, folder))
    t, q1, q2, tau = np.array(observer.samples).T
    motion = Trajectory(t - t[0], np.column_stack([q1, q2]), np.column_stack([tau, 0 * tau]), name='swing-up')
    draw_balance(picture, motion, LIMIT)
    error = np.abs(read_parameters(written).vector() / BALANCE.vector() - 1)[:5].max()
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
    """Swing up and hold a rig at rest by the parameters that are published; return the observer of that."""
    observer = Observer(rclpy)
    with Programs(folder, observer.spin) as programs:
        programs.start_rig(BALANCE_RIG.rate, *BALANCE_RIG.board)
        balancer = _start_balancer(programs, observer)
        _hold(programs, balancer, observer, HOLD)
    return observer


def _track(rclpy: Any, folder: Path) -> None:
    """Track a rig that gets a payload, balance it by that, take the payload off, and print parameters and truth."""
    bag = folder / 'followed'
    before, after = _twice(lambda: _tracked(rclpy, bag))
    columns = BALANCE.vector(), before, BALANCE.carrying(PAYLOAD).vector(), after
    rows = [
        [name, unit, *(f'{column[k]:.4g}' for column in columns)]
        for k, (name, unit) in enumerate(zip(NAMES[:7], UNITS, strict=False))
    ]
    head = ['', 'unit', 'without payload', 'followed', f'with {PAYLOAD:g} kg', 'followed']
    print('', Table(head, rows).text(), sep='\n')
    print(f'\ntry: {sys.argv[0]} track {bag} --model viscous --report {folder / "look"}')


def _tracked(rclpy: Any, bag: Path) -> tuple[list[float], list[float]]:
    """Return the last published parameters before the payload is put on, and with it."""
    observer = Observer(rclpy)
    with Programs(bag.parent, observer.spin) as programs:
        # As a node, the board has the parameter payload.
        _, exciter = _start_recording(programs, bag, BALANCE_RIG, '--ros-args')
        tracker = programs.start('tracker', *parameters(model='viscous'))

        def rest(seconds: float) -> list[float]:
            until = observer.now + seconds
            programs.wait(tracker, lambda: observer.now > until, 'heard no samples', seconds + PATIENCE)
            return list(observer.parameters[1])

        print('exciting; the tracker waits for motion', flush=True)
        programs.wait(tracker, lambda: observer.parameters is not None, 'published nothing', PATIENCE)
        print(f'it follows; after {BEFORE:g} s link 2 gets {PAYLOAD:g} kg more', flush=True)
        before = rest(BEFORE)
        observer.set_payload(PAYLOAD)
        programs.wait(tracker, lambda: observer.last_change != 'none', 'detected no payload', PATIENCE)
        print(f'the tracker: {observer.last_change}', flush=True)
        after = rest(AFTER)
        programs.end(exciter)
        balancer = _start_balancer(programs, observer)

        def balance() -> None:
            _hold(programs, balancer, observer, HOLD_WITH_PAYLOAD)
            samples = np.array(observer.samples)
            held = samples[samples[:, 0] > observer.now - HOLD_WITH_PAYLOAD, 1:3]
            angle = float(np.sqrt((deviation(held) ** 2).mean()))
            print(f'held for {HOLD_WITH_PAYLOAD:g} s, RMS angle {1e3 * angle:.1f} mrad', flush=True)

        balance()
        observer.set_payload(0.0)
        observer.samples.clear()
        balance()
    return before, after


def _twice(attempt: Callable[[], Returned]) -> Returned:
    """Return the result of an attempt or, if it fails, as on a computer that pauses, of an announced second one."""
    try:
        return attempt()
    except PendubotError as error:
        print(f'{error}\nonce more:', flush=True)
        return attempt()


def _start_recording(
    programs: Programs, bag: Path, rig: Rig, *board: object, **recorder: object
) -> tuple[Program, Program]:
    """Start board, bridge, recorder and exciter, in place of an earlier recording; return recorder and exciter."""
    if bag.exists():
        shutil.rmtree(bag)
    programs.start_rig(rig.rate, *rig.board, *board)
    recording = programs.start('recorder', *parameters(output=bag, **recorder))
    return recording, programs.start('exciter', *parameters(arm='true', duration=0.0, **rig.pulses))


def _record(rclpy: Any, bag: Path, rig: Rig) -> None:
    """Record an excited rig.

    Raises:
        PendubotError: a program ended early, or the bag was not complete in time.
    """
    observer, duration = Observer(rclpy), rig.samples / rig.rate
    with Programs(bag.parent, observer.spin) as programs, tqdm(total=rig.samples, disable=None, leave=False) as bar:
        recorder, _ = _start_recording(programs, bag, rig, max_messages=rig.samples)
        print(f'exciting and recording for {duration:g} s', flush=True)

        def complete() -> bool:
            bar.update(min(len(observer.samples), rig.samples) - bar.n)
            return recorder.process.poll() == 0

        programs.wait(recorder, complete, 'did not finish its bag', duration + 40.0)
    print(f'recorded {bag}', flush=True)


def _start_identifier(programs: Programs, bag: Path, written: Path, **others: object) -> None:
    """Start the identifier, which stays, and wait until it has written a result."""
    begin = time.monotonic()
    # The bridge holds its torques; the search of the hold would take some seconds more.
    given = parameters(bags=f"['{bag}']", output=written, hold='zero', **others)
    programs.wait(programs.start('identifier', *given), written.exists, 'wrote no result', 120.0)
    print(f'identified in {time.monotonic() - begin:.1f} s, start of the node included', flush=True)


def _start_balancer(programs: Programs, observer: Observer) -> Program:
    """Start the balancer and the swing-up; return the program. The samples begin anew."""
    # Every pause of the computer delays the clock of the patient board, and so the stamps of its samples.
    balancer = programs.start('balancer', *parameters(torque_limit=LIMIT, max_age=10.0))
    programs.wait(balancer, lambda: observer.balancer_message == 'ready', 'was not ready', PATIENCE)
    observer.samples.clear()
    observer.start_balancer()
    print('the balancer knows the rig through /pendubot/params alone; it swings it up', flush=True)
    return balancer


def _hold(programs: Programs, balancer: Program, observer: Observer, seconds: float) -> None:
    """Wait until the rig has been held upright for some seconds."""

    def ended() -> bool:
        return observer.held > seconds or observer.balancer_message.startswith('stopped')

    programs.wait(balancer, ended, 'did not hold it', PATIENCE)
    if observer.balancer_message.startswith('stopped'):
        raise PendubotError(f'the balancer {observer.balancer_message}')


class Observer:
    """A node that follows rig, tracker and balancer by their topics, and calls their services.

    Attributes:
        samples: each t [s], q1, q2 [rad], torque [N m].
        now: time of the last sample [s].
        parameters: names and values that /pendubot/params had last, or None.
        last_change: the last change that the tracker reports, or ``none``.
        balancer_message, balancer_values: the last status of the balancer.
    """

    def __init__(self, rclpy: Any) -> None:
        from diagnostic_msgs.msg import DiagnosticArray
        from rclpy.parameter_client import AsyncParameterClient
        from rclpy.qos import DurabilityPolicy, QoSProfile
        from sensor_msgs.msg import JointState
        from std_msgs.msg import Float64MultiArray
        from std_srvs.srv import Trigger

        self.samples: list[tuple[float, ...]] = []
        self.now = self._not_held = 0.0
        self.parameters: Any = None
        self.last_change = 'none'
        self.balancer_message, self.balancer_values = '', dict[str, str]()
        node, latched = (
            rclpy.create_node('demo_observer', enable_rosout=False),
            QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL),
        )
        node.create_subscription(JointState, '/joint_states', self._on_sample, 1000)
        node.create_subscription(Float64MultiArray, '/pendubot/params', self._on_parameters, latched)
        node.create_subscription(DiagnosticArray, '/pendubot/identification', self._on_diagnostics, latched)
        node.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 10)
        self._rclpy, self._node = rclpy, node
        self._starter, self._board = (
            node.create_client(Trigger, '/balancer/start'),
            AsyncParameterClient(node, 'virtual_board'),
        )

    def spin(self) -> None:
        """Handle the next message, or wait for a moment."""
        self._rclpy.spin_once(self._node, timeout_sec=POLL)

    def spin_until(self, condition: Callable[[], bool], otherwise: str) -> None:
        """Handle messages until a condition holds.

        Raises:
            PendubotError: it does not hold within 10 s.
        """
        deadline = time.monotonic() + 10.0
        while not condition():
            if time.monotonic() > deadline:
                raise PendubotError(f'{otherwise} within 10 s; try again')
            self.spin()

    @property
    def held(self) -> float:
        """For how long the rig has been upright [s]."""
        return self.now - self._not_held if self.samples else 0.0

    def start_balancer(self) -> None:
        """Start the swing-up.

        Raises:
            PendubotError: the balancer refuses or does not answer.
        """
        future = self._starter.call_async(self._starter.srv_type.Request())
        self.spin_until(future.done, 'the balancer did not answer')
        if not future.result().success:
            raise PendubotError(f'the balancer did not start: {future.result().message}')

    def set_payload(self, payload: float) -> None:
        """Put a payload [kg] on link 2.

        Raises:
            PendubotError: the board does not answer.
        """
        from rclpy.parameter import Parameter

        print(f'as would: ros2 param set /virtual_board payload {payload:g}', flush=True)
        future = self._board.set_parameters([Parameter('payload', value=payload)])
        self.spin_until(future.done, 'the virtual board did not answer')

    def _on_sample(self, message: Any) -> None:
        self.now = message.header.stamp.sec + message.header.stamp.nanosec * 1e-9
        if not self.samples or deviation(np.array([message.position[:2]]))[0] > HELD:
            self._not_held = self.now
        self.samples.append((self.now, *message.position[:2], message.effort[0]))

    def _on_parameters(self, message: Any) -> None:
        self.parameters = message.layout.dim[0].label, list(message.data)

    def _on_diagnostics(self, message: Any) -> None:
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            self.last_change = values.get('last_change', self.last_change)
            if status.name == 'balancer':
                self.balancer_message, self.balancer_values = status.message, values
