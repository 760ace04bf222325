# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Measures the speeds of docs/benchmarks.md: ``make benchmark``, or ``python -m benchmarks.speed NAME ...`` for parts.

Each measurement is interleaved with its peers in the same run. The tables show medians of at least five runs, and
ratios, which are valid on other machines, too.
"""

import argparse
import os

os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')  # before numpy, as the command does
os.environ.pop('PYTHONDONTWRITEBYTECODE', None)  # installed modules are compiled, too

from benchmarks.speed import bags, measure, optimisers
from pendubot_identification import kernel

PARTS = {'optimisers': optimisers.full_budget, 'hour': bags.hour}


def main():
    """Print tables."""
    parser = argparse.ArgumentParser(prog='python -m benchmarks.speed', description=__doc__.split('\n\n')[0])
    parser.add_argument('parts', nargs='*', default='all', choices=['all', *PARTS])
    parser.add_argument('--cpu', action='store_true', help='measure processor time, on a machine that others use too')
    args = parser.parse_args()
    if kernel.library() is None:
        parser.error(f'there is no compiled kernel to compare with ({kernel.description()})')
    measure.clock = measure.cpu if args.cpu else measure.wall
    print(measure.machine() + (', processor time' if args.cpu else ''), flush=True)
    for name in PARTS:
        if name in args.parts or 'all' in args.parts:
            PARTS[name]()


if __name__ == '__main__':
    main()
