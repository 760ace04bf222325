# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Measure the estimator, and print a Markdown table.

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

os.environ['OPENBLAS_NUM_THREADS'] = '1'  # before numpy: the matrices are small

import argparse
import sys

from benchmarks.markdown import table
from test.simulated_rig import CATALOGUE, UNKNOWN

from . import measurements
from .tables import compared, scored


def main():
    """Measure, and print the table."""
    tables = {
        'real': (scored, lambda: measurements.real(args.test)),
        'single': (compared, measurements.single),
        'clean': (compared, lambda: measurements.clean(args.seeds)),
        'effects': (compared, lambda: measurements.imperfect(CATALOGUE, args.seeds, args.strengths)),
        'unknown': (compared, lambda: measurements.imperfect(UNKNOWN, args.seeds, args.strengths)),
        'pushes': (scored, lambda: measurements.pushed(args.seeds)),
    }
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('table', choices=tables)
    parser.add_argument('--seeds', type=int, default=1)
    parser.add_argument('--strengths', nargs='+', default=measurements.STRENGTHS, choices=measurements.STRENGTHS)
    parser.add_argument('--test', action='store_true', help='of real: fit all train recordings, score the test ones')
    args = parser.parse_args()
    rows, measured = tables[args.table]
    outcomes = []
    for outcome in measured():
        outcomes.append(outcome)
        print(len(outcomes), *[value for value in outcome.values() if isinstance(value, str | int)], file=sys.stderr)
    names, *cells = rows(outcomes)
    table(names, cells)


if __name__ == '__main__':
    main()
