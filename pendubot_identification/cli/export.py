# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot export``: a result for simulators, MATLAB, firmware, a node or another program."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace

from pendubot_identification.errors import UsageError, wrong_usage
from pendubot_identification.files import refuse_input, write_atomically
from pendubot_identification.formats.export import FORMATS, ROBOTS, SUFFIXES, export, require_limit
from pendubot_identification.level import Level
from pendubot_identification.results.result_file import read_result

from .arguments import flag


def run(args: argparse.Namespace) -> int:
    """Read, convert, write."""
    result = read_result(args.result)
    name = args.format or (SUFFIXES.get(args.output.suffix) if args.output is not None else None)
    if name is None:
        given = 'no format was given' if args.output is None else f'{args.output} has no suffix that names a format'
        raise UsageError(f'{given}; add --format with one of {", ".join(FORMATS)}, or end on {", ".join(SUFFIXES)}')
    for option in ('link_length', 'torque_limit'):
        if getattr(args, option) is not None and name not in ROBOTS:
            raise UsageError(f'{flag(option)} is of {", ".join(ROBOTS)}, and {name} does without; leave it out')
    if args.revolute and name != 'urdf':
        raise UsageError(f'--revolute is of urdf, and {name} does without; leave it out')
    with wrong_usage():
        require_limit(args.torque_limit)
    if args.output is not None:
        refuse_input(args.output, [args.result])
    if problems := result.unphysical():
        # Parameters by hand get the warnings that an identification would give.
        result = replace(result, level=Level.ERROR, warnings=list(dict.fromkeys([*result.warnings, *problems])))
    text, remarks = export(result, name, args.link_length, args.torque_limit, revolute=args.revolute)
    if result.level:
        print(f'level {result.level.name}: {"; ".join(result.warnings)}', file=sys.stderr)
    for remark in remarks:
        print(remark, file=sys.stderr)
    if args.output is None:
        print(text, end='')
    else:
        write_atomically(args.output, text, overwrite=args.force)
        print(f'written to {args.output}')
    return 0
