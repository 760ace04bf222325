# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot import-csv``: a motion from a CSV file into a bag."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from pendubot_identification.errors import wrong_usage

DESCRIPTION = """\
Turn a CSV file into a bag with the topic /joint_states, as the recorder writes it.

The file's first line names its columns, by default
  t           time [s]
  q1, q2      angles of shoulder and elbow [rad]
  tau1        torque at the shoulder [N m]
and, where they are there,
  tau2        torque at the elbow [N m], else 0
  dq1, dq2    velocities [rad/s]
A row's torque is the one applied from that row until the next."""

EPILOG = """\
examples:
  pendubot import-csv run.csv --output run
  pendubot import-csv run.csv --output run --columns t=time,q1=th1,q2=th2,tau1=u --degrees --zero hanging"""


def add_parser(subparsers: Any) -> None:
    """Add this subcommand."""
    parser = subparsers.add_parser(
        'import-csv', help='turn a CSV file into a bag', description=DESCRIPTION, epilog=EPILOG
    )
    parser.add_argument('file', metavar='FILE', type=Path, help='the CSV file, with a line of column names')
    parser.add_argument('--output', metavar='BAG', type=Path, required=True, help="the bag's folder, which is made")
    parser.add_argument(
        '--columns',
        metavar='t=NAME,...',
        type=columns,
        default={},
        help='what the file calls its columns, for those with other names than above',
    )
    parser.add_argument(
        '--degrees', action='store_true', help='angles are in degrees, velocities in degrees per second'
    )
    parser.add_argument(
        '--zero',
        choices=('horizontal', 'hanging'),
        default='horizontal',
        help='where the angles are zero: with link 1 horizontal (default), or hanging straight down',
    )
    parser.add_argument(
        '--elbow',
        choices=('relative', 'absolute'),
        default='relative',
        help='whether q2 is the angle to link 1 (default), or measured from the same zero as q1',
    )
    parser.add_argument('--force', action='store_true', help='replace a bag of that name')
    parser.set_defaults(run=run)


def columns(text: str) -> dict[str, str]:
    """Return what ``t=NAME,q1=NAME`` says.

    Raises:
        argparse.ArgumentTypeError: it says nothing of the kind.
    """
    named: dict[str, str] = {}
    for part in text.split(','):
        quantity, _, name = (word.strip() for word in part.partition('='))
        if not (quantity and name) or quantity in named:
            raise argparse.ArgumentTypeError(f'{part!r} is not understood; t=NAME,q1=NAME,... is expected, each once')
        named[quantity] = name
    return named


def run(args: argparse.Namespace) -> int:
    """Import, and say what came of it.

    Raises:
        PendubotError: the file cannot be read or the bag not written.
    """
    from pendubot_identification.recordings.csv_import import import_csv, wanted
    from pendubot_identification.recordings.joint_states import write_trajectory

    with wrong_usage():
        wanted(args.columns)
    trajectory = import_csv(args.file, args.columns, degrees=args.degrees, zero=args.zero, elbow=args.elbow)
    write_trajectory(args.output, trajectory, overwrite=args.force)
    rate = (len(trajectory) - 1) / trajectory.duration if trajectory.duration else 0.0
    print(f'{args.output}: {len(trajectory)} samples, {trajectory.duration:.3f} s, {rate:.1f} Hz')
    return 0
