# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``virtual_board``: a pendubot rig that is not there, on a pseudo-terminal. Needs no ROS, but for its parameter."""

import argparse
import math
import random
import secrets
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from pendubot_identification.errors import ParameterError, PendubotError
from pendubot_identification.link.protocol import Limits
from pendubot_identification.link.pty_server import PtyServer
from pendubot_identification.link.virtual_board import LIMITS, BoardSettings, Faults, VirtualBoard
from pendubot_identification.model.dynamics import GRAVITY
from pendubot_identification.model.parameters import PRESETS
from pendubot_identification.model.simulation import HANGING, LatePlant
from pendubot_identification.setting import Setting

from .shutdown import Shutdown, at_signal, ignore_signals

EPILOG = f"""\
faults: {', '.join(each.name for each in fields(Faults))}
  (those named _at are seconds after the start, the others probabilities for each frame or sample)
limits: {', '.join(each.name for each in fields(Limits))}
  (in the units of docs/protocol.md; 0: no such limit)

example:
  virtual_board --link /tmp/pendubot --rate 100 --fault bit_flip=0.001 --fault reset_at=20
  virtual_board --link /tmp/pendubot --parameters result.yaml
  virtual_board --link /tmp/pendubot --preset balance --rate 500 --start upright --spread 0.1 --delay 0.004
  bridge --ros-args -p port:=/tmp/pendubot

with --ros-args, where there is ROS, it is a node too, of one parameter, payload [kg]: the mass at the end of link 2
(3/2 P2 / P5 from the elbow), also put on and taken off while it moves:
  ros2 param set /virtual_board payload 0.03

signals: SIGUSR1 pulls the cable in the middle of a frame, SIGUSR2 puts it back (--link then leads to another pty)

exit status: 0 success or ended by a signal, 1 a failure explained in one line, 2 wrong usage"""

PAYLOAD = Setting('payload', 0.0, 'payload at the end of link 2', 'kg', 0.0, 10.0, dynamic=True)
STARTS = {'hanging': HANGING, 'upright': (math.pi / 2, 0.0)}


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    p = argparse.ArgumentParser(
        prog='virtual_board',
        description='A virtual board with a pendubot behind it: it speaks the serial protocol on a pty, in real time, '
        'with encoders, torque limit, watchdog and arming like the real one.',
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog=EPILOG,
    )

    def number(name: str, default: float, unit: str, meaning: str) -> None:
        p.add_argument(name, type=type(default), default=default, metavar=unit, help=f'{meaning} (default {default})')

    p.add_argument('--link', type=Path, metavar='PATH', help='make a symbolic link to the pty here')
    number('--rate', 100.0, 'HZ', 'sampling rate')
    number('--counts', 4000, 'N', 'encoder counts per turn')
    number('--torque-limit', 2.0, 'NM', "the board's limit [N m]")
    preset = "the pendubot: the paper's, or one with the proportions of rigs that people balance (default %(default)s)"
    p.add_argument('--preset', choices=PRESETS, default='paper', help=preset)
    result = "the pendubot's, friction and rotor included, instead of a preset: a result of pendubot identify"
    p.add_argument('--parameters', type=Path, metavar='RESULT.yaml', help=result)
    start = 'where it begins; anywhere but hanging exactly it is held there until first armed (default %(default)s)'
    p.add_argument('--start', choices=STARTS, default='hanging', help=start)
    number('--spread', 0.0, 'RAD', 'each angle begins at random within so much of there')
    number('--delay', 0.0, 'S', 'the motor obeys so much later than the board says')
    patient = 'its time stands still while this computer keeps it waiting and, armed, while no command comes: the rig '
    p.add_argument('--patient', action='store_true', help=patient + 'does not run on without its controller')
    p.add_argument('--seed', type=int, help='of everything random (default: a new one every time, printed)')
    p.add_argument('--trace', type=Path, metavar='FILE', help='write every sample as the board took it, as CSV')
    fault = 'something that goes wrong, see below; repeatable'
    p.add_argument('--fault', action='append', default=[], metavar='NAME=VALUE', help=fault)
    limit = 'a limit at which the board switches its motor off, see below; repeatable'
    p.add_argument('--limit', action='append', default=[], metavar='NAME=VALUE', help=limit)
    number('--duration', math.inf, 'S', 'end after so many seconds')
    return p


