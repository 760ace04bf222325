# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot export``: a result for simulators, MATLAB, firmware, a node or another program."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from pendubot_identification.errors import UsageError, wrong_usage

#: Those of formats/export.py, again: importing it takes time, which no --help is worth.
FORMATS = ('mjcf', 'urdf', 'yaml', 'm', 'h', 'py')
#: What two of them were called earlier.
EARLIER = {'matlab': 'm', 'c': 'h'}

DESCRIPTION = """\
Write the published parameters of a result, every digit of them, in another format:
  mjcf    the rig for MuJoCo
  urdf    the rig for RViz, Gazebo, Pinocchio, Drake, MATLAB ...; fix its base_link to the world
  yaml    parameters P1, P2, ... for --params-file of a controller node, whatever its name
  m       a MATLAB or Octave script that makes a struct: pendubot.P1, ..., pendubot.theta, pendubot.std_error, and the
          model: pendubot.mass_matrix(q), bias(q, v), friction(v, tau), acceleration(q, v, tau), derivative(x, tau)
  h       a C header: PENDUBOT_P1, ..., PENDUBOT_THETA, and the model: pendubot_acceleration(q, v, tau, a) ...
  py      a Python module that needs no other: P1, ..., THETA, and the model: acceleration(q, v, tau) ...
Units, meanings, level, warnings and what the numbers were made of stand in comments.

Simulators want masses, and the motion determines P1 to P5 alone: of all rigs that move alike one is written, and what
was chosen is said. Parameters that no real masses give are refused.
"""
EPILOG = """\
examples:
  pendubot export result.yaml --output pendubot.xml              the suffix says which format; .xml is mjcf
  pendubot export result.yaml --output pendubot.urdf --torque-limit 0.5
  pendubot export result.yaml --format h > pendubot.h
"""


def add_parser(subparsers: Any) -> None:
    """Add this subcommand."""
    parser = subparsers.add_parser(
        'export',
        help='write a result for simulators, MATLAB, C, Python or a node',
        description=DESCRIPTION,
        epilog=EPILOG,
    )
    parser.add_argument(
        'result', type=Path, metavar='RESULT.yaml', help='a result of pendubot identify, or parameters by hand'
    )
    parser.add_argument(
        '--format',
        choices=FORMATS,
        type=lambda name: EARLIER.get(name, name),
        help="default: by the output's suffix",
    )
    parser.add_argument('--output', type=Path, metavar='FILE', help='write it here (default: print it)')
    simulators = parser.add_argument_group('for mjcf and urdf')
    simulators.add_argument(
        '--link-length', type=float, metavar='M', help='of link 1, from joint to joint, measured (default: P3 / P5)'
    )
    simulators.add_argument('--torque-limit', type=float, metavar='NM', help="the motor's (default: none)")
    parser.add_argument('--force', action='store_true', help='overwrite an existing file')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Read, convert, write."""
    from pendubot_identification.files import refuse_input, write_atomically
    from pendubot_identification.formats.export import ROBOTS, SUFFIXES, export, require_limit
    from pendubot_identification.level import Level
    from pendubot_identification.results.result_file import read_result

    name = args.format or (SUFFIXES.get(args.output.suffix) if args.output is not None else None)
    if name is None:
        given = 'no format was given' if args.output is None else f'{args.output} has no suffix that names a format'
        raise UsageError(f'{given}; add --format with one of {", ".join(FORMATS)}, or end on {", ".join(SUFFIXES)}')
    for option in ('link_length', 'torque_limit'):
        if getattr(args, option) is not None and name not in ROBOTS:
            raise UsageError(
                f'--{option.replace("_", "-")} is of {", ".join(ROBOTS)}, and {name} does without; leave it out'
            )
    with wrong_usage():
        require_limit(args.torque_limit)
    if args.output is not None:
        refuse_input(args.output, [args.result])
    result = read_result(args.result)
    if problems := result.unphysical():
        # As an identification says it, though a hand may have written these parameters.
        result = replace(result, level=Level.ERROR, warnings=list(dict.fromkeys([*result.warnings, *problems])))
    text, said = export(result, name, args.link_length, args.torque_limit)
    if result.level:
        print(f'level {result.level.name}: {"; ".join(result.warnings)}', file=sys.stderr)
    for sentence in said:
        print(sentence, file=sys.stderr)
    if args.output is None:
        print(text, end='')
        return 0
    write_atomically(args.output, text, overwrite=args.force)
    print(f'written to {args.output}')
    return 0
