# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot excite``: the pulse train that tells a rig's parameters best, and what a given one would tell."""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

from pendubot_identification.errors import ParameterError, UsageError, wrong_usage

DESCRIPTION = """\
Design an excitation, or predict what a given one does. A design is the pulse train whose motion tells most of the
parameters (D-optimal: the smallest ellipsoid of confidence), simulated from hanging at rest with the parameters as they
are known now, within a torque, a speed and angles that you set. It is written as a parameter file of the exciter.
"""
EPILOG = """\
examples:
  pendubot excite --design --torque 1 --speed 30 --output exciter.yaml         for the paper's rig
  pendubot excite --design --torque 1 --speed 20 --from result.yaml            for yours; 20 rad/s at most
  pendubot excite --design --torque 1 --speed 20 --angle 1.5 6.3               cables: a quarter turn, one turn
  pendubot excite --check exciter.yaml --from result.yaml                      what would it do, and tell?
  pendubot excite --check exciter.yaml --speed 20                              does it keep within 20 rad/s?

then: ros2 run pendubot_identification exciter --ros-args --params-file exciter.yaml
A rig differs from its estimate: watch the first run, with a hand at the emergency stop.
"""


def add_parser(subparsers: Any) -> None:
    """Add this subcommand."""
    parser = subparsers.add_parser(
        'excite',
        help='design an excitation',
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument('--design', action='store_true', help='search the pulse train that tells most')
    what.add_argument('--check', type=Path, metavar='EXCITER.yaml', help='predict what this one does and tells')
    parser.add_argument(
        '--from',
        dest='estimate',
        type=Path,
        metavar='RESULT.yaml',
        help="the rig's parameters as known now: a result of pendubot identify (default: the paper's rig)",
    )
    limits = parser.add_argument_group(
        'limits', 'a design keeps within them; what is checked is held against those that are given'
    )
    limits.add_argument('--torque', type=float, metavar='NM', help='greatest torque, either way [N m]')
    limits.add_argument('--speed', type=float, metavar='RAD_S', help='greatest speed of either joint [rad/s]')
    limits.add_argument(
        '--angle',
        type=float,
        nargs=2,
        default=(math.inf, math.inf),
        metavar=('SHOULDER', 'ELBOW'),
        help='how far each joint may turn away from hanging, either way [rad]; 6.28 is a turn (default: no limit)',
    )
    how = parser.add_argument_group('how it is recorded')
    how.add_argument('--duration', type=float, default=18.0, metavar='S', help='of the excitation (default 18)')
    how.add_argument('--rate', type=float, default=100.0, metavar='HZ', help='sampling rate (default 100)')
    how.add_argument('--counts', type=int, default=4000, help='encoder counts per turn (default 4000)')
    search = parser.add_argument_group('search and output')
    search.add_argument('--seed', type=int, default=1, help='same seed, same design (default 1)')
    search.add_argument('--generations', type=int, default=30, help='of the search, 80 trains each (default 30)')
    search.add_argument('--output', type=Path, metavar='EXCITER.yaml', help="write the exciter's parameter file here")
    search.add_argument('--force', action='store_true', help='overwrite an existing file')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Design or check, show, write."""
    from tqdm import tqdm

    from pendubot_identification.excitation.design import Experiment, Limits, design, predict
    from pendubot_identification.excitation.excitation import PulseTrain
    from pendubot_identification.excitation.exciter_file import read_exciter, write_exciter
    from pendubot_identification.files import refuse_input, refuse_unwritable
    from pendubot_identification.model.parameters import PAPER
    from pendubot_identification.optimizers.mde import MDESettings
    from pendubot_identification.optimizers.optimizer import require_runs
    from pendubot_identification.report.tables import excitation_table, motion_lines
    from pendubot_identification.results.result_file import read_estimate

    parameters, errors = (PAPER, None) if args.estimate is None else read_estimate(args.estimate)
    if args.design and (args.torque is None or args.speed is None):
        raise UsageError(
            'a design needs to know what the rig may do; give --torque [N m] and --speed [rad/s], and --angle where '
            'there are cables or stops'
        )
    if args.output is not None:
        refuse_input(args.output, [args.check, args.estimate])
        refuse_unwritable(args.output, overwrite=args.force)
    if not args.rate > 0:
        raise UsageError(f'the sampling rate is {args.rate:g} Hz; a number above 0 is expected')
    given = {'torque': args.torque, 'speed': args.speed}
    with wrong_usage():
        limits = Limits(**{name: limit for name, limit in given.items() if limit is not None}, angle=tuple(args.angle))
        experiment = Experiment(args.duration, 1 / args.rate, args.counts)
        # What the search would refuse, before the rig's parameters have a part in it.
        MDESettings(generations=args.generations)
        require_runs(1, 1, args.seed)
    if args.design:
        # On a terminal, and nowhere else.
        with tqdm(desc='designing', disable=None, leave=False, unit=' generations', total=args.generations) as bar:

            def progress(done: int, best: float) -> None:
                bar.set_postfix_str(f'ln det of the information {best:.1f}', refresh=False)
                bar.update(done - bar.n)

            search = {'generations': args.generations, 'seed': args.seed}
            found = design(parameters, limits, experiment, uncertainty=errors, progress=progress, **search)
    else:
        train, duration = read_exciter(args.check)
        experiment = replace(experiment, duration=duration or args.duration)
        (found,) = predict(parameters, [train], experiment)
    torque = max(abs(found.train.amplitude_min), abs(found.train.amplitude_max))
    greatest = args.torque if args.design else torque
    (paper,) = predict(parameters, [PulseTrain(amplitude_min=-greatest, amplitude_max=greatest)], experiment)
    moved = motion_lines(found, experiment)
    print(*moved, '', excitation_table(parameters, errors, paper, found).text(), sep='\n')
    if args.check is not None:
        _hold_against(args, [torque, *found.speed, *found.angle])
    if args.output is not None:
        write_exciter(args.output, found.train, experiment.duration, moved, overwrite=args.force)
        print(f'\nwritten to {args.output}')
    return 0


def _hold_against(args: argparse.Namespace, reached: list[float]) -> None:
    """Refuse greatest torque, speeds and angles that exceed the limits that were given."""
    of = ('torque', 'speed of the shoulder', 'speed of the elbow', 'angle of the shoulder', 'angle of the elbow')
    limits = (args.torque, args.speed, args.speed, *args.angle)
    units = ('N m', 'rad/s', 'rad/s', 'rad', 'rad')
    # A motion that runs off into what is no number exceeds any limit.
    exceeded = [
        f'{name} up to {value:.4g} {unit} where {limit:g} {unit} are allowed'
        for name, value, limit, unit in zip(of, reached, limits, units, strict=True)
        if limit is not None and not value <= limit
    ]
    if exceeded:
        raise ParameterError(
            f'{args.check} exceeds the limits: {"; ".join(exceeded)}; give it smaller torques or shorter pulses, or '
            'search another with --design'
        )
