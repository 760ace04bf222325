# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The subcommands that need an optional package: completion and studio."""

import argparse
import re

from pendubot_identification.errors import PendubotError
from pendubot_identification.identification.options import CRITERION

from .arguments import parser


def run_completion(args: argparse.Namespace) -> int:
    """Print a shell script for the completion of subcommands, options and file names."""
    try:
        import shtab
    except ImportError as error:
        raise PendubotError('completion needs shtab, which is not installed: pip install shtab') from error
    top = parser()
    subparsers = next(a for a in top._actions if isinstance(a, argparse._SubParsersAction))
    choices = {'criterion': CRITERION.choices, 'command': [*subparsers.choices]}
    for action in (action for each in subparsers.choices.values() for action in each._actions):
        if re.search('BAG|FILE|DIR|FOLDER|yaml', str(action.metavar)):
            action.complete = shtab.FILE
        action.choices = choices.get(action.dest, action.choices)
    print(shtab.complete(top, args.shell))
    return 0


def run_studio(args: argparse.Namespace) -> int:
    """Serve the studio to a browser until a signal."""
    try:
        from pendubot_identification.studio.server import serve
    except ImportError as error:
        raise PendubotError(
            f'{error.name} cannot be imported, and the studio needs aiohttp: pip install aiohttp'
        ) from error
    serve(args.files, args.port, browser=not args.no_browser, debug=args.debug)
    return 0
