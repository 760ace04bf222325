# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot import``: a motion from a file with columns into a bag."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pendubot_identification.errors import UsageError, wrong_usage

from .progress import progress_bar
from .reading import add_reading, reading_of, save_map
from .terminal import columns, curve, shows_curves

if TYPE_CHECKING:
    from pendubot_identification.trajectories.trajectory import Trajectory

#: Where the curves begin.
MARGIN = 6

DESCRIPTION = """\
Turn a file with columns into a bag with the topic /joint_states, as the recorder writes it, and say what was taken.
identify, info and compare read such files themselves; a bag is for ROS.

  .csv .txt .tsv   a line of column names, then rows; separated by commas, semicolons or tabs
  .mat             MATLAB's variables, or the fields of a struct; q with two columns is q1 and q2. 7.3 needs h5py
  .xlsx            the first sheet: a row of column names, then rows. Needs pandas and openpyxl
  .parquet         needs pandas and pyarrow

The columns are by default
  t           time [s]
  q1, q2      angles of shoulder and elbow [rad]
  tau1        torque at the shoulder [N m]
and, where they are there,
  tau2        torque at the elbow [N m], else 0
  dq1, dq2    velocities [rad/s]
A row's torque is the one applied from that row until the next."""

EPILOG = """\
examples:
  pendubot import run.csv --output run
  pendubot import run.mat --output run --columns t=time,q1=th1,q2=th2,tau1=u --degrees --zero hanging
  pendubot import other.mat --output other --map lab.yaml      as kept by --save-map lab.yaml"""


def add_parser(subparsers: Any) -> None:
    """Add this subcommand."""
    parser = subparsers.add_parser(
        'import',
        aliases=['import-csv'],
        help='turn a file of CSV, MATLAB, Excel or Parquet into a bag',
        description=DESCRIPTION,
        epilog=EPILOG,
    )
    parser.add_argument('file', metavar='FILE', type=Path, help='the file with columns')
    parser.add_argument('--output', metavar='BAG', type=Path, required=True, help="the bag's folder, which is made")
    add_reading(parser)
    parser.add_argument('--force', action='store_true', help='replace a bag of that name')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Import, and say what came of it.

    Raises:
        PendubotError: the file cannot be read or the bag not written.
    """
    from pendubot_identification.recordings.joint_states import write_trajectory
    from pendubot_identification.recordings.survey import as_text, survey_table
    from pendubot_identification.recordings.table_reader import TableReader
    from pendubot_identification.recordings.tables import FORMATS, is_table

    with wrong_usage():
        reading = reading_of(args)
    if not is_table(args.file):
        raise UsageError(
            f'{args.file} is no file with columns; one whose name ends in {", ".join(FORMATS)} is expected'
        )
    reader = TableReader(args.file, reading)
    with progress_bar() as progress:
        progress(f'reading {args.file.name}', 0, 0, math.nan)
        motion = reader.motion

        def written(done: int) -> None:
            progress(f'writing {args.output.name}', done, len(motion), math.nan)

        write_trajectory(args.output, motion, overwrite=args.force, progress=written)
    save_map(args, reading)
    print(f'{args.output}: {as_text(survey_table(reader))}')
    if shows_curves():
        print(_sketch(motion))
    return 0


def _sketch(motion: Trajectory) -> str:
    """Return curves of both angles and the torque over the time."""
    width = columns() - MARGIN
    lines = []
    for name, x in (('q1', motion.q[:, 0]), ('q2', motion.q[:, 1]), ('tau1', motion.tau[:, 0])):
        lines += [f'{label:{MARGIN}}{line}' for label, line in zip(('', name), curve(x, width, 2), strict=True)]
    return '\n'.join([*lines, f'{"":{MARGIN}}0 s{f"{motion.duration:.4g} s":>{width - 3}}'])
