# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""From motions to an identification: prepare, check conventions, fit, validate, assess."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pendubot_identification.arrays import Array
from pendubot_identification.errors import TrajectoryError
from pendubot_identification.level import Level
from pendubot_identification.trajectories.data_checks import data_checks
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.signals import evenly_stamped
from pendubot_identification.trajectories.trajectory import Trajectory

from . import CRITERIA
from .conventions import Fault, corrected_conversion, detect_faults, link_length, sound
from .effects import DetectedEffect
from .estimate import Estimate, Progress
from .fitting import TrainingData
from .selection import Composite, fit_composite
from .settings import Settings
from .validation import assess, folds, remaining_faults, remarks, require_excitation, stillness, validated


@dataclass(frozen=True, slots=True)
class Identification:
    """The estimates of all criteria, and the findings for the level of the published one.

    Attributes:
        settings: of the identification.
        estimates: one for each requested criterion, and for energy; the last, most accurate one is published.
        faults: of the recordings.
        interval: sampling interval of the training data [s].
        smoothing: smoothing window of the states [s].
        validation: the predicted data, in words.
        link_length: P3 / P5 [m] by the elbow's equation, and its standard error.
        effects: unmodelled effects, the accepted ones first.
        unmodelled: fraction of the innovations' variance of both joints that quantization does not explain; None
            without the likelihood, or if the residual is at the quantization level.
    """

    settings: Settings
    estimates: tuple[Estimate, ...]
    faults: tuple[Fault, ...]
    interval: float
    smoothing: float
    validation: str
    link_length: tuple[float, float]
    effects: tuple[DetectedEffect, ...] = ()
    unmodelled: Array | None = None

    @property
    def best(self) -> Estimate:
        """The estimate that is published."""
        return self.estimates[-1]

    @property
    def level(self) -> Level:
        """The level of the published estimate."""
        return self.best.level

    @property
    def warnings(self) -> tuple[str, ...]:
        """The reasons of the level, in sentences for the user."""
        return self.best.warnings


def identify(
    training: Sequence[Trajectory],
    validation: Sequence[Trajectory] = (),
    settings: Settings | None = None,
    progress: Progress | None = None,
    notes: Sequence[str] = (),
) -> Identification:
    """Estimate the parameters of a rig from one or more of its motions; replace inconsistent timestamps by even ones.

    Args:
        training: the motions that estimate; they are pooled.
        validation: motions for validation alone. Without any, each recording of several (or block of time of one or
            two) is predicted from the others in turn; the estimates themselves use all of them.
        settings: see :class:`Settings`.
        progress: see :data:`.estimate.Progress`.
        notes: warnings of the data, such as an unclosed bag.

    Raises:
        TrajectoryError: a motion is too short or has gaps.
        ExcitationError: some parameters are not identifiable from the motions.
    """
    report = progress or (lambda activity, done, total, best: None)
    report('preparing', 0, 0, math.nan)
    data, others = _prepared(training, validation, settings or Settings())
    still = [*filter(None, map(stillness, others))]
    report('checking signs, zeros and stamps', 0, 0, math.nan)
    faults, composite = detect_faults(data.excerpt().motions, data.settings), None
    if 'likelihood' in data.settings.criteria:
        report('weak: rough parameters', 0, 0, math.nan)
        composite = _fitted(data, faults, report)
        data, faults = composite.data, remaining_faults(faults, composite)

    predicted = [Motion.prepare(motion, data.smoothing, data.hold) for motion in others if not stillness(motion)]
    left_out = [] if predicted else folds(data.motions)
    criteria = [c for c in CRITERIA if c in data.settings.criteria or c == 'energy']
    estimates = [validated(c, data, composite, left_out, predicted, report) for c in criteria]
    if not sound(faults):  # zeros of single recordings would compensate a common fault
        estimates = [replace(estimate, zeros=None) for estimate in estimates]

    common, own = [*notes, *still], data_checks([*training, *validation])
    if composite is not None:
        own = [*own, *remarks(composite, predicted, sound(faults), {fault.name for fault in faults})]
    assessed = [assess(each, data.settings, faults, common) for each in estimates[:-1]]
    assessed.append(assess(estimates[-1], data.settings, faults, [*common, *own]))
    return Identification(
        settings=data.settings,
        estimates=tuple(assessed),
        faults=faults,
        interval=float(np.median([m.interval for m in data.motions])),
        smoothing=data.smoothing,
        validation=_validation(len(predicted), len(left_out), len(data.motions)),
        link_length=link_length(data.motions, estimates[-1].model, estimates[-1].effort.delay),
        effects=() if composite is None else composite.effects,
        unmodelled=None if composite is None or composite.exact else composite.unexplained,
    )


def check(
    training: Sequence[Trajectory], validation: Sequence[Trajectory] = (), settings: Settings | None = None
) -> tuple[Fault, ...]:
    """Return the faults of the recordings' conventions, as :func:`identify` before the fit.

    Raises:
        TrajectoryError, ExcitationError: as :func:`identify`.
    """
    data, _ = _prepared(training, validation, settings or Settings())
    return detect_faults(data.motions, data.settings)


def _prepared(
    training: Sequence[Trajectory], validation: Sequence[Trajectory], settings: Settings
) -> tuple[TrainingData, list[Trajectory]]:
    """Require informative motion; return the smoothed training data, and the validation data with even stamps."""
    motions, others = ([evenly_stamped(motion.require_samples()) for motion in part] for part in (training, validation))
    require_excitation(motions, settings)
    return TrainingData.prepare(motions, settings.of_rig(motions)), others


def _fitted(data: TrainingData, faults: Sequence[Fault], report: Progress) -> Composite:
    """Minimise the likelihood. Raises TrajectoryError: no filter follows; a fault of the recordings is the cause."""
    try:
        return fit_composite(data, report, effects=data.settings.compensate and sound(faults))
    except TrajectoryError as error:
        if not faults:
            raise
        corrected = corrected_conversion(faults)
        words = {} if corrected is None else corrected.words()
        raise TrajectoryError('; '.join(fault.sentence for fault in faults), **words) from error


def _validation(predicted: int, parts: int, recordings: int) -> str:
    """Return the predicted data in words."""
    if predicted:
        return 'on data that was not used for estimation'
    if parts == recordings:
        return 'each recording predicted from the others'
    return f'each of {parts} blocks of time predicted from the others'
