# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot excite``: the most informative pulse train, or the predicted motion of a given one."""

import argparse
import math
from collections.abc import Sequence
from dataclasses import replace

from pendubot_identification.errors import ParameterError, UsageError, wrong_usage
from pendubot_identification.excitation.design import SETTINGS, Experiment, Limits, design, predict
from pendubot_identification.excitation.excitation import PulseTrain
from pendubot_identification.excitation.exciter_file import read_exciter, write_exciter
from pendubot_identification.files import refuse_input, refuse_unwritable
from pendubot_identification.model.parameters import PAPER
from pendubot_identification.report.tables import excitation_table, motion_lines
from pendubot_identification.results.result_file import read_estimate

from .terminal import progress_bar


def run_excite(args: argparse.Namespace) -> int:
    """Design or check, show, write."""
    parameters, errors = (PAPER, None) if args.estimate is None else read_estimate(args.estimate)
    if args.design and (args.torque is None or args.speed is None):
        raise UsageError(
            'a design needs the limits of the rig; give --torque [N m] and --speed [rad/s], and --angle for cables or '
            'stops'
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
    if args.design:
        with progress_bar() as bar:

            def progress(done: int, best: float) -> None:
                bar('designing, generation', done, SETTINGS.generations, math.nan)

            found = design(parameters, limits, experiment, uncertainty=errors, progress=progress)
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
        _require_within_limits(args, [torque, *found.speed, *found.angle])
    if args.output is not None:
        write_exciter(args.output, found.train, experiment.duration, moved, overwrite=args.force)
        print(f'\nwritten to {args.output}')
    return 0


def _require_within_limits(args: argparse.Namespace, reached: Sequence[float]) -> None:
    """Raise ParameterError if the greatest torque, speeds or angles exceed the limits that are given."""
    limits = {
        'torque': (args.torque, 'N m'),
        'speed of the shoulder': (args.speed, 'rad/s'),
        'speed of the elbow': (args.speed, 'rad/s'),
        'angle of the shoulder': (args.angle[0], 'rad'),
        'angle of the elbow': (args.angle[1], 'rad'),
    }
    exceeded = [
        f'{name} up to {value:.4g} {unit} where {limit:g} {unit} are allowed'
        for (name, (limit, unit)), value in zip(limits.items(), reached, strict=True)
        if limit is not None and not value <= limit  # NaN, of a simulation that diverged, exceeds any limit
    ]
    if exceeded:
        raise ParameterError(
            f'{args.check} exceeds the limits: {"; ".join(exceeded)}; give it smaller torques or shorter pulses, or '
            'search another with --design'
        )
