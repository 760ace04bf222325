# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""From motions to parameters: prepare, check conventions, fit, predict, assess."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.errors import TrajectoryError
from pendubot_identification.level import Level
from pendubot_identification.model.parameters import MODELS
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.reading import Reading
from pendubot_identification.trajectories.signals import evenly_stamped
from pendubot_identification.trajectories.suspicions import suspicions
from pendubot_identification.trajectories.trajectory import Trajectory

from .consistency import contradictions, disturbances, recorded_zeros
from .diagnosis import Fault, diagnose, link_length, with_options
from .effects import FoundEffect, compensated
from .estimate import Effort, Estimate, Progress
from .fitting import Composite, FittingSettings, TrainingData, fit_composite
from .judgement import judge, require_excitation
from .linear import estimate_linear, linear
from .options import CRITERIA
from .prediction import Fold, Prediction, folds, predict
from .settings import Settings
from .uncertainty import correlations, influence_covariance, scaled_condition_number

Array = NDArray[np.float64]

#: The criteria in the order in which they are published.
TRUST = ('likelihood', 'weak', 'energy')


@dataclass(frozen=True, slots=True)
class Identification:
    """Every criterion's answer, which one is published, and everything that says how far to trust it.

    Attributes:
        settings: what was asked for.
        estimates: one a criterion: those that were asked for, and the paper's, energy.
        published: the number of the one that is published.
        faults: of the recordings.
        interval: between the training samples [s].
        smoothing: the window [s] that made the states.
        validation: what the predictions are of, in words.
        link_length: P3 / P5 [m] of the elbow's own equation, and its standard error.
        effects: unmodelled effects, the accepted ones first.
        unmodelled: fraction of the innovations' variance of both joints that quantization does not explain; None where
            the likelihood was not minimised, or nothing but quantization is left.
    """

    settings: Settings
    estimates: tuple[Estimate, ...]
    published: int
    faults: tuple[Fault, ...]
    interval: float
    smoothing: float
    validation: str
    link_length: tuple[float, float]
    effects: tuple[FoundEffect, ...] = ()
    unmodelled: Array | None = None

    @property
    def best(self) -> Estimate:
        """The estimate that is published."""
        return self.estimates[self.published]

    @property
    def mended(self) -> Reading | None:
        """How the recordings are to be read so that their faults are put right; None where no options do that."""
        return next((fault.mended for fault in reversed(self.faults) if fault.mended is not None), None)

    @property
    def level(self) -> Level:
        """How far to trust them."""
        return self.best.level

    @property
    def warnings(self) -> tuple[str, ...]:
        """Why, in sentences for the user."""
        return self.best.warnings

    def compensated(self, motion: Motion) -> Motion:
        """Return a motion with the torques that act, as far as accepted effects tell them."""
        return compensated(motion, self.effects, self.best.effort.delay)


def identify(
    training: Sequence[Trajectory],
    validation: Sequence[Trajectory] = (),
    settings: Settings | None = None,
    progress: Progress | None = None,
    notes: Sequence[str] = (),
) -> Identification:
    """Estimate the parameters of a rig from one or more of its motions.

    Where the stamps of one are evidently false, even ones take their place.

    Args:
        training: the motions that estimate; they are pooled.
        validation: motions that only judge. Without any, each recording of several (or block of time of one or two)
            is predicted from the others in turn; the estimates themselves use all of them.
        settings: see :class:`Settings`.
        progress: called with what is being done, how much of it is done, of how much (0: not known), and the best J.
        notes: warnings that come with the data, such as a bag that was never closed.

    Raises:
        TrajectoryError: a motion that is too short or has gaps.
        ExcitationError: a motion from which some parameters are not identifiable.
    """
    settings = settings or Settings()
    tell = progress or (lambda what, done, of, best: None)
    given = [*training, *validation]
    training, validation = ([evenly_stamped(motion) for motion in part] for part in (training, validation))
    for motion in (*training, *validation):
        motion.require_samples()
    require_excitation(training, settings)
    settings = settings.of_rig(training)
    tell('preparing', 0, 0, np.nan)
    data = TrainingData.prepare(training, settings)
    tell('checking signs, zeros and stamps', 0, 0, np.nan)
    faults = _diagnosed(data, data.motions)
    sound = not any(f.level is Level.ERROR and f.name not in ('delay', 'motion', 'offset') for f in faults)
    answer = None
    said = [*notes, *suspicions(given)]
    if 'likelihood' in settings.criteria:
        tell('weak: rough parameters', 0, 0, np.nan)
        answer = fit_composite(data, tell, effects=settings.compensate and sound)
        data = answer.data
        if faults and any(found.accepted for found in answer.effects):
            faults = _left(faults, data, answer)
        said += _notes(answer, sound, faults, tell)
    judges = [Motion.prepare(motion, data.smoothing, data.hold) for motion in validation]
    left_out = [] if judges else folds(data.motions)
    criteria: list[str] = [c for c in CRITERIA if c in settings.criteria or c == 'energy']
    estimates = [_estimated(criterion, data, answer, judges, left_out, tell) for criterion in criteria]
    published = next(criteria.index(c) for c in TRUST if c in settings.criteria)
    best = estimates[published]
    length = link_length(data.motions, best.model, best.effort.delay)
    if not sound:
        # Zeros of single recordings would make up for what is wrong with all of them.
        estimates = [replace(e, zeros=None) for e in estimates]
    whole = len(left_out) == len(data.motions)
    return Identification(
        settings=settings,
        estimates=tuple(judge(e, settings, length, faults, said if e is best else notes) for e in estimates),
        published=published,
        faults=faults,
        interval=float(np.median([m.interval for m in data.motions])),
        smoothing=data.smoothing,
        validation='on data that was not used for estimation'
        if judges
        else 'each recording predicted from the others'
        if whole
        else f'each of {len(left_out)} blocks of time predicted from the others',
        link_length=length,
        effects=() if answer is None else answer.effects,
        unmodelled=None if answer is None or answer.exact else answer.unexplained,
    )


