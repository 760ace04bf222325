# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Compares results: differences of their parameters, and their predictions of one motion."""

import math
from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any

from scipy.special import ndtr, stdtr

from pendubot_identification.criteria.prediction_error import HORIZONS, predict, state_scale
from pendubot_identification.model.parameters import NAMES, UNITS
from pendubot_identification.recordings.bag_reader import BagWindow, RecordedTrajectory
from pendubot_identification.recordings.datasets import span
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.signals import choose_smoothing, evenly_stamped

from .result import Parameter, PartialResult, known

#: A part of a bag: SHA-256, times of the first and last sample [s].
Part = tuple[str, float, float]


def compare(results: Mapping[str, PartialResult], recorded: RecordedTrajectory | None = None) -> dict[str, Any]:
    """Return the parameters of results by name side by side, and their prediction errors on a motion, as plain data."""
    used = {name: _training(result) for name, result in results.items()}
    notes = [f'{name}: {problem}' for name, result in results.items() for problem in result.unphysical()]
    notes += [
        f'{name} and {other} were estimated from the same motion: part of their errors is common, so that differences '
        'are more significant than they seem'
        for name, other in combinations(used, 2)
        if _overlap(used[name], used[other])
    ]
    found = {'results': list(results), 'parameters': _parameters(list(results.values())), 'notes': notes}
    if recorded is None:
        return found
    notes += [recorded.note] if recorded.note else []
    notes += [
        f'{name} was estimated from a part of {recorded.window}: its errors on that part are too small'
        for name, parts in used.items()
        if _overlap([(recorded.sha256, *span(recorded.trajectory))], parts)
    ]
    return found | _predictions(results, recorded)


def _parameters(results: Sequence[PartialResult]) -> dict[str, Any]:
    """Return the unit of each parameter and, for each result, value, standard error, and t-test against the first.

    ``apart`` is t, ``p`` its two-sided probability; None if a result lacks the parameter or does not estimate it.
    """
    rows: dict[str, Any] = {}
    for name, unit in zip(NAMES, UNITS, strict=True):
        entries = [result.parameters.get(name) for result in results]
        if any(entries):
            tests = [_welch(entries[0], entry) for entry in entries]
            rows[name] = {
                'unit': unit,
                'value': [None if e is None else e.value for e in entries],
                # The standard error of a parameter on its bound does not describe its uncertainty.
                'std_error': [None if e is None or e.on_bound else e.std_error for e in entries],
                'apart': [t for t, _ in tests],
                'p': [p for _, p in tests],
            }
    return rows


def _welch(a: Parameter | None, b: Parameter | None) -> tuple[float | None, float | None]:
    """Return Welch's t and its two-sided probability (Biometrika 34, 1947)."""
    if a is None or b is None or a.on_bound or b.on_bound or not a.std_error or not b.std_error:
        return None, None
    parts = [(a.std_error**2, a.degrees_of_freedom), (b.std_error**2, b.degrees_of_freedom)]
    variance = sum(s for s, _ in parts)
    t = (b.value - a.value) / math.sqrt(variance)
    inverse = sum(s**2 / n for s, n in parts if n) / variance**2  # inverse of the degrees of freedom
    return t, float(2 * (stdtr(1 / inverse, -abs(t)) if inverse else ndtr(-abs(t))))


def _training(result: PartialResult) -> list[Part]:
    """Return the parts of bags from which a result was estimated."""
    used = [(bag, BagWindow.named(bag.bag).start or 0.0) for bag in result.bags if bag.role == 'training']
    return [(bag.sha256, start, start + bag.duration) for bag, start in used]


def _overlap(parts: Sequence[Part], others: Sequence[Part]) -> bool:
    return any(a[0] == b[0] and max(a[1], b[1]) <= min(a[2], b[2]) for a in parts for b in others)


def _predictions(results: Mapping[str, PartialResult], recorded: RecordedTrajectory) -> dict[str, Any]:
    """Return the prediction errors of each result and of persistence, by horizon."""
    motion = evenly_stamped(recorded.trajectory)
    # All results are compared with the same states, but each with its own hold of the torque.
    smoothing = choose_smoothing([motion])
    predictions = []
    for result in results.values():
        motions = [Motion.prepare(motion, smoothing, result.effort.hold)]
        predictions.append(predict(motions, result.theta.vector(), result.effort.delay, state_scale(motions)))
    found = {'horizons': HORIZONS, 'error': [each.error for each in predictions]}
    return {'on': str(recorded.window), **known(found | {'persistence': predictions[-1].persistence})}
