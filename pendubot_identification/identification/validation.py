# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The estimate of each criterion, with its prediction errors on validation data."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from pendubot_identification.arrays import Array
from pendubot_identification.criteria.prediction_error import Prediction, predict
from pendubot_identification.errors import TrajectoryError
from pendubot_identification.model.parameters import MODELS
from pendubot_identification.trajectories.motion import Motion

from .effects import compensated
from .estimate import Effort, Estimate, Progress, estimate_linear, linear
from .fitting import Composite, TrainingData
from .residuals import recorded_zeros
from .uncertainty import correlations, influence_covariance, scaled_condition_number


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


def folds(motions: Sequence[Motion], several: int = 3, blocks: int = 5) -> list[Fold]:
    """Return a fold for each recording or, with fewer than ``several``, for each of about five blocks of time."""
    result = []
    for number, m in enumerate(motions):
        others = [other for other in motions if other is not m]
        if len(motions) >= several:
            result.append(Fold(m, number, tuple(others)))
            continue
        count = blocks if len(motions) == 1 else (blocks + 1) // 2
        for low, high in pairwise(np.linspace(m.start, m.end, count + 1)):
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

    parts = [predicted(motion, found.theta) for motion in validation_motions]
    times = np.array([answer.filter_data.block_times(k) for k in range(len(answer.owner))])
    for fold in left_out:
        inside = (times >= fold.held_out.start - 1e-9) & (times <= fold.held_out.end + 1e-9)
        parts.append(predicted(fold.held_out, answer.without((answer.owner == fold.recording) & inside)))
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
        answer.owner,
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
