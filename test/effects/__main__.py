# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What a result is worth on rigs that have what the model lacks.

    python -m test.effects [--seeds 20] [--only EFFECT ...] [--processes 2] [--json FILE]
    python -m test.effects --rates [--seeds 20] [--processes 2] [--json FILE]

Three recordings of 10 s at 200 Hz and 4096 counts a turn for each seed, identified as by default. Prints a Markdown
table with a row for each effect and strength: how many results are OK, WARN, ERROR; what was named; the median and the
largest of the worst error of P1 to P5 [%]; and, of the results at OK, the share of 95 % intervals that hold the truth.
``--rates``: the same of a rig without any effect, for each rate, encoder, and slow or fast motion; all levels count.
"""

import os

os.environ['OMP_NUM_THREADS'] = os.environ['PENDUBOT_THREADS'] = '1'  # every process works alone

import argparse
import json
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

from pendubot_identification.identify.identification import identify
from pendubot_identification.model.parameters import NAMES
from pendubot_identification.trajectories.trajectory import Trajectory

from .rig import EFFECTS, record, true

RECORDINGS = 3
#: Rates [Hz], counts a turn, and the torque's size [N m] and for how long it is held [s].
RATES, COUNTS = (33, 100, 500, 1000, 5000), (500, 4096, 10000)
MOTIONS = {'slow': (0.12, (0.3, 1.0)), 'fast': (0.35, (0.1, 0.5))}
PHYSICAL, FRICTION = NAMES[:5], ('b1', 'b2', 'Fc1', 'Fc2')


def trial(job):
    """Identify recordings of one rig; returns what the table needs."""
    effect, strength, seed, recordings = job
    truth = true(EFFECTS[effect][strength] if effect in EFFECTS else EFFECTS['nothing'][0])
    found = identify(recordings)
    best = found.best
    values = dict(zip(NAMES, best.theta, strict=False))
    errors = dict(zip(NAMES, best.std_error, strict=False))
    intervals = dict(zip(NAMES, best.intervals, strict=False))
    return {
        'job': (effect, strength, seed),
        'level': found.level.name,
        'criterion': best.criterion,
        'model': best.model,
        'named': [
            *(fault.name for fault in found.faults),
            *(each.effect.name for each in (found.unexplained.effects if found.unexplained else ())),
            *(['burst'] if found.unexplained and found.unexplained.bursts else ()),
        ],
        'warnings': list(found.warnings),
        'error': {n: float(values[n] / truth[n] - 1) for n in truth if n in values},
        'held': {n: bool(intervals[n][0] <= truth[n] <= intervals[n][1]) for n in truth if n in values},
        'z': {n: float((values[n] - truth[n]) / errors[n]) for n in truth if n in values},
        'prediction': best.prediction.error.tolist(),
    }


def sampled(seeds):
    """Yield (rate and counts, slow or fast, seed, three recordings of 10 s) of a rig without effects."""
    for rate in RATES:
        for motion, (strength, held) in MOTIONS.items():
            for counts in COUNTS:
                lanes = [100 * seed + k for seed in seeds for k in range(RECORDINGS)]
                rigs = [EFFECTS['nothing'][0]] * len(lanes)
                made = record(lanes, rigs, rate=rate, counts=counts, strength=strength, held=held)
                motions = [
                    Trajectory(r.t, r.q, np.column_stack([r.tau, 0 * r.tau]), name=str(k)) for k, r in enumerate(made)
                ]
                for n, seed in enumerate(seeds):
                    yield f'{rate} Hz, {counts}', motion, seed, motions[n * RECORDINGS : (n + 1) * RECORDINGS]


def recorded(cells, seeds):
    """Return (effect, strength, seed, three recordings of 10 s) for every cell and seed."""
    lanes = [(*cell, seed, k) for cell in cells for seed in seeds for k in range(RECORDINGS)]
    made = record(
        [100 * seed + k for *_, seed, k in lanes],
        [EFFECTS[effect][strength] for effect, strength, *_ in lanes],
        begin=np.array([10.0 * k for *_, k in lanes]),
    )
    motions = [
        Trajectory(r.t, r.q, np.column_stack([r.tau, 0 * r.tau]), name=str(k))
        for r, (*_, k) in zip(made, lanes, strict=True)
    ]
    return [(*lanes[n][:3], motions[n : n + RECORDINGS]) for n in range(0, len(lanes), RECORDINGS)]


def row(effect, strength, results):
    """Return a row of the table."""
    levels = Counter(r['level'] for r in results)
    named = Counter(name for r in results for name in r['named'])
    worst = [100 * max(abs(r['error'][n]) for n in PHYSICAL) for r in results]
    ok = [r for r in results if r['level'] == 'OK' or effect not in EFFECTS]
    shares = []
    for names in (PHYSICAL, FRICTION):
        held = [r['held'][n] for r in ok for n in names if n in r['held']]
        shares.append(f'{100 * np.mean(held):.0f} of {len(held)}' if held else '')
    said = ', '.join(f'{name} {count}' for name, count in named.most_common())
    cells = (
        effect,
        ('weak', 'strong')[strength] if effect in EFFECTS else strength,
        '/'.join(str(levels[level]) for level in ('OK', 'WARN', 'ERROR')),
        said,
        f'{np.median(worst):.2g}',
        f'{max(worst):.2g}',
        *shares,
    )
    return '| ' + ' | '.join(cells) + ' |'


def main():
    """Run the trials and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--seeds', type=int, default=20)
    parser.add_argument('--only', nargs='+', choices=EFFECTS, default=list(EFFECTS))
    parser.add_argument('--processes', type=int, default=2)
    parser.add_argument('--rates', action='store_true', help='of a rig without effects, at several rates and encoders')
    parser.add_argument('--json', type=Path, help='all results, for a closer look')
    args = parser.parse_args()
    cells = [(e, s) for e in args.only for s in ((0, 1) if e != 'nothing' else (0,))]
    jobs = sampled(range(args.seeds)) if args.rates else recorded(cells, range(args.seeds))
    print('| effect | strength | OK/WARN/ERROR | named | worst of P1-P5 [%] | largest | P held [%] | friction |')
    print('|---|---|---|---|---|---|---|---|')
    found = []
    with ProcessPoolExecutor(args.processes) as pool:
        for result in pool.map(trial, jobs):
            found.append(result)
            if len(found) % args.seeds == 0:
                print(row(*result['job'][:2], found[-args.seeds :]), flush=True)
    if args.json:
        args.json.write_text(json.dumps(found))


if __name__ == '__main__':
    main()
