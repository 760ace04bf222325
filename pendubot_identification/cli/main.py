# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot``: parses the command line, runs the subcommand's module, and explains failures in one line."""

import argparse
import importlib
import io
import os
import signal
import sys
import traceback
from collections.abc import Sequence

from pendubot_identification import kernel
from pendubot_identification.errors import PendubotError, UsageError, sentence

from .arguments import parser

#: Modules of the subcommands whose module has another name; each has a function run_SUBCOMMAND.
MODULES = dict.fromkeys(('import', 'simulate', 'repair'), '.bags')
MODULES |= dict.fromkeys(('report', 'compare', 'export'), '.results')
MODULES |= dict.fromkeys(('completion', 'help', 'studio'), '.main')
MODULES |= {'reproduce': 'pendubot_identification.paper.reproduction'}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit status."""
    for stream in (sys.stdout, sys.stderr):
        # A terminal or pipe without a character such as ± must not abort after minutes of computation.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors='backslashreplace')
    top = parser()
    if '_ARGCOMPLETE' in os.environ:  # the shell asks what can follow
        import argcomplete

        argcomplete.autocomplete(top)
    args, unknown = top.parse_known_args(argv)
    if unknown:
        args.parser.error(f'unrecognized arguments: {" ".join(unknown)}')
    if args.debug:
        print(f'pendubot: {kernel.description()}', file=sys.stderr)
    try:
        module = importlib.import_module(MODULES.get(args.subcommand, f'.{args.subcommand}'), __package__)
        if signal.getsignal(signal.SIGINT) == signal.SIG_DFL:  # set by programs.py during the imports
            signal.signal(signal.SIGINT, signal.default_int_handler)
        return int(getattr(module, f'run_{args.subcommand}')(args))
    except KeyboardInterrupt:
        print('pendubot: interrupted', file=sys.stderr)
        return 1
    except BrokenPipeError:
        raise  # the reader of the output closed the pipe, which is no failure
    except Exception as error:
        if args.debug:
            traceback.print_exc()
        print(f'pendubot: {sentence(error)}', file=sys.stderr)
        return 2 if isinstance(error, UsageError) else 1


def run_help(args: argparse.Namespace) -> int:
    """Print the help of a subcommand, or of the program."""
    try:
        parser().parse_args([*filter(None, [args.command]), '--help'])
    except SystemExit as ended:
        return int(ended.code or 0)
    return 0


def run_completion(args: argparse.Namespace) -> int:
    """Print a shell script that asks this program for completions."""
    try:
        import argcomplete
    except ImportError as error:
        raise PendubotError('completion needs argcomplete, which is not installed: pip install argcomplete') from error
    print(argcomplete.shellcode(['pendubot'], shell=args.shell))
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


if __name__ == '__main__':
    raise SystemExit(main())