def _diagnosed(data: TrainingData, motions: Sequence[Motion]) -> tuple[Fault, ...]:
    """Return what is wrong with the recordings' conventions, with the options that put it right."""
    settings, (low, high) = data.settings, data.settings.delays
    model, delay = 'rotor' if settings.model == 'auto' else settings.model, low if low == high else 0.0
    faults = diagnose(motions, data.smoothing, data.hold, model, delay, settings.link_length)
    return with_options(faults, settings.reading)


def _left(faults: Sequence[Fault], data: TrainingData, answer: Composite) -> tuple[Fault, ...]:
    """Return the faults that accepted effects do not explain, and a constant effort, which has an option."""
    motions = [compensated(motion, answer.effects, answer.delay) for motion in data.motions]
    named = {fault.name for fault in _diagnosed(data, motions)}
    mild = [replace(fault, level=Level.WARN) if fault.name not in named else fault for fault in faults]
    return tuple(fault for fault in mild if fault.name in {*named, 'offset'})


def _notes(answer: Composite, sound: bool, faults: Sequence[Fault], tell: Progress) -> list[str]:
    """Return what the user should know of the residuals; what a fault says is not said again."""
    said = [found.sentence for found in answer.effects if found.name not in {fault.name for fault in faults}]
    if sound and not answer.exact:
        said += disturbances(answer.rough)
    if sound:
        tell('checking whether recordings agree', 0, 0, np.nan)
        said += contradictions(answer)
    if not answer.exact:
        shoulder, elbow = (f'{100 * part:.3g} %' for part in answer.unexplained)
        said.append(
            f'the rig has unmodelled effects: they make {shoulder} and {elbow} of the variance of the innovations at '
            'shoulder and elbow; the intervals allow for them as far as recordings differ'
        )
    return said


def _estimated(
    criterion: str,
    data: TrainingData,
    answer: Composite | None,
    judges: Sequence[Motion],
    left_out: Sequence[Fold],
    tell: Progress,
) -> Estimate:
    """Return one criterion's answer with its prediction errors."""
    settings = data.settings
    if criterion == 'likelihood' and answer is not None:
        found = _likelihood_estimate(answer)
        motions = [compensated(m, answer.effects, answer.delay) for m in judges]
        size = len(found.theta)
        parts = [predict([m], found.theta, answer.delay, data.scale) for m in motions]
        for fold in left_out:
            times = [answer.readings.block_times(k) for k in range(len(answer.owner))]
            held = (answer.owner == fold.recording) & [
                fold.held_out.start - 1e-9 <= t <= fold.held_out.end + 1e-9 for t in times
            ]
            part = compensated(fold.held_out, answer.effects, answer.delay)
            parts.append(predict([part], answer.without(held)[:size], answer.delay, data.scale))
    else:
        model = settings.model
        if model == 'auto':
            model = 'viscous' if criterion == 'energy' else 'geared' if answer is None else answer.model
        made = data.linear(criterion, model)
        judge = linear(criterion, judges, model, settings, like=made) if judges else None
        found = estimate_linear(criterion, made, model, settings, data.hold, tell, judge)
        parts = [predict([m], found.theta, made.delay, data.scale) for m in judges]
        for fold in left_out:
            try:
                rest = linear(criterion, fold.rest, model, settings, like=made).criterion.minimum(settings.box(model))
            except TrajectoryError:  # too short for a test function
                continue
            parts.append(predict([fold.held_out], rest, made.delay, data.scale))
    return replace(found, prediction=Prediction.pool(parts) if parts else Prediction.none())


def _likelihood_estimate(answer: Composite) -> Estimate:
    settings, size = answer.data.settings, MODELS[answer.model]
    bounds, free = settings.box(answer.model), answer.free[:size]
    information = answer.information[:size, :size]
    covariance, std_error, freedom, words = influence_covariance(
        information,
        answer.slopes[:, :size],
        answer.owner,
        free,
        exact=answer.exact,
        several=FittingSettings().several,
    )
    return Estimate(
        criterion='likelihood',
        model=answer.model,
        theta=answer.theta[:size],
        free=free,
        covariance=covariance,
        correlation=correlations(information, free),
        std_error=np.where(bounds.held, 0.0, np.where(bounds.present, std_error, math.nan)),
        freedom=freedom,
        uncertainty=words,
        effort=Effort(answer.data.hold, answer.delay, answer.delay_std_error),
        J=answer.J,
        residuals=2 * answer.readings.measurements,
        condition_number=scaled_condition_number(information, free),
        converged=answer.converged,
        steps=answer.steps,
        zeros=recorded_zeros(answer.rough),
        exact=answer.exact,
        absent=bounds.absent,
        held=bounds.held,
    )
