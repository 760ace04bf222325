# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot reproduce``: the paper's tables and figures, beside what this package finds."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from pendubot_identification.errors import UsageError

#: What can be asked for, by the experiment that it is made of.
EXPERIMENTS = {
    'competition': ('table4', 'figure1'),
    'identification': ('table7', 'table8', 'dataset', 'fit'),
    'sweep': ('threshold', 'operator'),
    'dimensions': ('dimensions',),
}
PARTS = tuple(part for parts in EXPERIMENTS.values() for part in parts)

DESCRIPTION = """\
Reproduce the paper: its tables and figures from this package's own runs, each number beside the paper's, in one folder
with an index.md to read. It takes less than a minute.

  table4      errors of PSO, DE, HDE and MDE on four functions; where MDE is ahead; times
  figure1     their convergence
  table7      J of ten identifications on the sample bag     table8      the parameters
  dataset     the recording                                  fit         how the parameters explain it
  threshold   the sweep that the paper speaks of without showing it
  operator    its operator drawn per component against per vector
  dimensions  beyond the paper: 2, 10 and 30 dimensions, equal budgets, rank-sum tests

The same seed gives the same files, byte for byte; only times.md and times.csv differ, which hold measured times. An
interrupt keeps what is done.
"""


def add_parser(subparsers: Any) -> None:
    """Add this subcommand."""
    parser = subparsers.add_parser(
        'reproduce',
        help="reproduce the paper's tables and figures",
        description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        '--only', type=_parts, default=PARTS, metavar='NAME[,NAME ...]', help='some of the above (default: all)'
    )
    parser.add_argument(
        '--runs',
        type=int,
        default=10,
        metavar='N',
        help='runs of a table, as in the paper (default %(default)s); how often an algorithm arrives is counted over '
        '10 N, the sweep takes 5 N',
    )
    parser.add_argument('--seed', type=int, default=1, help='of all random numbers (default %(default)s)')
    parser.add_argument(
        '--output', type=Path, default=Path('reproduction'), metavar='DIR', help='a new folder (default %(default)s)'
    )
    parser.add_argument('--force', action='store_true', help='write into an existing folder, over files of these names')
    parser.add_argument('--json', action='store_true', help='print the tables as JSON and nothing else')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run the experiments, write, print."""
    from pendubot_identification.errors import PendubotError
    from pendubot_identification.files import OutputFolder
    from pendubot_identification.paper.reproduction import Reproduction
    from pendubot_identification.paper.trials import MOST_RUNS

    if not 1 <= args.runs <= MOST_RUNS:
        raise UsageError(f'{args.runs} runs were asked for; a number from 1 to {MOST_RUNS} is expected')
    if args.seed < 0:
        raise UsageError(f'the seed is {args.seed}; a whole number of at least 0 is expected')
    folder = OutputFolder(args.output, overwrite=args.force)
    made = Reproduction(folder, args.only, args.seed, args.runs, quiet=args.json)
    done: list[str] = []
    try:
        for experiment, parts in EXPERIMENTS.items():
            if wanted := [part for part in parts if part in args.only]:
                getattr(made, experiment)()
                done += wanted
    except KeyboardInterrupt:
        raise PendubotError(
            f'interrupted; what is done is kept in {args.output}: {", ".join(done) or "raw runs only"}. '
            'For the rest run it again with --only and another --output'
        ) from None
    finally:
        missing = [part for part in args.only if part not in done]
        made.write_index('' if len(args.only) == len(PARTS) else f' --only {",".join(args.only)}', missing)
    if args.json:
        print(json.dumps(made.data(), indent=2))
    else:
        print(f'{", ".join(done)}: read {args.output / "index.md"}')
    return 0


def _parts(text: str) -> tuple[str, ...]:
    names = tuple(dict.fromkeys(name.strip() for name in text.split(',')))
    for name in names:
        if name not in PARTS:
            raise argparse.ArgumentTypeError(f'there is no {name!r}; name some of {", ".join(PARTS)}')
    return names
