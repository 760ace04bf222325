# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Checks of the residuals: unmodelled effects, disturbances, and recordings that contradict each other."""

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import stdtr

from pendubot_identification.criteria.quadratic import Quadratic
from pendubot_identification.criteria.weak import WIDTH
from pendubot_identification.errors import TrajectoryError
from pendubot_identification.level import Level
from pendubot_identification.model.parameters import Bounds
from pendubot_identification.trajectories.motion import Motion

from .conventions import Fault, agrees_with_exact_fit, detect_faults, joint_regression
from .effects import Problem, compensated
from .estimate import Zeros
from .fitting import SETTINGS as FITTING
from .fitting import Composite, torque_noise, unexplained, with_fitted_noise
from .settings import Settings


@dataclass(frozen=True, slots=True)
class ResidualSettings:
    """Thresholds of the residual checks."""

    #: Ratio of squared residuals with common and with separate parameters, above which recordings contradict each
    #: other: real recordings of one rig reach 1.7, of two rigs at least 4.2.
    ratio: float = 3.0
    #: Least difference of these, as a fraction of the squared effort: 1 % of its RMS.
    least: float = 1e-4
    #: Significance level of a disturbance, for all samples together.
    significance: float = 1e-4
    #: Interval within which disturbances are joined [s]; number of listed disturbances.
    joined: float = 0.5
    listed: int = 3


SETTINGS = ResidualSettings()


def remaining_faults(faults: tuple[Fault, ...], answer: Composite, settings: Settings) -> tuple[Fault, ...]:
    """Return the faults that neither an exact fit nor accepted effects explain, and an offset, which has an option."""
    accepted = any(effect.accepted for effect in answer.effects)
    if answer.exact and not accepted:
        return tuple(fault for fault in faults if agrees_with_exact_fit(fault, answer.offsets))
    if not faults or not accepted:
        return faults
    motions = [compensated(motion, answer.effects, answer.delay) for motion in answer.data.excerpt().motions]
    named = {fault.name for fault in detect_faults(motions, settings)}
    mild = [fault if fault.name in named else replace(fault, level=Level.WARN) for fault in faults]
    return tuple(fault for fault in mild if fault.name in {*named, 'offset'})


def remarks(answer: Composite, validation: Sequence[Motion], sound: bool, named: Collection[str]) -> Iterator[str]:
    """Yield findings for the user; ``sound``: signs, order and zeros are right; ``named``: the recordings' faults."""
    yield from (found.sentence for found in answer.effects if found.name not in named)
    if sound:
        yield from _inconsistencies(answer, validation)
        yield from () if answer.exact else disturbances(answer.rough)
    if not answer.exact and (answer.unexplained > FITTING.least).any():
        shoulder, elbow = (f'{100 * part:.3g} %' for part in answer.unexplained)
        yield (
            f'the rig has unmodelled effects: they make {shoulder} and {elbow} of the variance of the innovations at '
            'shoulder and elbow; the intervals cover them as far as recordings differ'
        )


def _inconsistencies(answer: Composite, motions: Sequence[Motion]) -> Iterator[str]:
    """Yield contradictions of all recordings, and disturbances or a poor fit of those for validation."""
    data, model, delay = answer.data, answer.model, answer.delay
    training = [compensated(m, answer.effects, delay) for m in data.excerpt().motions]
    actual = [compensated(m, answer.effects, delay) for m in motions if m.end - m.start > FITTING.shortest]
    found = list(contradictions([*training, *actual], model, delay, data.settings.box(model)))
    try:
        if actual:
            problem = with_fitted_noise(actual, answer.theta, delay, data.settings)
            found += disturbances(problem)
            # Quantization alone can look like torque noise.
            worse = (torque_noise(data, problem) > 1) & (unexplained(problem.likelihood, problem.fit.x) > FITTING.least)
            if answer.exact and worse.any() and not found:
                found.append(
                    'the parameters do not explain the validation data to the quantization level, as they do the '
                    'training data; check that all recordings are of one rig, with the same signs and zeros'
                )
    except TrajectoryError as error:
        found.append(str(error))
    yield from found


