# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot help``: the same as ``--help``, where one types it first."""

from __future__ import annotations

import argparse
from typing import Any

from pendubot_identification.errors import UsageError


def add_parser(subparsers: Any) -> None:
    """Add this subcommand."""
    text = 'say how pendubot, or one of its subcommands, is used'
    parser = subparsers.add_parser('help', help=text, description=f'{text[0].upper()}{text[1:]}.')
    parser.add_argument('command', nargs='?', metavar='SUBCOMMAND', help='such as identify')
    parser.set_defaults(run=run, subparsers=subparsers)


def run(args: argparse.Namespace) -> int:
    """Print it.

    Raises:
        UsageError: there is no such subcommand.
    """
    known = args.subparsers.choices
    if args.command is not None and args.command not in known:
        raise UsageError(f'there is no subcommand {args.command!r}; those that there are: {", ".join(known)}')
    (known[args.command] if args.command else args.top).print_help()
    return 0
