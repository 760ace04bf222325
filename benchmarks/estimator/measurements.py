# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What is identified for each table: generators of outcomes, one after the other."""

from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import combinations

import numpy as np

from test.real import RIGS, recorded
from test.simulated_rig import CATALOGUE, SIZES, UNKNOWN, Rig, record, true

from .outcome import outcome, trajectories

RATES, COUNTS, RECORDINGS = (33, 100, 500, 1000, 5000), (500, 4096, 10000), 3
STRENGTHS = ('weak', 'medium', 'strong')
#: Unmodelled friction under pushes by hand.
RUBBING = {
    'stribeck': Rig(stribeck=1.0, pushes=2),
    'rub': Rig(rub=0.5, pushes=2),
    'stribeck and rub': Rig(stribeck=1.0, rub=0.5, pushes=4),
}


def each(jobs, processes):
    """Yield the outcomes of jobs, in several processes if more than one is asked for."""
    if processes == 1:
        yield from (job() for job in jobs)
        return
    with ProcessPoolExecutor(processes) as pool:
        yield from pool.map(_call, jobs)


def _call(job):
    return job()


def real(only=RIGS, test=False):
    """Yield the jobs of shared recordings: every one left out, every split in halves; or train against test alone."""
    for rig in only:
        train = recorded(rig, 'train')
        if test:
            other = recorded(rig, 'test')
            yield partial(outcome, train, scored=other, group=rig, kind='test', pair=0)
            yield partial(outcome, other, scored=train, group=rig, kind='test', pair=0)
            continue
        for k, motion in enumerate(train):
            rest = train[:k] + train[k + 1 :]
            yield partial(outcome, rest, scored=[motion], group=rig, kind='left out', pair=None, fitted=motion.name)
        for pair, half in enumerate(halves(len(train))):
            yield from both(train, half, group=rig, kind='halves', pair=pair)


def halves(count):
    """Return every half of so many recordings, each split once; of an odd number the smaller part."""
    found = list(combinations(range(count), count // 2))
    return found if count % 2 else found[: len(found) // 2]


def both(recordings, half, **key):
    """Yield the jobs of one half, scored on the other, and the reverse."""
    one = [recordings[k] for k in half]
    other = [recordings[k] for k in range(len(recordings)) if k not in half]
    yield partial(outcome, one, scored=other, **key)
    yield partial(outcome, other, scored=one, **key)


def clean(seeds, sizes=tuple(SIZES), rates=RATES, counts=COUNTS, numbers=(1, 2, 3)):
    """Yield the jobs of rigs without effects: by size, rate, counts a turn and number of recordings of 10 s."""
    for size in sizes:
        rig = SIZES[size]
        for rate in rates:
            lanes = [(c, seed, k) for c in counts for seed in range(seeds) for k in range(RECORDINGS)]
            made = record(
                [100 * seed + k for _, seed, k in lanes],
                [rig] * len(lanes),
                rate=rate,
                counts=np.array([c for c, *_ in lanes]),
            )
            for n in range(0, len(lanes), RECORDINGS):
                motions = trajectories(made[n : n + RECORDINGS])
                for number in numbers:
                    key = {'size': size, 'rate': rate, 'counts': lanes[n][0], 'number': number, 'seed': lanes[n][1]}
                    yield partial(outcome, motions[:number], truth=true(rig), **key)


def imperfect(effects, seeds, strengths=STRENGTHS):
    """Yield the jobs of rigs with each effect: three recordings of 10 s at 200 Hz and 4096 counts a turn."""
    cells = [(name, strength) for name in effects for strength in strengths]
    rigs = {cell: (CATALOGUE | UNKNOWN)[cell[0]][STRENGTHS.index(cell[1])] for cell in cells}
    lanes = [(cell, seed, k) for cell in cells for seed in range(seeds) for k in range(RECORDINGS)]
    made = record(
        [100 * seed + k for _, seed, k in lanes],
        [rigs[cell] for cell, *_ in lanes],
        begin=np.array([10.0 * k for *_, k in lanes]),
    )
    for n in range(0, len(lanes), RECORDINGS):
        cell, seed, _ = lanes[n]
        key = {'effect': cell[0], 'strength': cell[1], 'seed': seed}
        yield partial(outcome, trajectories(made[n : n + RECORDINGS]), truth=true(rigs[cell]), bare=True, **key)


def pushed(seeds):
    """Yield the jobs of rigs with unmodelled friction and pushes: the halves of six recordings."""
    lanes = [(name, seed, k) for name in RUBBING for seed in range(seeds) for k in range(2 * RECORDINGS)]
    made = record([100 * seed + k for _, seed, k in lanes], [RUBBING[name] for name, *_ in lanes])
    for n in range(0, len(lanes), 2 * RECORDINGS):
        name, seed, _ = lanes[n]
        key = {'group': name, 'kind': 'halves', 'pair': seed, 'truth': true(RUBBING[name])}
        yield from both(trajectories(made[n : n + 2 * RECORDINGS]), range(RECORDINGS), **key)
