# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot``: identification without ROS, a module a subcommand."""

from __future__ import annotations

import argparse
import io
import sys
import traceback
from collections.abc import Sequence
from typing import Any, NoReturn

from pendubot_identification import __version__, kernel
from pendubot_identification.errors import UsageError, sentence
from pendubot_identification.paper import reproduce
from pendubot_identification.resources import resource

from . import (
    compare,
    completion,
    demo,
    excite,
    export,
    help,
    identify,
    importing,
    info,
    repair,
    report,
    simulate,
    track,
)

DESCRIPTION = """\
Identify the parameters of a pendubot from its recordings, without ROS.

  pendubot identify BAG                  parameters from a bag: first half estimates, second half validates
  pendubot identify RUN.csv              the same from CSV, MATLAB, Excel or Parquet
  pendubot track BAG                     parameters followed through hours, and what changed when
  pendubot report RESULT.yaml            a page with figures from a result
  pendubot excite --design               the excitation that tells most of the parameters
  pendubot reproduce                     the paper's tables and figures, from this package's own runs
  pendubot demo                          the whole chain on a virtual rig (this alone needs ROS)
"""
SUBCOMMANDS = (
    *(identify, track, report, compare, excite, export, importing, simulate, info, repair, reproduce, demo),
    *(completion, help),
)
SAMPLE = 'bags/paper_experiment'
EPILOG = 'exit status: 0 success, 1 a failure explained in one line, 2 wrong usage, 3 identify: a result of level ERROR'


def parser() -> argparse.ArgumentParser:
    """Return the parser of the whole command line."""
    top = _Parser(prog='pendubot', description=DESCRIPTION, epilog=f'sample bag: {resource(SAMPLE)}\n{EPILOG}')
    top.add_argument('--version', action=_Version, nargs=0, help='say which version this is and whether it is compiled')
    subparsers = top.add_subparsers(title='subcommands', metavar='SUBCOMMAND', required=True)
    for subcommand in SUBCOMMANDS:
        subcommand.add_parser(subparsers)
    top.set_defaults(debug=False, top=top)
    for place in dict.fromkeys((top, *subparsers.choices.values())):
        place.set_defaults(parser=place)
        # Also after the subcommand, where it is typed to run again; a default of False there would undo the one before.
        what = 'show the traceback of a failure, and whether it is compiled'
        place.add_argument('--debug', action='store_true', default=argparse.SUPPRESS, help=what)
    return top


class _Parser(argparse.ArgumentParser):
    """Leaves descriptions in the lines in which they are written; so do those of its subcommands."""

    def __init__(self, **how: Any) -> None:
        super().__init__(**{'formatter_class': argparse.RawDescriptionHelpFormatter, **how})

    def error(self, message: str) -> NoReturn:
        """Say in one line what is wrong, and where the usage stands."""
        self.exit(2, f'{self.prog}: error: {message}; {self.prog} --help says what there is\n')


class _Version(argparse.Action):
    """Finds the kernel only when asked."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        print(f'{parser.prog} {__version__}, {kernel.description()}')
        parser.exit()


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit status."""
    for stream in (sys.stdout, sys.stderr):
        # What was computed for minutes is not lost where a terminal or pipe knows no ±.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors='backslashreplace')
    args, unknown = parser().parse_known_args(argv)
    if unknown:
        args.parser.error(f'unrecognized arguments: {" ".join(unknown)}')
    if args.debug:
        print(f'pendubot: {kernel.description()}', file=sys.stderr)
    try:
        return int(args.run(args))
    except KeyboardInterrupt:
        print('pendubot: interrupted', file=sys.stderr)
        return 1
    except BrokenPipeError:
        raise  # whoever read the output has seen enough: no failure, where this runs as a program
    except Exception as error:
        if args.debug:
            traceback.print_exc()
        print(f'pendubot: {sentence(error)}', file=sys.stderr)
        return 2 if isinstance(error, UsageError) else 1


if __name__ == '__main__':
    raise SystemExit(main())