def make_board(options: argparse.Namespace) -> VirtualBoard:
    """Return the board that the options describe.

    Raises:
        ParameterError: a value that makes no sense, or parameters that no pendubot has.
        ResultError: parameters that cannot be read.
    """
    for name, low, high, unit in (('rate', 1, 10_000, ' Hz'), ('spread', 0, 1, ''), ('delay', 0, 1, '')):
        if not low <= (value := getattr(options, name)) <= high:
            raise ParameterError(f'--{name} is {value:g}{unit}; a number from {low} to {high} is expected')
    if options.seed < 0:
        raise ParameterError(f'--seed is {options.seed}; a number of at least 0 is expected')
    parameters = PRESETS[options.preset]
    if options.parameters is not None:
        # Only here: without this import the board starts ten times faster.
        from pendubot_identification.results.result_file import read_result

        parameters = read_result(options.parameters).theta
    chance = random.Random(options.seed)
    q1, q2 = (q + chance.uniform(-options.spread, options.spread) for q in STARTS[options.start])
    plant = LatePlant(parameters, options.delay, (q1, q2))
    # The torque that holds both links level is no stall.
    held = 1.5 * ((parameters.P4 + parameters.P5) * GRAVITY + parameters.Fc1)
    limits = replace(LIMITS, stall_torque=max(LIMITS.stall_torque, round(1e6 * held)))
    limits = replace(limits, **_named('limit', options.limit, Limits, int))
    period = round(1e6 / options.rate)
    settings = BoardSettings(options.counts, options.torque_limit, sample_period_us=period, limits=limits)
    faults = Faults(**_named('fault', options.fault, Faults, float))
    return VirtualBoard(plant, settings, faults, options.seed, held=(q1, q2) != HANGING)


def _named(kind: str, texts: Sequence[str], table: type, number: Callable[[str], Any]) -> dict[str, Any]:
    """Return the values of options of the form NAME=VALUE by name, which is a field of the table."""
    names, found = [each.name for each in fields(table)], {}
    for text in texts:
        name, _, value = text.partition('=')
        if name not in names:
            raise ParameterError(f'there is no {kind} {name!r}; the {kind}s are {", ".join(names)}')
        try:
            found[name] = number(value)
        except ValueError:
            raise ParameterError(f'the {kind} {text!r} has no number; write {name}=VALUE') from None
    return found


def _report(event: str) -> None:
    print(f'{event} at {time.time_ns()} ns', flush=True)


@contextmanager
def _node(board: VirtualBoard, ended: Shutdown) -> Iterator[None]:
    """Make the board a ROS node, too, whose parameter is the payload."""
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    from .runtime import SettingsNode, running

    class BoardNode(SettingsNode):
        PROGRAM, SETTINGS = 'virtual_board', (PAYLOAD,)

        def _open(self, s: dict[str, Any]) -> None:
            board.carry(s['payload'])

        def _change(self, s: dict[str, Any]) -> None:
            board.carry(s['payload'])
            self.get_logger().info(f'link 2 carries {s["payload"]:g} kg')

    rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)
    try:
        with running(BoardNode(ended)):
            yield
    finally:
        rclpy.try_shutdown()


def main() -> int:
    """Serve a virtual board until a signal comes; return the exit status."""
    argv = sys.argv[1:]
    options = parser().parse_args(argv[: argv.index('--ros-args')] if '--ros-args' in argv else argv)
    if options.seed is None:
        # A real board has another boot_id each time it starts; the same one would claim that it never stopped.
        options.seed = secrets.randbits(32)
    ended = Shutdown()
    at_signal(ended.set)
    try:
        board = make_board(options)
        with (
            PtyServer(board, options.link, options.trace, _report, options.patient) as server,
            _node(board, ended) if '--ros-args' in argv else nullcontext(),
        ):
            signal.signal(signal.SIGUSR1, lambda *_: server.pull())
            signal.signal(signal.SIGUSR2, lambda *_: server.plug())
            print(f'seed {options.seed}\nvirtual board on {server.path}', flush=True)
            server.serve(ended.is_set, options.duration)
    except (PendubotError, ImportError) as error:
        print(f'virtual_board: {error}', file=sys.stderr)
        return 1
    finally:
        ignore_signals()
    return 0
