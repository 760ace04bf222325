# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot simulate``: a bag from the virtual rig, faster than real time."""

from __future__ import annotations

import argparse

import numpy as np

from pendubot_identification.errors import UsageError, wrong_usage
from pendubot_identification.excitation.excitation import PulseTrain
from pendubot_identification.excitation.exciter_file import read_exciter
from pendubot_identification.model.parameters import PAPER
from pendubot_identification.model.simulation import quantised, simulate
from pendubot_identification.recordings.joint_states import write_trajectory
from pendubot_identification.results.result_file import read_result


def run(args: argparse.Namespace) -> int:
    """Simulate and write."""
    if not 1 <= args.samples <= 10_000_000 or not 1 <= args.rate <= 100_000 or args.counts < 0:
        raise UsageError(
            f'{args.samples} samples at {args.rate:g} Hz with {args.counts} counts per turn make no recording; 1 to '
            '10000000 samples, a rate from 1 to 100000 Hz and counts of at least 0 are expected'
        )
    if args.excitation is not None:
        train, _ = read_exciter(args.excitation)
    else:
        with wrong_usage():
            train = PulseTrain(seed=1 if args.seed is None else args.seed)
    parameters = PAPER if args.parameters is None else read_result(args.parameters).theta
    t = np.arange(args.samples) / args.rate
    motion = simulate(parameters, t, np.column_stack([train.torques(t), np.zeros(args.samples)]))
    write_trajectory(args.output, quantised(motion, args.counts) if args.counts else motion, overwrite=args.force)
    print(f'{args.samples} samples, {motion.duration:.2f} s, written to {args.output}')
    return 0
