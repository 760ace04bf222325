# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot report``: a page with figures from a result; ``pendubot identify --report`` makes the same."""

from __future__ import annotations

import argparse
import sys

from pendubot_identification.errors import PendubotError
from pendubot_identification.files import OutputFolder, refuse_input
from pendubot_identification.report.page import write_report
from pendubot_identification.results.provenance import recordings
from pendubot_identification.results.result_file import read_complete_result

from .identify import read_beside
from .terminal import progress_bar


def run(args: argparse.Namespace) -> int:
    """Read a result and its bags, draw, write."""
    result = read_complete_result(args.result)
    beside = read_beside(args.reference, 'reference') if args.reference else None
    path = args.output or args.result.with_name(f'{args.result.stem}_report')
    refuse_input(path / 'result.yaml', [args.reference])
    motions, notes = None, []
    with OutputFolder(path, overwrite=args.force) as folder:
        try:
            motions = recordings(result, args.bags)
        except PendubotError as error:
            notes = [f'figures of the recordings; {error}']
            print(f'pendubot: left out {notes[0]}', file=sys.stderr)
        with progress_bar() as progress:
            page = write_report(folder, result, motions, beside, notes, progress, args.bags, static=args.figures)
    print(f'written to {page}')
    return 0