def contradictions(motions: Sequence[Motion], model: str, delay: float, bounds: Bounds) -> Iterator[str]:
    """Yield a warning if a recording has other parameters than the rest (Chow, Econometrica 28, 1960)."""
    motions = [motion for motion in motions if motion.end - motion.start > WIDTH + abs(delay)]
    if len(motions) < 2:
        return
    residuals = [joint_regression(motion, model, delay) for motion in motions]
    parts = [Quadratic.reduce(each.phi, each.y) for each in residuals]

    def squared(group: Sequence[Quadratic]) -> float:
        criterion = Quadratic.pool(group)
        return criterion.count * float(criterion(criterion.minimum_in_box(bounds)))

    separate = [squared([part]) + squared([*parts[:k], *parts[k + 1 :]]) for k, part in enumerate(parts)]
    odd, common, effort = int(np.argmin(separate)), squared(parts), sum(float(each.y @ each.y) for each in residuals)
    if common <= SETTINGS.ratio * separate[odd] or common - separate[odd] <= SETTINGS.least * effort:
        return
    found = f'{motions[odd].name} contradicts the other recordings'
    if len(motions) == 2:
        one, other = (motion.name for motion in motions)
        found = f'{"both parts of " + one if one == other else f"{one} and {other}"} contradict each other'
    yield (
        f'{found}: common parameters leave {common / max(separate[odd], 1e-300):.2g} times the squared residual of '
        'separate ones; check that all recordings are of one rig, with the same signs and zeros'
    )


def recorded_zeros(rough: Problem) -> Zeros:
    """Return the errors of each recording's zeros: one scoring step of the offsets alone."""
    filter_data, blocks, offsets = rough.likelihood.filter_data, rough.fit.evaluation, [15, 16]
    count = len(filter_data.motions)
    angles, std_error = np.full((2, count), math.nan), np.full((2, count), math.nan)
    for k in range(count):
        selected = filter_data.owner == k
        information = blocks.informations[selected].sum(axis=0)[np.ix_(offsets, offsets)]
        if np.linalg.cond(information) > 1e12:
            continue
        inverse = np.linalg.inv(information)
        moves = blocks.slopes[selected][:, offsets] @ inverse
        angles[:, k] = rough.fit.x[offsets] - moves.sum(axis=0)
        std_error[:, k] = np.sqrt(np.diag(inverse) + len(moves) * moves.var(axis=0))
    return Zeros(tuple(m.name for m in filter_data.motions), angles, std_error)


def disturbances(rough: Problem) -> Iterator[str]:
    """Yield a warning with the times of innovations that are too large for their distribution."""
    filter_data = rough.likelihood.filter_data
    e, s = rough.likelihood.innovations(rough.fit.x)
    z = np.abs(e) / np.sqrt(s)
    probability = 2 * stdtr(filter_data.settings.freedom, -z) * z.size
    large = (probability < SETTINGS.significance).any(axis=1) & (filter_data.weight > 0)
    found = []
    for g, rows in enumerate(filter_data.rows):
        # The first speed is unknown, so the first innovations are large.
        known = filter_data.t[rows] > filter_data.t[rows.start] + SETTINGS.joined
        motion, t = filter_data.motions[filter_data.recording[g]], filter_data.t[rows][large[rows] & known]
        starts = t[np.diff(t, prepend=-math.inf) > SETTINGS.joined]
        found += [f'{motion.name} at {start:.1f} s' for start in starts]
    if found:
        more = f' and {len(found) - SETTINGS.listed} more' if len(found) > SETTINGS.listed else ''
        yield (
            f'a disturbance: {", ".join(found[: SETTINGS.listed])}{more}; the cause may be a hand, a cable, an end '
            'stop, lost samples or encoder counts, or abrupt friction'
        )
