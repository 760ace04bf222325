# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Validation of estimates: predictions of data that did not estimate, and checks of the residuals."""

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.special import stdtr

from pendubot_identification.arrays import Array
from pendubot_identification.criteria.likelihood import LikelihoodSettings
from pendubot_identification.criteria.prediction_error import Prediction, predict
from pendubot_identification.criteria.quadratic import Quadratic
from pendubot_identification.criteria.weak import WIDTH
from pendubot_identification.errors import TrajectoryError
from pendubot_identification.level import Level
from pendubot_identification.model.parameters import MODELS, Bounds
from pendubot_identification.trajectories.motion import Motion

from .conventions import Fault, agrees_with_exact_fit, detect_faults, joint_regression
from .effects import Problem, compensated
from .estimate import Effort, Estimate, Progress, Zeros, estimate_linear, linear
from .fitting import SETTINGS as FITTING
from .fitting import Composite, TrainingData, torque_noise, unexplained, with_fitted_noise
from .uncertainty import correlations, influence_covariance, scaled_condition_number


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


@dataclass(frozen=True, slots=True)
class Fold:
    """A part of a recording that is predicted from the rest of the data.

    Attributes:
        held_out: the part.
        recording: index of its recording.
        rest: the other data.
    """

    held_out: Motion
    recording: int
    rest: tuple[Motion, ...]


def folds(motions: Sequence[Motion]) -> list[Fold]:
    """Return a fold for each of three or more recordings, or for each of five or six blocks of time of fewer."""
    result = []
    for number, m in enumerate(motions):
        others = [other for other in motions if other is not m]
        if len(motions) >= 3:
            result.append(Fold(m, number, tuple(others)))
            continue
        blocks = 5 if len(motions) == 1 else 3
        for low, high in pairwise(np.linspace(m.start, m.end, blocks + 1)):
            rest = [m.part(begin, end) for begin, end in ((m.start, low), (high, m.end)) if end > begin]
            result.append(Fold(m.part(low, high), number, (*others, *rest)))
    return result


def validated(
    criterion: str,
    data: TrainingData,
    composite: Composite | None,
    left_out: Sequence[Fold],
    validation_motions: Sequence[Motion],
    report: Progress,
) -> Estimate:
    """Return the estimate of one criterion with its prediction errors."""
    if criterion == 'likelihood' and composite is not None:
        found, parts = _likelihood(composite, left_out, validation_motions)
    else:
        automatic = 'viscous' if criterion == 'energy' else 'geared' if composite is None else composite.model
        model = automatic if data.settings.model == 'auto' else data.settings.model
        found, parts = _quadratic(criterion, model, data, left_out, validation_motions, report)
    return replace(found, prediction=Prediction.pool(parts) if parts else Prediction.none())


def _likelihood(
    answer: Composite, left_out: Sequence[Fold], validation_motions: Sequence[Motion]
) -> tuple[Estimate, list[Prediction]]:
    found, size, delay, scale = _estimate(answer), MODELS[answer.model], answer.delay, answer.data.scale

    def predicted(motion: Motion, theta: Array) -> Prediction:
        return predict([compensated(motion, answer.effects, delay)], theta[:size], delay, scale)

    parts, owner = [predicted(motion, found.theta) for motion in validation_motions], answer.filter_data.owner
    times = np.array([answer.filter_data.block_times(k) for k in range(len(owner))])
    for fold in left_out:
        inside = (times >= fold.held_out.start - 1e-9) & (times <= fold.held_out.end + 1e-9)
        parts.append(predicted(fold.held_out, answer.without((owner == fold.recording) & inside)))
    return found, parts


def _quadratic(
    criterion: str,
    model: str,
    data: TrainingData,
    left_out: Sequence[Fold],
    validation_motions: Sequence[Motion],
    report: Progress,
) -> tuple[Estimate, list[Prediction]]:
    settings, problem = data.settings, data.linear(criterion, model)
    assess = linear(criterion, validation_motions, model, settings, like=problem) if validation_motions else None
    found = estimate_linear(criterion, problem, model, settings, data.hold, report, assess)
    parts = [predict([m], found.theta, problem.delay, data.scale) for m in validation_motions]
    for fold in left_out:
        try:
            rest = linear(criterion, fold.rest, model, settings, like=problem).criterion.minimum(settings.box(model))
        except TrajectoryError:  # too short for a test function
            continue
        parts.append(predict([fold.held_out], rest, problem.delay, data.scale))
    return found, parts


def _estimate(answer: Composite) -> Estimate:
    settings, size = answer.data.settings, MODELS[answer.model]
    bounds, free = settings.box(answer.model), answer.free[:size]
    information = answer.information[:size, :size]
    covariance, std_error, freedom, words = influence_covariance(
        information,
        answer.slopes[:, :size],
        answer.filter_data.owner,
        free,
        answer.difference[:size],
        exact=answer.exact,
    )
    return Estimate(
        criterion='likelihood',
        model=answer.model,
        theta=answer.theta[:size],
        free=free,
        covariance=covariance,
        correlation=correlations(information, free),
        std_error=np.where(bounds.fixed, 0.0, np.where(bounds.present, std_error, math.nan)),
        freedom=freedom,
        uncertainty=words,
        effort=Effort(answer.data.hold, answer.delay, answer.delay_std_error),
        J=answer.J,
        residuals=2 * answer.filter_data.measurements,
        condition_number=scaled_condition_number(information, free),
        converged=answer.converged,
        steps=answer.steps,
        zeros=recorded_zeros(answer.rough),
        exact=answer.exact,
        absent=bounds.absent,
        fixed=bounds.fixed,
    )


def remaining_faults(faults: tuple[Fault, ...], answer: Composite) -> tuple[Fault, ...]:
    """Return the faults that neither an exact fit nor accepted effects explain, and an offset, which has an option.

    Without both, a motion that is predictable over a short interval only is a further fault.
    """
    accepted = any(effect.accepted for effect in answer.effects)
    if answer.exact and not accepted:
        return tuple(fault for fault in faults if agrees_with_exact_fit(fault, answer.offsets))
    usual = LikelihoodSettings().intervals[0]
    if answer.rough.interval < usual and not accepted:
        found = f'the model predicts the motion over {answer.rough.interval:g} s, and over {usual:g} s is expected'
        return (*faults, Fault('motion', found, 'check the recording, or record slower motion', Level.ERROR))
    if not faults or not accepted:
        return faults
    motions = [compensated(motion, answer.effects, answer.delay) for motion in answer.data.excerpt().motions]
    named = {fault.name for fault in detect_faults(motions, answer.data.settings)}
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
