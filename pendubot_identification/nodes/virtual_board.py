# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``virtual_board``: a simulated pendubot rig on a pseudo-terminal. Only its ROS parameter needs ROS."""

import argparse
import math
import random
import secrets
import signal
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import fields
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
  (names with _at: seconds after the start; the others: probabilities for each frame or sample)
limits: {', '.join(Limits._fields)}
  (in the units of docs/protocol.md; 0: no such limit)

example:
  virtual_board --link /tmp/pendubot --rate 100 --fault bit_flip=0.001 --fault reset_at=20
  virtual_board --link /tmp/pendubot --parameters result.yaml
  virtual_board --link /tmp/pendubot --preset balance --rate 500 --start upright --spread 0.1 --delay 0.004
  bridge --ros-args -p port:=/tmp/pendubot

with --ros-args and an installed ROS it is also a node with one parameter, payload [kg]: the mass at the end of link 2
(3/2 P2 / P5 from the elbow), which may change during the motion:
  ros2 param set /virtual_board payload 0.03

signals: SIGUSR1 pulls the cable in the middle of a frame, SIGUSR2 reconnects it (--link then leads to another pty)

exit status: 0 success or ended by a signal, 1 a failure explained in one line, 2 wrong usage"""

PAYLOAD = Setting('payload', 0.0, 'payload at the end of link 2', 'kg', 0.0, 10.0, dynamic=True)
STARTS = {'hanging': HANGING, 'upright': (math.pi / 2, 0.0)}


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    p = argparse.ArgumentParser(
        prog='virtual_board',
        description='A virtual board with a simulated pendubot: it serves the serial protocol on a pty in real time, '
        'with encoders, torque limit, watchdog and arming like a real board.',
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog=EPILOG,
    )

    def number(name: str, default: float, unit: str, meaning: str) -> None:
        p.add_argument(name, type=type(default), default=default, metavar=unit, help=f'{meaning} (default {default})')

    p.add_argument('--link', type=Path, metavar='PATH', help='path of a symbolic link to the pty')
    number('--rate', 100.0, 'HZ', 'sampling rate')
    number('--counts', 4000, 'N', 'encoder counts per turn')
    number('--torque-limit', 2.0, 'NM', "the board's limit [N m]")
    preset = 'parameters of the rig in the paper, or of a typical balancing rig (default %(default)s)'
    p.add_argument('--preset', choices=PRESETS, default='paper', help=preset)
    result = 'a result of pendubot identify with the parameters, friction and rotor included, instead of a preset'
    p.add_argument('--parameters', type=Path, metavar='RESULT.yaml', help=result)
    start = 'initial position; a rig that does not hang at rest is fixed there until first armed (default %(default)s)'
    p.add_argument('--start', choices=STARTS, default='hanging', help=start)
    number('--spread', 0.0, 'RAD', 'largest random deviation of each angle from the initial position')
    number('--delay', 0.0, 'S', "delay of the motor behind the board's report")
    patient = 'stop the simulated time while this computer delays the program and, armed, while no command arrives, '
    p.add_argument('--patient', action='store_true', help=patient + 'so that the rig waits for its controller')
    p.add_argument('--seed', type=int, help='seed of all random numbers (default: a new seed every time, printed)')
    p.add_argument('--trace', type=Path, metavar='FILE', help="write the board's samples as CSV")
    fault = 'a simulated fault, see below; repeatable'
    p.add_argument('--fault', action='append', default=[], metavar='NAME=VALUE', help=fault)
    limit = 'a limit at which the board switches its motor off, see below; repeatable'
    p.add_argument('--limit', action='append', default=[], metavar='NAME=VALUE', help=limit)
    number('--duration', math.inf, 'S', 'duration of the simulation')
    return p


def make_board(options: argparse.Namespace) -> VirtualBoard:
    """Return the virtual board for the options.

    Raises:
        ParameterError: a value is invalid, or the parameters are unphysical.
        ResultError: the parameters cannot be read.
    """
    ranges = ('rate', 1, 10_000, ' Hz'), ('spread', 0, 1, ''), ('delay', 0, 1, ''), ('duration', 0, math.inf, ' s')
    for name, low, high, unit in ranges:
        if not low <= (value := getattr(options, name)) <= high:
            raise ParameterError(f'--{name} is {value:g}{unit}; a number from {low} to {high} is expected')
    if options.seed < 0:
        raise ParameterError(f'--seed is {options.seed}; a number of at least 0 is expected')
    parameters = PRESETS[options.preset]
    if options.parameters is not None:
        # Imported here, because the board starts ten times faster without this import.
        from pendubot_identification.results.result import read_result

        parameters = read_result(options.parameters).theta
    chance = random.Random(options.seed)
    q1, q2 = (q + chance.uniform(-options.spread, options.spread) for q in STARTS[options.start])
    plant = LatePlant(parameters, options.delay, (q1, q2))
    # The torque that holds both links horizontal is no stall.
    held = 1.5 * ((parameters.P4 + parameters.P5) * GRAVITY + parameters.Fc1)
    given = {'stall_torque': max(LIMITS.stall_torque, round(1e6 * held))}
    limits = LIMITS._replace(**given | _named('limit', options.limit, Limits._fields, int))
    period = round(1e6 / options.rate)
    settings = BoardSettings(options.counts, options.torque_limit, sample_period_us=period, limits=limits)
    faults = Faults(**_named('fault', options.fault, [each.name for each in fields(Faults)], float))
    return VirtualBoard(plant, settings, faults, options.seed, held=(q1, q2) != HANGING)


def _named(kind: str, texts: Sequence[str], names: Sequence[str], number: Callable[[str], Any]) -> dict[str, Any]:
    """Return the values of options of the form NAME=VALUE by name."""
    values = {}
    for text in texts:
        name, _, value = text.partition('=')
        if name not in names:
            raise ParameterError(f'there is no {kind} {name!r}; the {kind}s are {", ".join(names)}')
        try:
            values[name] = number(value)
        except ValueError:
            whole = 'whole ' * (number is int)
            raise ParameterError(f'the {kind} {text!r} has no {whole}number; write {name}=VALUE') from None
    return values


def _report(event: str) -> None:
    print(f'{event} at {time.time_ns()} ns', flush=True)


def _node(board: VirtualBoard, ended: Shutdown) -> AbstractContextManager[Any]:
    """Return the context of a running ROS node with the board's payload as its parameter."""
    from .runtime import SettingsNode, running

    class BoardNode(SettingsNode):
        PROGRAM, SETTINGS = 'virtual_board', (PAYLOAD,)

        def _open(self, s: dict[str, Any]) -> None:
            board.carry(s['payload'])

        def _change(self, s: dict[str, Any]) -> None:
            board.carry(s['payload'])
            self.get_logger().info(f'link 2 carries {s["payload"]:g} kg')

    return running(BoardNode, ended)


def main() -> int:
    """Serve a virtual board until a signal; return the exit status."""
    argv = sys.argv[1:]
    options = parser().parse_args(argv[: argv.index('--ros-args')] if '--ros-args' in argv else argv)
    if options.seed is None:
        # A real board has another boot_id after each start; with the same boot_id a restart would stay undetected.
        options.seed = secrets.randbits(32)
    ended = Shutdown()
    at_signal(ended.set)
    try:
        board = make_board(options)
        with (
            _node(board, ended) if '--ros-args' in argv else nullcontext(),
            PtyServer(board, options.link, options.trace, _report, options.patient) as server,
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
