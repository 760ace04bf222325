# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The subcommands that write bags: import, simulate and repair."""

import argparse
import json
import math
from dataclasses import asdict

import numpy as np

from pendubot_identification.errors import UsageError, wrong_usage
from pendubot_identification.excitation.excitation import PulseTrain, read_exciter
from pendubot_identification.model.parameters import PAPER
from pendubot_identification.model.simulation import quantised, simulate
from pendubot_identification.recordings.bag_repair import repair
from pendubot_identification.recordings.joint_states import write_trajectory
from pendubot_identification.recordings.survey import as_text, survey_table
from pendubot_identification.recordings.table_reader import TableReader
from pendubot_identification.recordings.tables import FORMATS, is_table
from pendubot_identification.results.result import read_result

from .options import conversion_of
from .terminal import progress_bar


def run_import(args: argparse.Namespace) -> int:
    """Convert a file with columns to a bag, and describe its content."""
    with wrong_usage():
        conversion = conversion_of(args)
    if not is_table(args.file):
        raise UsageError(f'{args.file} is no file with columns; a name that ends in {", ".join(FORMATS)} is expected')
    reader = TableReader(args.file, conversion)
    with progress_bar() as progress:
        progress(f'reading {args.file.name}', 0, 0, math.nan)
        motion = reader.motion

        def report(done: int) -> None:
            progress(f'writing {args.output.name}', done, len(motion), math.nan)

        write_trajectory(args.output, motion, overwrite=args.force, progress=report)
    print(f'{args.output}: {as_text(survey_table(reader))}')
    return 0


def run_simulate(args: argparse.Namespace) -> int:
    """Write a bag of the virtual rig, faster than real time."""
    if not 1 <= args.samples <= 10_000_000 or not 1 <= args.rate <= 100_000 or args.counts < 0:
        raise UsageError(
            f'{args.samples} samples at {args.rate:g} Hz with {args.counts} counts per turn are no recording; 1 to '
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


def run_repair(args: argparse.Namespace) -> int:
    """Write a closed copy of a bag, and print the number of saved messages."""
    # The absolute path has a name even if the given path ends with a slash.
    bag = args.bag.absolute()
    output = args.output or bag.parent / f'{bag.stem if bag.is_file() else bag.name}_repaired'
    files = repair(args.bag, output, overwrite=args.force)
    intact = all(file.intact for file in files)
    if args.json:
        print(json.dumps({'output': str(output), 'intact': intact, 'files': [*map(asdict, files)]}, indent=2))
        return 0
    for file in files:
        print(f'{file.file}: {file.unread or ("closed" if file.closed else "never closed, or truncated")}')
        width = max(map(len, file.saved), default=0)
        for topic, count in file.saved.items():
            lost = file.missing.get(topic)
            print(f'  {topic:{width}} {count:8d} messages saved' + (f', {lost} lost' if lost else ''))
        for damage in file.damaged:
            print(f'  {damage.size} bytes from byte {damage.offset} on are damaged and left out')
    if intact:
        print('nothing was missing or damaged')
    print(f'written to {output}, closed; the original is unchanged')
    return 0
