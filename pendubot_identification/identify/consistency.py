# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Whether recordings are of one rig, and where something disturbed them."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr

from pendubot_identification.criteria.likelihood import FilterData, Likelihood, fit

from .estimate import Zeros
from .fitting import SETTINGS as FITTING
from .fitting import Composite
from .prediction import predict
from .selection import Problem

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ConsistencySettings:
    """When recordings contradict each other.

    Attributes:
        times: prediction error from the others over that of the recording's own fit.
        least: and that error, in standard deviations of the states.
        significance: of a disturbance, all samples together.
        joined: disturbances nearer than this [s] are one.
        listed: so many are listed.
    """

    times: float = 3.0
    least: float = 0.1
    significance: float = 1e-4
    joined: float = 0.5
    listed: int = 3


def remarks(answer: Composite, sound: bool, named: Collection[str]) -> Iterator[str]:
    """Yield what the user should know of the residuals.

    Args:
        answer: of the likelihood.
        sound: whether signs, order and zeros are right.
        named: the faults of the recordings; what these say is not said again.
    """
    yield from (found.sentence for found in answer.effects if found.name not in named)
    if sound and not answer.exact:
        yield from disturbances(answer.rough)
    if sound:
        yield from contradictions(answer)
    # What an exact rig may leave is nobody's effect.
    if not answer.exact and (answer.unexplained > FITTING.least).any():
        shoulder, elbow = (f'{100 * part:.3g} %' for part in answer.unexplained)
        yield (
            f'the rig has unmodelled effects: they make {shoulder} and {elbow} of the variance of the innovations at '
            'shoulder and elbow; the intervals allow for them as far as recordings differ'
        )


def contradictions(answer: Composite, settings: ConsistencySettings | None = None) -> list[str]:
    """Name the recording that contradicts the others, or both of two."""
    settings, data = settings or ConsistencySettings(), answer.data
    count = len(data.motions)
    if count < 2:
        return []
    names = [m.name for m in data.motions]
    alone = [_own(answer, k) for k in range(count)]
    others = alone[::-1] if count == 2 else [answer.without(answer.owner == k) for k in range(count)]

    def errors(thetas: list[Array]) -> Array:
        pairs = zip(data.motions, thetas, strict=True)
        return np.exp([predict([m], theta, answer.delay, data.scale).loss for m, theta in pairs])

    own, apart = errors(alone), errors(others)
    own = np.minimum(own, 1.5 * np.nanmedian(own))
    odd = (apart > settings.times * own) & (apart > settings.least)
    if count == 2 and odd.all():
        return [
            f'{names[0]} and {names[1]} contradict each other: each is predicted from the other with '
            f'{(apart / own).min():.0f} times or more the error of its own parameters; check that they are of one rig, '
            'with the same signs and zeros'
        ]
    if count == 2 or not odd.any():
        return []
    # The stranger spoils what the others say together: each recording is predicted from every other one alone.
    each = np.array([errors([alone[(k + by) % count] for k in range(count)]) for by in range(1, count)])
    apart = each.min(axis=0)
    worst = int(np.nanargmax(apart / own))
    if not (apart[worst] > settings.times * own[worst] and apart[worst] > settings.least):
        return []
    return [
        f'{names[worst]} contradicts the other recordings: each of them predicts it with {(apart / own)[worst]:.1f} '
        'times the error of its own parameters or more; check that it is of the same rig, with the same signs and zeros'
    ]


def _own(answer: Composite, number: int) -> Array:
    """Return the parameters of one recording alone, at the shortest interval."""
    rough = answer.rough
    filter_data = FilterData.of([answer.data.motions[number]], rough.likelihood.filter_data.settings)
    like = Likelihood(filter_data, rough.likelihood.effects, rough.likelihood.scale)
    try:
        found = fit(like, rough.fit.x, rough.lower, rough.upper, 20, 1.0)
    except FloatingPointError:
        return answer.theta
    return found.x[:14]


def recorded_zeros(rough: Problem) -> Zeros:
    """Return how far off the zeros of each recording's positions are: one scoring step of the offsets alone."""
    filter_data, blocks, at = rough.likelihood.filter_data, rough.fit.evaluation, [15, 16]
    count = len(filter_data.motions)
    angles, std_error = np.full((2, count), math.nan), np.full((2, count), math.nan)
    for k in range(count):
        own = filter_data.owner == k
        slopes, information = blocks.slopes[own][:, at], blocks.informations[own].sum(axis=0)[np.ix_(at, at)]
        if np.linalg.cond(information) > 1e12:
            continue
        inverse = np.linalg.inv(information)
        moves = slopes @ inverse
        angles[:, k] = rough.fit.x[at] - moves.sum(axis=0)
        std_error[:, k] = np.sqrt(np.diag(inverse) + len(moves) * moves.var(axis=0))
    return Zeros(tuple(m.name for m in filter_data.motions), angles, std_error)


def disturbances(rough: Problem, settings: ConsistencySettings | None = None) -> Iterator[str]:
    """Say where innovations are too large for their own distribution."""
    settings, filter_data = settings or ConsistencySettings(), rough.likelihood.filter_data
    e, s = rough.likelihood.innovations(rough.fit.x)
    z = np.abs(e) / np.sqrt(s)
    chance = 2 * stdtr(filter_data.settings.freedom, -z) * z.size
    large = (chance < settings.significance).any(axis=1) & (filter_data.weight > 0)
    said = []
    for g, rows in enumerate(filter_data.rows):
        # The first speed is not known: what it makes is no disturbance.
        known = filter_data.t[rows] > filter_data.t[rows.start] + settings.joined
        motion, t = filter_data.motions[filter_data.recording[g]], filter_data.t[rows][large[rows] & known]
        for part in np.split(t, np.flatnonzero(np.diff(t) > settings.joined) + 1):
            if len(part):
                said.append(f'{motion.name} at {part[0] - motion.start:.1f} s')
    if said:
        more = f' and {len(said) - settings.listed} more' if len(said) > settings.listed else ''
        yield (
            f'a disturbance: {", ".join(said[: settings.listed])}{more}; a hand, a cable, an end stop, lost samples or '
            'encoder counts, or sharp friction make such jumps'
        )
