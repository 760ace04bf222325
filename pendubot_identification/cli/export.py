# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot export``: a result for MATLAB, firmware, a node or another program."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from pendubot_identification.errors import UsageError

#: Those of results/export.py, again: importing it takes time, which no --help is worth.
FORMATS = ('yaml', 'json', 'matlab', 'c')

DESCRIPTION = """\
Write the published parameters of a result, every digit of them, in another format:
  yaml    parameters P1, P2, ... for --params-file of a controller node, whatever its name
  json    the whole result
  matlab  a script that makes a struct: pendubot.P1, ..., pendubot.theta, pendubot.std_error
  c       a header: PENDUBOT_P1, ..., PENDUBOT_THETA
Units, meanings, level, warnings and what the numbers were made of stand in comments.
"""
EPILOG = """\
examples:
  pendubot export result.yaml --output pendubot_parameters.m     the suffix says which format: .yaml .json .m .h
  pendubot export result.yaml --format c > pendubot.h
"""


def add_parser(subparsers: Any) -> None:
    """Add this subcommand."""
    parser = subparsers.add_parser(
        'export', help='write a result for MATLAB, C, JSON or a node', description=DESCRIPTION, epilog=EPILOG
    )
    parser.add_argument('result', type=Path, metavar='RESULT.yaml', help='a result of pendubot identify')
    parser.add_argument('--format', choices=FORMATS, help="default: by the output's suffix")
    parser.add_argument('--output', type=Path, metavar='FILE', help='write it here (default: print it)')
    parser.add_argument('--force', action='store_true', help='overwrite an existing file')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Read, convert, write."""
    from pendubot_identification.files import refuse_input, write_whole
    from pendubot_identification.level import Level
    from pendubot_identification.results.export import FORMATS, SUFFIXES
    from pendubot_identification.results.result_file import read_result

    name = args.format or (SUFFIXES.get(args.output.suffix) if args.output is not None else None)
    if name is None:
        given = 'no format was given' if args.output is None else f'{args.output} has no suffix that names a format'
        raise UsageError(f'{given}; add --format with one of {", ".join(FORMATS)}, or end on {", ".join(SUFFIXES)}')
    if args.output is not None:
        refuse_input(args.output, [args.result])
    result = read_result(args.result)
    if problems := result.unphysical():
        # As an identification says it, though a hand may have written these parameters.
        result = replace(result, level=Level.ERROR, warnings=list(dict.fromkeys([*result.warnings, *problems])))
    text = FORMATS[name](result)
    if result.level:
        print(f'level {result.level.name}: {"; ".join(result.warnings)}', file=sys.stderr)
    if args.output is None:
        print(text, end='')
        return 0
    write_whole(args.output, text, overwrite=args.force)
    print(f'written to {args.output}')
    return 0
