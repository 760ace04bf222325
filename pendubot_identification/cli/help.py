# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot help``: the same as ``--help``, where one types it first."""

from __future__ import annotations

import argparse
from typing import Any


def add_parser(subparsers: Any) -> None:
    """Add this subcommand."""
    text = 'say how pendubot, or one of its subcommands, is used'
    parser = subparsers.add_parser('help', help=text, description=f'{text[0].upper()}{text[1:]}.')
    parser.add_argument('command', nargs='?', metavar='SUBCOMMAND', help='such as identify')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print it."""
    args.top.parse_args([args.command, '--help'] if args.command else ['--help'])
    return 0
