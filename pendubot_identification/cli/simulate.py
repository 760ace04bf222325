# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot simulate``: a bag from the virtual rig, faster than real time."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from pendubot_identification.errors import UsageError, wrong_usage

DESCRIPTION = """\
Write a bag of the virtual rig (the paper's parameters, or a result's) under the paper's pulse train, as its encoders
would have read it, much faster than real time and without ROS. The same options give the same bag.
"""
EPILOG = """\
parameters by hand, as a RESULT.yaml: those from P1 to b2, and of Fc1 Fc2 J2 Fs1 Fs2 k1 k2 those that are not 0
  schema: 1
  parameters: {P1: {value: 0.0022}, P2: {value: 0.0004}, ..., b2: {value: 0.0001}, Fc1: {value: 0.002}}
"""


#: Options that say what the pulses are; those that are not given have the defaults of the pulse train.
PULSES = ('period', 'width', 'hold', 'amplitude', 'seed')


def add_parser(subparsers: Any) -> None:
    """Add this subcommand."""
    parser = subparsers.add_parser(
        'simulate', help='write a bag of the virtual rig', description=DESCRIPTION, epilog=EPILOG
    )
    parser.add_argument('--output', type=Path, required=True, metavar='BAG', help='the folder of the new bag')
    parser.add_argument('--samples', type=int, default=1800, help='default: %(default)s')
    parser.add_argument('--rate', type=float, default=100.0, metavar='HZ', help='sampling rate (default %(default)s)')
    parser.add_argument(
        '--counts', type=int, default=4000, help='encoder counts per turn, 0: exact (default %(default)s)'
    )
    parser.add_argument('--period', type=float, metavar='S', help='from pulse to pulse (default 1.0)')
    parser.add_argument('--width', type=float, help='pulse length over period (default 0.05)')
    parser.add_argument('--hold', type=float, metavar='S', help='of each random torque (default 0.01)')
    parser.add_argument(
        '--amplitude', type=float, nargs=2, metavar=('MIN', 'MAX'), help='torque [N m] (default -1.0 1.0)'
    )
    parser.add_argument('--seed', type=int, help='of the torque (default 1)')
    parser.add_argument(
        '--excitation',
        type=Path,
        metavar='EXCITER.yaml',
        help="the exciter's parameter file, as pendubot excite writes it, instead of the pulses above",
    )
    parser.add_argument(
        '--parameters',
        type=Path,
        metavar='RESULT.yaml',
        help="the rig's, friction and rotor included: a result of pendubot identify (default: the paper's)",
    )
    parser.add_argument('--force', action='store_true', help='overwrite an existing bag')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Simulate and write."""
    import numpy as np

    from pendubot_identification.excitation.excitation import PulseTrain
    from pendubot_identification.excitation.exciter_file import read_exciter
    from pendubot_identification.model.parameters import PAPER
    from pendubot_identification.model.simulation import quantised, simulate
    from pendubot_identification.recordings.joint_states import write_trajectory
    from pendubot_identification.results.result_file import read_parameters

    if not 1 <= args.samples <= 10_000_000 or not 1 <= args.rate <= 100_000 or args.counts < 0:
        raise UsageError(
            f'{args.samples} samples at {args.rate:g} Hz with {args.counts} counts per turn make no recording; 1 to '
            '10000000 samples, a rate from 1 to 100000 Hz and counts of at least 0 are expected'
        )
    pulses = {name: given for name in PULSES if (given := getattr(args, name)) is not None}
    if args.excitation is not None:
        if pulses:
            given = next(iter(pulses))
            raise UsageError(
                f'--excitation {args.excitation} says what the pulses are, and so does --{given}; give one of the two'
            )
        train, _ = read_exciter(args.excitation)
    else:
        if 'amplitude' in pulses:
            pulses['amplitude_min'], pulses['amplitude_max'] = pulses.pop('amplitude')
        with wrong_usage():
            train = PulseTrain(**pulses)
    parameters = PAPER if args.parameters is None else read_parameters(args.parameters)
    t = np.arange(args.samples) / args.rate
    tau = np.column_stack([train.torques(t), np.zeros(args.samples)])
    motion = simulate(parameters, t, tau)
    write_trajectory(args.output, quantised(motion, args.counts) if args.counts else motion, overwrite=args.force)
    print(f'{args.samples} samples, {motion.duration:.2f} s, written to {args.output}')
    return 0
