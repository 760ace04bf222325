# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot report``: a result as a page to look at; ``pendubot identify --report`` makes the same."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pendubot_identification.errors import PendubotError

from .progress import progress_bar

if TYPE_CHECKING:
    from pendubot_identification.results.result import PartialResult

DESCRIPTION = """\
Make a report of a result: one HTML page to explore, which needs no network and prints well; with --figures also its
figures as SVG and PNG.

It shows the data with their windows, measured beside simulated motion, the residuals of every criterion, the
convergence of MDE, the parameters with their intervals, which of them the motion identifies, all warnings, and
where everything comes from. With each figure stands what a good one looks like.

The bags that the result names are read again; where one has been moved or changed, the report says so and leaves out
what would have been drawn from it.
"""
EPILOG = """\
examples:
  pendubot report result.yaml                                 into the folder result_report
  pendubot report result.yaml --reference last_week.yaml      last week's parameters beside these
  pendubot report result.yaml --bags ~/recordings --output there
"""


def add_parser(subparsers: Any) -> None:
    """Add this subcommand."""
    parser = subparsers.add_parser(
        'report', help='a page with figures from a result', description=DESCRIPTION, epilog=EPILOG
    )
    parser.add_argument('result', type=Path, metavar='RESULT.yaml', help='a file that pendubot identify wrote')
    parser.add_argument(
        '--output', type=Path, metavar='DIR', help='folder of the report (default: RESULT_report beside the result)'
    )
    parser.add_argument(
        '--bags', type=Path, metavar='FOLDER', help='where the bags lie now (default: where the result says)'
    )
    parser.add_argument('--figures', action='store_true', help='write the figures as SVG and PNG, too')
    add_reference(parser)
    parser.add_argument('--force', action='store_true', help='write into a folder that holds something already')
    parser.set_defaults(run=run)


def add_reference(parser: Any) -> None:
    """Add the option that sets other parameters beside the result's."""
    parser.add_argument(
        '--reference',
        type=Path,
        metavar='RESULT.yaml',
        help='parameters that the report shows beside the estimated ones: an earlier result, or values by hand',
    )


def run(args: argparse.Namespace) -> int:
    """Read a result and its bags, draw, write.

    Raises:
        PendubotError: there is no such result, or the folder cannot be written.
    """
    from pendubot_identification.files import OutputFolder, refuse_input
    from pendubot_identification.report.folder import write_report
    from pendubot_identification.results.provenance import recordings
    from pendubot_identification.results.result_file import read_complete_result

    result = read_complete_result(args.result)
    beside = read_beside(args.reference, 'reference') if args.reference else None
    path = args.output or args.result.with_name(f'{args.result.stem}_report')
    refuse_input(path / 'result.yaml', [args.reference])
    motions, notes = None, []
    with OutputFolder(path, overwrite=args.force) as folder:
        try:
            motions = recordings(result, args.bags)
        except PendubotError as error:
            notes = [f'what is drawn from the recordings; {error}']
            print(f'pendubot: left out {notes[0]}', file=sys.stderr)
        with progress_bar() as progress:
            page = write_report(folder, result, motions, beside, notes, progress, args.bags, static=args.figures)
    print(f'written to {page}')
    return 0


def read_beside(path: Path, name: str) -> tuple[PartialResult, str]:
    """Return the parameters of a file to stand beside a result's, and what to call them; warn of impossible ones.

    Raises:
        ResultError: there is no such file, or it holds no parameters.
    """
    from pendubot_identification.results.result_file import read_result

    data = read_result(path)
    for problem in data.unphysical():
        print(f'pendubot: {path}: {problem}', file=sys.stderr)
    return data, name
