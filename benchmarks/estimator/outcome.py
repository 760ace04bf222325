# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""One identification, as numbers and words for a table. All that depends on the result's structure is here."""

import time

import numpy as np

from pendubot_identification.errors import PendubotError
from pendubot_identification.identify.catalogue import compensated
from pendubot_identification.identify.pipeline import identify
from pendubot_identification.identify.prediction import predict, state_scale
from pendubot_identification.identify.settings import Settings
from pendubot_identification.model.parameters import NAMES
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.signals import choose_smoothing
from pendubot_identification.trajectories.trajectory import Trajectory

PHYSICAL, FRICTION = NAMES[:5], ('b1', 'b2', 'Fc1', 'Fc2')
HORIZONS = 3  # of the predictions: .1, .25 and .5 s


def named(found):
    """Return (name, where, whether it is compensated) of every effect or fault that a result names."""
    result = [(fault.name, '', False) for fault in found.faults]
    return result + [(e.name, str(e.where), bool(e.accepted)) for e in found.effects]


def trajectories(recordings):
    """Return simulated recordings as the estimator takes them."""
    return [Trajectory(r.t, r.q, np.column_stack([r.tau, 0 * r.tau]), name=str(k)) for k, r in enumerate(recordings)]


def outcome(training, *, truth=None, scored=(), bare=False, **key):
    """Identify and return what tables need: of a refusal its message alone.

    ``truth``: the true parameters by name. ``scored``: recordings to predict. ``bare``: identify once more without
    compensation, for its error. ``key``: what distinguishes it from others.
    """
    begin = time.perf_counter()
    try:
        found = identify(training)
    except PendubotError as error:
        return key | {'level': 'refused', 'warnings': [str(error)], 'named': [], 'seconds': time.perf_counter() - begin}
    seconds = time.perf_counter() - begin
    best = found.best
    result = key | {
        'level': found.level.name,
        'named': named(found),
        'warnings': list(found.warnings),
        'seconds': seconds,
        'theta': best.theta.tolist(),
        'half_width': (best.intervals[:, 1] - best.theta).tolist(),
    }
    if truth:
        result |= {'error': errors(best.theta, truth), 'held': held(best.intervals, truth)}
        if bare:
            plain = identify(training, (), Settings(compensate=False))
            result['error_without_compensation'] = errors(plain.best.theta, truth)
    if scored:
        result |= scores(found, scored)
    return result


def errors(theta, truth):
    """Return by name the relative errors of parameters."""
    return {name: float(value / truth[name] - 1) for name, value in zip(NAMES, theta, strict=False) if name in truth}


def held(intervals, truth):
    """Return by name whether the intervals hold the truth."""
    rows = zip(NAMES, intervals.tolist(), strict=False)
    return {name: low <= truth[name] <= high for name, (low, high) in rows if name in truth}


def scores(found, recordings):
    """Return the RMS errors of open-loop simulation over the standard deviations of the recordings' states.

    ``prediction`` is of the parameters alone, ``prediction_with_effects`` also of what the result compensates.
    """
    best, smoothing = found.best, choose_smoothing(recordings)
    motions = [Motion.prepare(recording, smoothing, best.effort.hold) for recording in recordings]
    scale, delay = state_scale(motions), best.effort.delay
    rest = [compensated(motion, found.effects, delay) for motion in motions]
    made = {'prediction': motions, 'prediction_with_effects': rest}
    return {name: mean_error([predict([m], best.theta, delay, scale) for m in each]) for name, each in made.items()}


def mean_error(predictions):
    """Return the RMS over recordings of the errors at every horizon."""
    return np.sqrt(np.mean([p.error[:HORIZONS] ** 2 for p in predictions], axis=0)).tolist()
