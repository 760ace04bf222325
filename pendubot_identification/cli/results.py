# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The subcommands that read results: report, compare and export."""

import argparse
import json
import sys
from dataclasses import replace

from pendubot_identification.errors import PendubotError, UsageError, wrong_usage
from pendubot_identification.files import OutputFolder, refuse_input, write_atomically
from pendubot_identification.formats.export import FORMATS, ROBOTS, SUFFIXES, export, require_limit
from pendubot_identification.level import Level
from pendubot_identification.recordings.bag_reader import read_trajectory
from pendubot_identification.recordings.datasets import windows_of
from pendubot_identification.report.tables import comparison
from pendubot_identification.results.comparison import compare
from pendubot_identification.results.provenance import recordings
from pendubot_identification.results.result import read_complete_result, read_result
from pendubot_identification.setting import flag

from .options import conversion_of
from .terminal import print_level, progress_bar


def run_report(args: argparse.Namespace) -> int:
    """Write a page with figures from a result and its bags."""
    from pendubot_identification.report.page import write_report  # imports matplotlib

    result = read_complete_result(args.result)
    beside = None
    if args.reference is not None:
        beside = read_result(args.reference), 'reference'
        for problem in beside[0].unphysical():
            print(f'pendubot: {args.reference}: {problem}', file=sys.stderr)
    path = args.output or args.result.with_name(f'{args.result.stem}_report')
    refuse_input(path / 'result.yaml', [args.reference])
    motions, notes = None, []
    with OutputFolder(path, overwrite=args.force) as folder:
        try:
            motions = recordings(result, args.bags)
        except PendubotError as error:
            notes = [f'figures of the recordings; {error}']
            print(f'pendubot: left out {notes[0]}', file=sys.stderr)
        with progress_bar() as bar:
            page = write_report(
                folder, result, motions, beside=beside, notes=notes, progress=bar, bags=args.bags, static=args.figures
            )
    print(f'written to {page}')
    return 0


def run_compare(args: argparse.Namespace) -> int:
    """Print a comparison of results, and of their predictions of a motion."""
    repeated = [path for path in args.results if args.results.count(path) > 1]
    if repeated or len(args.results) < 2:
        problem = f'{repeated[0]} is named twice' if repeated else f'{args.results[0]} is the only result'
        raise UsageError(f'{problem}; name two or more different results')
    with wrong_usage():
        conversion = conversion_of(args)
        windows = [] if args.on is None else windows_of([args.on], conversion)
    results = {str(path): read_result(path) for path in args.results}
    compared = compare(results, *(read_trajectory(window, conversion) for window in windows))
    print(json.dumps(compared, indent=2) if args.json else comparison(compared))
    return 0


def run_export(args: argparse.Namespace) -> int:
    """Write a result for simulators, MATLAB, firmware, a node or another program."""
    result = read_result(args.result)
    name = args.format or (SUFFIXES.get(args.output.suffix) if args.output is not None else None)
    if name is None:
        problem = 'no format was given' if args.output is None else f'{args.output} has no suffix that names a format'
        raise UsageError(f'{problem}; add --format with one of {", ".join(FORMATS)}, or end on {", ".join(SUFFIXES)}')
    users = {'link_length': ROBOTS, 'torque_limit': ROBOTS, 'revolute': ('urdf',)}
    for option, formats in users.items():
        if getattr(args, option) not in (None, False) and name not in formats:
            raise UsageError(f'{flag(option)} belongs to {", ".join(formats)}, and {name} ignores it; leave it out')
    with wrong_usage():
        require_limit(args.torque_limit)
    if args.output is not None:
        refuse_input(args.output, [args.result])
    if problems := result.unphysical():
        # Parameters by hand get the same warnings as identified parameters.
        result = replace(result, level=Level.ERROR, warnings=list(dict.fromkeys([*result.warnings, *problems])))
    text, remarks = export(result, name, args.link_length, args.torque_limit, revolute=args.revolute)
    print_level(result)
    for remark in remarks:
        print(remark, file=sys.stderr)
    if args.output is None:
        print(text, end='')
    else:
        write_atomically(args.output, text, overwrite=args.force)
        print(f'written to {args.output}')
    return 0
