# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Whether answers agree: recordings that are pooled are of one rig, and two criteria find the same parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.criteria.trajectory_fit import TrajectoryFit
from pendubot_identification.level import NORMAL_95
from pendubot_identification.model.parameters import NAMES

from .estimate import Estimate
from .prediction import predict
from .recipes import Data

Array = NDArray[np.float64]

#: A recording that the others predict with more than so many times the error that is left where it alone is fitted
#: contradicts them, if that error is also more than this fraction of the states' standard deviations. The real rigs'
#: recordings, of one rig and three or more of them, reach 1.7 times.
CONTRADICTING, CONTRADICTION = 3.0, 0.1
#: Recordings that one set of parameters explains with no more than so many times the error that their own leave, agree,
#: however badly some predict others: then those say too little. The real rigs' reach 1.4.
AGREEING = 2.0
#: Of a recording that no parameters explain, so many times the median error counts as its own.
EXPLAINED = 2.0
#: Two criteria disagree about one of P1 to P5 if they differ by more than so many standard errors, and this fraction.
ERRORS_APART, APART = 3.0, 0.05


def contradictions(data: Data, model: str, together: TrajectoryFit, without: Sequence[TrajectoryFit] = ()) -> list[str]:
    """Name recordings that contradict the others.

    Args:
        data: two or more recordings.
        model: the name of one of :data:`.parameters.MODELS`.
        together: the fit of all of them.
        without: for each recording, the fit of all others where it is known already.
    """
    groups, names, count = data.groups, [recording.name for recording in data.whole], len(data.groups)
    # A delay that recordings have in common is a start for each of them; it is fitted along.
    alone = [data.only(group).fit(model, like=data.linear('weak', model)) for group in groups]

    def errors(fits: Sequence[TrajectoryFit]) -> Array:
        pairs = zip(groups, fits, strict=True)
        return np.exp([predict(group, fit.fit.theta, fit.fit.delay, data.scale).loss for group, fit in pairs])

    own = errors(alone)
    own = np.minimum(own, EXPLAINED * np.nanmedian(own))
    if not (errors([together] * count) > AGREEING * own).any():
        return []
    if count == 2:
        without = alone[::-1]
    elif len(without) != count:
        without = [
            data.only([m for g in groups if g is not left_out for m in g]).fit(model, near=together)
            for left_out in groups
        ]
    apart = errors(without)
    odd = (apart > CONTRADICTING * own) & (apart > CONTRADICTION)
    if count == 2 and odd.all():
        return [
            f'{names[0]} and {names[1]} contradict each other: each is predicted from the other with '
            f'{(apart / own).min():.0f} times or more the error that its own parameters leave; are they of one rig, '
            'with the same signs and zeros?'
        ]
    if count == 2 or not odd.any():
        return []
    # All are predicted badly by a crowd with one stranger in it. The stranger is whom the others agree without.
    strife = [np.delete(np.log(errors([fit] * count) / own), k).mean() for k, fit in enumerate(without)]
    stranger = int(np.nanargmin(strife))
    if not odd[stranger]:
        return []
    return [
        f'{names[stranger]} contradicts the other recordings: they predict it with {(apart / own)[stranger]:.1f} times '
        'the error that its own parameters leave; is it of the same rig, with the same signs and zeros?'
    ]


def disagreement(estimates: Sequence[Estimate]) -> tuple[list[Estimate], list[str]]:
    """Return the estimates, those of weak and trajectory with what they disagree about in their errors, and say it."""
    pair = [e for e in estimates if e.criterion in ('weak', 'trajectory') and e.converged]
    if len(pair) < 2 or any(e.exact for e in pair):
        return list(estimates), []
    one, other = pair
    off = one.theta[:5] - other.theta[:5]
    within = np.maximum(
        ERRORS_APART * np.hypot(one.std_error[:5], other.std_error[:5]), APART * np.abs(one.theta + other.theta)[:5] / 2
    )
    odd = np.flatnonzero((one.free & other.free)[:5] & (np.abs(off) > within))
    if not odd.size:
        return list(estimates), []
    # So that the interval of each holds what the other says.
    added = np.zeros(len(one.theta))
    added[odd] = off[odd] / NORMAL_95
    wider = [
        replace(
            e,
            std_error=np.hypot(e.std_error, added),
            covariance=e.covariance + np.outer(added, added),
            uncertainty=f'{e.uncertainty}; and how weak and trajectory differ',
        )
        if e.criterion in ('weak', 'trajectory')
        else e
        for e in estimates
    ]
    parts = 100 * np.abs(off[odd]) / np.maximum(np.abs(one.theta[odd]), np.abs(other.theta[odd]))
    said = ', '.join(f'{NAMES[k]} ({part:.2g} %)' for k, part in zip(odd, parts, strict=True))
    return wider, [
        f'weak and trajectory disagree about {said} by more than {ERRORS_APART:g} of their standard errors, which now '
        'include that: the rig has what the models lack, or the recordings are few or short; look at the unexplained '
        'torque, and record more'
    ]
