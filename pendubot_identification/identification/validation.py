# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The estimate of each criterion, with its prediction errors on validation data."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pendubot_identification.arrays import Array
from pendubot_identification.errors import TrajectoryError
from pendubot_identification.model.parameters import MODELS
from pendubot_identification.trajectories.motion import Motion

from .effects import compensated
from .estimate import Effort, Estimate, Progress
from .fitting import Composite
from .identification import Run
from .linear import estimate_linear, linear
from .prediction import Fold, Prediction, predict
from .residuals import recorded_zeros
from .uncertainty import correlations, influence_covariance, scaled_condition_number


def validated(criterion: str, run: Run, validation_motions: Sequence[Motion], report: Progress) -> Estimate:
    """Return the estimate of one criterion with its prediction errors."""
    if criterion == 'likelihood' and run.composite is not None:
        found, parts = _likelihood(run.composite, validation_motions, run.folds)
    else:
        found, parts = _quadratic(criterion, run, validation_motions, report)
    return replace(found, prediction=Prediction.pool(parts) if parts else Prediction.none())


def _likelihood(
    answer: Composite, validation_motions: Sequence[Motion], left_out: Sequence[Fold]
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
    criterion: str, run: Run, validation_motions: Sequence[Motion], report: Progress
) -> tuple[Estimate, list[Prediction]]:
    settings, data, answer = run.settings, run.data, run.composite
    automatic = 'viscous' if criterion == 'energy' else 'geared' if answer is None else answer.model
    model = automatic if settings.model == 'auto' else settings.model
    problem = data.linear(criterion, model)
    assess = linear(criterion, validation_motions, model, settings, like=problem) if validation_motions else None
    found = estimate_linear(criterion, problem, model, settings, data.hold, report, assess)
    parts = [predict([m], found.theta, problem.delay, data.scale) for m in validation_motions]
    for fold in run.folds:
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
