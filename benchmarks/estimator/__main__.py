# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Measure the estimator, and print Markdown tables.

    python -m benchmarks.estimator real [--test]           shared recordings: each left out, and every split in halves
    python -m benchmarks.estimator single                  each shared recording alone, against the rig's others
    python -m benchmarks.estimator clean [--seeds 2]       rigs without effects, of three sizes
    python -m benchmarks.estimator effects [--seeds 2]     rigs with the effects of the catalogue
    python -m benchmarks.estimator unknown [--seeds 2]     rigs with other imperfections
    python -m benchmarks.estimator pushes [--seeds 2]      unmodelled friction and pushes by hand

Errors are open-loop simulation errors over the standard deviations of the scored recordings' states (geometric mean
over the fits). dP: |P_a - P_b| / mean of P1 to P5 between two disjoint halves. Inside: the number of these differences
within the root sum of squares of both 95 % half-widths. Effects: the compensated effects of the result.
"""

import os

# Before numpy is imported: each process uses one thread.
os.environ['OMP_NUM_THREADS'] = os.environ['OPENBLAS_NUM_THREADS'] = os.environ['PENDUBOT_THREADS'] = '1'

import argparse
import sys
from concurrent.futures import ProcessPoolExecutor

from test.simulated_rig import CATALOGUE, UNKNOWN

from . import measurements
from .tables import TABLES, markdown


def main():
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('table', choices=TABLES)
    parser.add_argument('--seeds', type=int, default=1)
    parser.add_argument('--strengths', nargs='+', default=measurements.STRENGTHS, choices=measurements.STRENGTHS)
    parser.add_argument('--test', action='store_true', help='of real: fit all train recordings, score the test ones')
    parser.add_argument('--processes', type=int, default=1)
    args = parser.parse_args()
    jobs = {
        'real': lambda: measurements.real(args.test),
        'single': measurements.single,
        'clean': lambda: measurements.clean(args.seeds),
        'effects': lambda: measurements.imperfect(CATALOGUE, args.seeds, args.strengths),
        'unknown': lambda: measurements.imperfect(UNKNOWN, args.seeds, args.strengths),
        'pushes': lambda: measurements.pushed(args.seeds),
    }
    outcomes = []
    with ProcessPoolExecutor(args.processes) as pool:
        for result in pool.map(measurements.call, jobs[args.table]()):
            outcomes.append(result)
            print(len(outcomes), *[value for value in result.values() if isinstance(value, str | int)], file=sys.stderr)
    print(markdown(args.table, outcomes))


if __name__ == '__main__':
    main()
