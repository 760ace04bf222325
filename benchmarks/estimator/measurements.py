# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The fits for each table: generators of their outcomes."""

from itertools import combinations, product

import numpy as np

from pendubot_identification.criteria.prediction_error import predict, state_scale
from pendubot_identification.errors import PendubotError
from pendubot_identification.identification.pipeline import identify
from pendubot_identification.identification.settings import Settings
from pendubot_identification.model.parameters import NAMES
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.signals import choose_smoothing
from pendubot_identification.trajectories.trajectory import Trajectory
from test.real import RIGS, recorded
from test.simulated_rig import CATALOGUE, SIZES, UNKNOWN, Rig, record, true

RECORDINGS = 3
STRENGTHS = ('weak', 'medium', 'strong')
HORIZONS = 3  # number of the first prediction horizons: .1, .25 and .5 s
#: Unmodelled friction under pushes by hand.
RUBBING = {
    'stribeck': Rig(stribeck=1.0, pushes=2),
    'rub': Rig(rub=0.5, pushes=2),
    'stribeck and rub': Rig(stribeck=1.0, rub=0.5, pushes=4),
}


def fit(training, *, truth=None, scored=(), bare=False, **key):
    """Identify and return the outcome for the tables; a refused identification has only its level.

    ``truth``: the true parameters by name. ``scored``: recordings to predict. ``bare``: identify again without
    compensation, for its error. ``key``: entries that identify the outcome.
    """
    try:
        found = identify(training, scored)
    except PendubotError:
        return key | {'level': 'refused', 'effects': []}
    best, accepted = found.best, [effect.name for effect in found.effects if effect.accepted]
    width = best.intervals[:, 1] - best.theta
    result = key | {'level': found.level.name, 'effects': accepted, 'theta': best.theta, 'half_width': width}
    if truth:
        result['error'] = errors(best.theta, truth)
        rows = zip(NAMES, best.intervals, strict=False)
        result['held'] = {name: low <= truth[name] <= high for name, (low, high) in rows if name in truth}
        if bare:
            result['bare'] = errors(identify(training, (), Settings(compensate=False)).best.theta, truth)
    if scored:
        motions = [Motion.prepare(each, choose_smoothing(scored), best.effort.hold) for each in scored]
        given = best.theta, best.effort.delay, state_scale(motions)
        zeros = best.zeros.angles.T[len(training) :]
        predicted = [predict([m], *given, zero) for m, zero in zip(motions, zeros, strict=True)]
        result['prediction'] = np.sqrt(np.mean([p.error[:HORIZONS] ** 2 for p in predicted], axis=0))
    return result


def errors(theta, truth):
    """Return the largest relative error of P1 to P5 [%]."""
    return max(100 * abs(value / truth[name] - 1) for name, value in zip(NAMES[:5], theta, strict=False))


def real(test=False):
    """Yield the outcomes of shared recordings: each left out, every split in halves; or train against test alone."""
    for rig in RIGS:
        train = recorded(rig, 'train')
        if test:
            other = recorded(rig, 'test')
            yield fit(train, scored=other, group=rig, kind='test', pair=0)
            yield fit(other, scored=train, group=rig, kind='test', pair=0)
            continue
        for k, motion in enumerate(train):
            yield fit(train[:k] + train[k + 1 :], scored=[motion], group=rig, kind='left out', pair=None)
        # Each split once; with an odd number, training on the smaller part.
        halves = list(combinations(range(len(train)), len(train) // 2))
        for pair, half in enumerate(halves if len(train) % 2 else halves[: len(halves) // 2]):
            yield from both(train, half, group=rig, kind='halves', pair=pair)


def single():
    """Yield the outcomes of single recordings, with the estimate from all others of the rig as the truth."""
    for rig in RIGS:
        train = recorded(rig, 'train')
        for k, motion in enumerate(train):
            others = identify(train[:k] + train[k + 1 :]).best.theta
            yield fit([motion], truth=dict(zip(NAMES[:5], others, strict=False)), rig=rig)


def both(recordings, half, **key):
    """Yield the outcomes of each half, scored on the other."""
    one = [recordings[k] for k in half]
    other = [recordings[k] for k in range(len(recordings)) if k not in half]
    yield fit(one, scored=other, **key)
    yield fit(other, scored=one, **key)


def simulated(rigs, seeds, number=RECORDINGS, **how):
    """Yield name, seed and motions of each of the rigs by name: ``number`` recordings of 10 s."""
    lanes = [(name, seed, k) for name in rigs for seed in range(seeds) for k in range(number)]
    begin = np.array([10.0 * k for *_, k in lanes])
    runs = record([100 * seed + k for _, seed, k in lanes], [rigs[name] for name, *_ in lanes], begin=begin, **how)
    for n in range(0, len(lanes), number):
        motions = [Trajectory(r.t, r.q, np.column_stack([r.tau, 0 * r.tau])) for r in runs[n : n + number]]
        yield *lanes[n][:2], motions


def clean(seeds):
    """Yield the outcomes of rigs without effects: by size, rate, counts a turn and number of recordings of 10 s."""
    for rate, count in product((33, 200, 1000), (500, 4096)):
        for size, seed, motions in simulated(SIZES, seeds, rate=rate, counts=count):
            for number in (1, 3):
                key = {'size': size, 'rate': rate, 'counts': count, 'number': number, 'seed': seed}
                yield fit(motions[:number], truth=true(SIZES[size]), **key)


def imperfect(effects, seeds, strengths):
    """Yield the outcomes of rigs with each effect: three recordings of 10 s at 200 Hz and 4096 counts a turn."""
    known = CATALOGUE | UNKNOWN
    rigs = {(name, how): known[name][STRENGTHS.index(how)] for name in effects for how in strengths}
    for (name, how), seed, motions in simulated(rigs, seeds):
        truth = true(rigs[name, how])
        yield fit(motions, truth=truth, bare=name in CATALOGUE, effect=name, strength=how, seed=seed)


def pushed(seeds):
    """Yield the outcomes of rigs with unmodelled friction and pushes: the halves of six recordings."""
    for name, seed, motions in simulated(RUBBING, seeds, 2 * RECORDINGS):
        yield from both(motions, range(RECORDINGS), group=name, kind='halves', pair=seed)
