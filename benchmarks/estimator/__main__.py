# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Measure the estimator, and print Markdown tables.

    python -m benchmarks.estimator real [--test]            shared recordings: each left out, and every split in halves
    python -m benchmarks.estimator clean [--seeds 20]       rigs without effects, of three sizes
    python -m benchmarks.estimator effects [--seeds 20]     rigs with the effects of the catalogue
    python -m benchmarks.estimator unknown [--seeds 20]     rigs with other imperfections
    python -m benchmarks.estimator pushes [--seeds 20]      unmodelled friction and pushes by hand

Errors are open-loop simulation errors over the standard deviations of the scored recordings' states (geometric mean
over the fits; "with effects": with the torques that the result compensates). dP: |P_a - P_b| / mean of P1 to P5
between two disjoint halves. Inside: how many of these differences are within the root of both 95 % half-widths
squared. An effect that is compensated has a star.
"""

import os
import sys

if sys.argv[:1] != ['-c'] and sys.argv[1:2] != ['time']:  # each process works alone
    os.environ['OMP_NUM_THREADS'] = os.environ['OPENBLAS_NUM_THREADS'] = os.environ['PENDUBOT_THREADS'] = '1'

import argparse
import json
from pathlib import Path

from test.simulated_rig import CATALOGUE, SIZES, UNKNOWN

from . import measurements
from .tables import TABLES, markdown


def arguments():
    """Return what the user asks for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('what', choices=TABLES)
    parser.add_argument('--json', type=Path, help='where to write all outcomes')
    parser.add_argument('--seeds', type=int, default=20)
    parser.add_argument('--only', nargs='+', help='rigs, sizes, effects or cases')
    parser.add_argument('--strengths', nargs='+', default=measurements.STRENGTHS, choices=measurements.STRENGTHS)
    parser.add_argument('--rates', nargs='+', type=int, default=measurements.RATES, help='of clean rigs [Hz]')
    parser.add_argument('--counts', nargs='+', type=int, default=measurements.COUNTS, help='of clean rigs, a turn')
    parser.add_argument('--recordings', nargs='+', type=int, default=(1, 2, 3), choices=(1, 2, 3), help='of clean rigs')
    parser.add_argument('--test', action='store_true', help='of real: fit all train recordings, score the test ones')
    parser.add_argument('--processes', type=int, default=1)
    return parser.parse_args()


def jobs(args):
    """Return the jobs of a command."""
    catalogue = {'effects': CATALOGUE, 'unknown': UNKNOWN}
    if args.what == 'real':
        return measurements.real(args.only or measurements.RIGS, args.test)
    if args.what == 'clean':
        return measurements.clean(args.seeds, args.only or SIZES, args.rates, args.counts, args.recordings)
    if args.what == 'pushes':
        return measurements.pushed(args.seeds)
    return measurements.imperfect(args.only or catalogue[args.what], args.seeds, args.strengths)


def main():
    """Measure, keep every outcome as soon as it is known, and print the table."""
    args = arguments()
    found = []
    for result in measurements.each(jobs(args), args.processes):
        found.append(result)
        key = [value for value in result.values() if isinstance(value, str | int)][:6]
        print(len(found), *key, f'{result["seconds"]:.1f} s', file=sys.stderr, flush=True)
        if args.json:
            args.json.write_text(json.dumps({'what': args.what, 'outcomes': found}))
    print(markdown(args.what, found))


if __name__ == '__main__':
    main()
