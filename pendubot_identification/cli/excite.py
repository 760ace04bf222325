# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot excite``: designs the most informative pulse train, or predicts the motion under a given pulse train."""

import argparse
import math
from collections.abc import Sequence
from dataclasses import replace

from pendubot_identification.errors import ParameterError, UsageError, wrong_usage
from pendubot_identification.excitation.design import SETTINGS, Experiment, Limits, design, predict
from pendubot_identification.excitation.excitation import PulseTrain, read_exciter, write_exciter
from pendubot_identification.files import refuse_input, refuse_unwritable
from pendubot_identification.model.parameters import PAPER
from pendubot_identification.report.tables import excitation_table, motion_lines
from pendubot_identification.results.result import estimate_of, read_result

from .terminal import print_level, progress_bar


def run_excite(args: argparse.Namespace) -> int:
    """Design or check an excitation, print its information, and write it."""
    parameters, errors = PAPER, None
    if args.estimate is not None:
        result = read_result(args.estimate)
        print_level(result)
        parameters, errors = estimate_of(result)
    if args.design and (args.torque is None or args.speed is None):
        raise UsageError(
            'a design needs the limits of the rig; add --torque [N m] and --speed [rad/s], and --angle for cables or '
            'stops'
        )
    if args.output is not None:
        refuse_input(args.output, [args.check, args.estimate])
        refuse_unwritable(args.output, overwrite=args.force)
    if not args.rate > 0:
        raise UsageError(f'the sampling rate is {args.rate:g} Hz; a number above 0 is expected')
    bounds = {'torque': args.torque, 'speed': args.speed}
    with wrong_usage():
        limits = Limits(**{name: limit for name, limit in bounds.items() if limit is not None}, angle=tuple(args.angle))
        experiment = Experiment(args.duration, 1 / args.rate, args.counts)
    if args.design:
        with progress_bar() as bar:

            def progress(done: int, best: float) -> None:
                bar('designing, generation', done, SETTINGS.generations, math.nan)

            prediction = design(parameters, limits, experiment, uncertainty=errors, progress=progress)
    else:
        train, duration = read_exciter(args.check)
        experiment = replace(experiment, duration=duration or args.duration)
        (prediction,) = predict(parameters, [train], experiment)
        if not math.isfinite(prediction.speed.max()):
            raise ParameterError(f'{args.check}: the simulation diverges; use smaller torques or shorter pulses')
    torque = max(abs(prediction.train.amplitude_min), abs(prediction.train.amplitude_max))
    largest = args.torque if args.design else torque
    (paper,) = predict(parameters, [PulseTrain(amplitude_min=-largest, amplitude_max=largest)], experiment)
    motion = motion_lines(prediction, experiment)
    print(*motion, '', excitation_table(parameters, errors, paper, prediction).text(), sep='\n')
    if args.check is not None:
        _require_within_limits(args, [torque, *prediction.speed, *prediction.angle])
    if args.output is not None:
        write_exciter(args.output, prediction.train, experiment.duration, motion, overwrite=args.force)
        print(f'\nwritten to {args.output}')
    return 0


def _require_within_limits(args: argparse.Namespace, reached: Sequence[float]) -> None:
    """Raise ParameterError if the largest torque, speeds or angles exceed the given limits."""
    limits = {
        'torque': (args.torque, 'N m'),
        'speed of the shoulder': (args.speed, 'rad/s'),
        'speed of the elbow': (args.speed, 'rad/s'),
        'angle of the shoulder': (args.angle[0], 'rad'),
        'angle of the elbow': (args.angle[1], 'rad'),
    }
    exceeded = [
        f'{name} up to {value:.4g} {unit}, limit {limit:g} {unit}'
        for (name, (limit, unit)), value in zip(limits.items(), reached, strict=True)
        if limit is not None and value > limit
    ]
    if exceeded:
        raise ParameterError(
            f'{args.check} exceeds the limits: {"; ".join(exceeded)}; use smaller torques or shorter pulses, or search '
            'a pulse train with --design'
        )
