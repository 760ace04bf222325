# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Measures the speeds of docs/benchmarks.md: ``make benchmark``, or ``python -m benchmarks.speed NAME ...`` for parts.

Everything is interleaved with its peers in the same run, and shown as medians of at least five and as ratios: they are
what carries over to another machine.
"""

import argparse
import os
import re
from pathlib import Path

os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')  # before numpy, as the command does
os.environ.pop('PYTHONDONTWRITEBYTECODE', None)  # what is installed has been compiled

from benchmarks.speed import bags, commands, measure, optimisers
from pendubot_identification import kernel
from test.conftest import ROOT

PAGE = ROOT / 'docs' / 'benchmarks.md'
PARTS = {'optimisers': optimisers.full_budget, 'hour': bags.hour, 'commands': commands.latency}


def main():
    """Print tables, and with --write put them into the page."""
    parser = argparse.ArgumentParser(prog='python -m benchmarks.speed', description=__doc__.split('\n\n')[0])
    parser.add_argument('parts', nargs='*', metavar='NAME', help=f'of {", ".join(PARTS)} (default: all)')
    parser.add_argument('--write', action='store_true', help='put the tables into docs/benchmarks.md')
    parser.add_argument('--cpu', action='store_true', help='measure processor time, on a machine that others use too')
    args = parser.parse_args()
    if unknown := set(args.parts) - set(PARTS):
        parser.error(f'there is no {", ".join(unknown)}; choose of {", ".join(PARTS)}')
    if kernel.library() is None:
        parser.error(f'here it is {kernel.description()}; there is nothing to compare')
    measure.clock = measure.cpu if args.cpu else measure.wall
    where = measure.machine() + (', processor time' if args.cpu else '')
    print(where, flush=True)
    tables = {'machine': where}
    for name in args.parts or PARTS:
        tables[name] = PARTS[name]()
        print(f'\n{name}\n\n{tables[name]}', flush=True)
    if args.write:
        write(PAGE, tables)


def write(page: Path, tables):
    """Put each table between the comments of its name."""
    text = page.read_text(encoding='utf-8')
    for name, table in tables.items():
        marked = re.compile(rf'(<!-- {name} -->\n).*?(<!-- end -->)', re.DOTALL)
        text = marked.sub(lambda found, table=table: f'{found[1]}{table}\n{found[2]}', text)
    page.write_text(text, encoding='utf-8')


if __name__ == '__main__':
    main()
