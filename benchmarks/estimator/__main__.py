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
over the fits); the zeros of a scored recording are estimated from it, with the parameters of the fit. dP: |P_a - P_b|
/ mean of P1 to P5 between two disjoint halves. Inside: the number of these differences within the root sum of squares
of both 95 % half-widths. Effects: the compensated effects of the result.
"""

import os

os.environ['OPENBLAS_NUM_THREADS'] = '1'  # before numpy: the matrices are small

import argparse
import sys
from collections import Counter
from itertools import pairwise

import numpy as np

from benchmarks.markdown import table
from test.simulated_rig import CATALOGUE, UNKNOWN

from . import measurements

PHYSICAL, FRICTION = ('P1', 'P2', 'P3', 'P4', 'P5'), ('b1', 'b2', 'Fc1', 'Fc2')
LEVELS = ('OK', 'WARN', 'ERROR', 'refused')


def levels(found):
    """Return the number of outcomes of each level."""
    counted = Counter(r['level'] for r in found)
    return '/'.join(str(counted[level]) for level in LEVELS)


def effects(found):
    """Return the compensated effects with their frequencies."""
    return ', '.join(f'{name} {n}' for name, n in Counter(name for r in found for name in r['effects']).most_common())


def held(found, names, level=None):
    """Return the percentage of intervals that contain the truth, for outcomes at a level."""
    inside = [yes for r in found if level in (None, r['level']) for n, yes in r.get('held', {}).items() if n in names]
    return f'{100 * np.mean(inside):.0f} of {len(inside)}' if inside else ''


def largest(found, of='error'):
    """Return the median and the maximum of the largest errors of P1 to P5 [%]."""
    values = [r[of] for r in found if of in r]
    return f'{np.median(values):.2g}, {np.max(values):.2g}' if values else ''


def grouped(found, *by):
    """Return the outcomes by the values of some keys, in order."""
    groups = {}
    for r in found:
        groups.setdefault(tuple(r[name] for name in by), []).append(r)
    return groups


def scored(found):
    """Yield a row for each rig and kind of fit."""
    errors = ('error .1 / .25 / .5 s', 'dP [%]: mean, worst', 'inside', 'half-width [%]')
    yield 'rig', 'fits', 'n', *errors, '/'.join(LEVELS), 'effects'
    for (rig, kind), some in grouped(found, 'group', 'kind').items():
        known = [r for r in some if 'theta' in r]
        theta, width = (np.array([r[of][:5] for r in known]) for of in ('theta', 'half_width'))
        errors = np.exp(np.mean(np.log([r['prediction'] for r in known]), axis=0))
        apart, inside = [], []
        for pair in grouped([r for r in known if r['pair'] is not None], 'pair').values():
            for a, b in pairwise(pair):
                (p, q), (v, w) = (np.array([r[of][:5] for r in (a, b)]) for of in ('theta', 'half_width'))
                apart.append(200 * abs(p - q) / abs(p + q))
                inside.append(abs(p - q) <= np.hypot(v, w))
        yield (
            *(rig, kind, str(len(some)), ' / '.join(f'{e:.4f}' for e in errors)),
            f'{np.mean(apart):.2f}, {np.max(apart):.1f}' if apart else '',
            f'{np.sum(inside)} of {np.size(inside)}' if apart else '',
            *(f'{100 * (width / abs(theta)).mean():.2g}', levels(some), effects(some)),
        )


def compared(found):
    """Yield a row for all outcomes and for each value of each factor: errors, and intervals that contain the truth."""
    intervals = ('P held [%]', 'at OK', 'at WARN', 'friction held [%]', 'at WARN')
    yield '', 'n', 'error of P1 to P5 [%]', 'without compensation', *intervals, '/'.join(LEVELS), 'right', 'effects'
    parts = {'all': found}
    for factors in (('rig',), ('size',), ('rate',), ('counts',), ('number',), ('strength',), ('effect', 'strength')):
        if {*factors} <= {*found[0]}:
            parts |= {
                f'{" ".join(factors)} {" ".join(map(str, key))}': some for key, some in grouped(found, *factors).items()
            }
    for name, some in parts.items():
        right = sum(any(is_right(r['effect'], name) for name in r['effects']) for r in some if 'effect' in r)
        yield (
            *(name, str(len(some)), largest(some), largest(some, 'bare')),
            *(held(some, PHYSICAL, level) for level in (None, 'OK', 'WARN')),
            *(held(some, FRICTION, level) for level in (None, 'WARN')),
            *(levels(some), str(right), effects(some)),
        )


def is_right(effect, name):
    """Return whether a detected effect is the effect of the simulated rig."""
    kind = effect.split(',')[0].lower()
    return name.lower().replace('_', ' ') in (kind, 'friction' if kind in ('stribeck', 'width') else kind)


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
