# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""From motions to an identification: prepare, check conventions, fit, validate, assess."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pendubot_identification.arrays import Array
from pendubot_identification.criteria.energy import energy_regression
from pendubot_identification.level import Level
from pendubot_identification.trajectories.data_checks import data_checks
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.signals import evenly_stamped
from pendubot_identification.trajectories.trajectory import Trajectory

from . import CRITERIA
from .conventions import Fault, detect_faults, link_length, sound
from .effects import DetectedEffect
from .estimate import Estimate, Progress
from .fitting import TrainingData
from .selection import fitted
from .settings import Settings
from .validation import Validation, assess, basis, faults_left, folds, remarks, require_excitation, stillness, validated


@dataclass(frozen=True, slots=True)
class Identification:
    """The estimates of all criteria, and the findings for the level of the published one."""

    settings: Settings  #: of the identification.
    #: one for each requested criterion, and for energy; the last, most accurate one is published.
    estimates: tuple[Estimate, ...]
    faults: tuple[Fault, ...]  #: of the recordings.
    interval: float  #: sampling interval of the training data [s].
    smoothing: float  #: smoothing window of the states [s].
    validation: str  #: the predicted data, in words.
    link_length: tuple[float, float]  #: P3 / P5 [m] by the elbow's equation, and its standard error.
    effects: tuple[DetectedEffect, ...] = ()  #: unmodelled effects, the accepted ones first.
    #: fraction of the innovations' variance of both joints that quantization does not explain; None without the
    #: likelihood, or if the residual is at the quantization level.
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
    prepared, others = prepare(training, validation, settings or Settings())
    report('checking signs, zeros and stamps', 0, 0, math.nan)
    detected = detect_faults(prepared.excerpt().motions, prepared.settings)
    composite = fitted(prepared, detected, report) if 'likelihood' in prepared.settings.criteria else None
    data = prepared if composite is None else composite.data
    faults = detected if composite is None else faults_left(detected, composite)

    predicted = [Motion.prepare(motion, data.smoothing, data.hold) for motion in others if not stillness(motion)]
    left_out = [] if predicted else folds(data.motions)
    criteria = [c for c in CRITERIA if c in data.settings.criteria or c == 'energy']
    # Zeros of single recordings would compensate a common fault.
    fits = Validation.of(predicted, composite) if composite and sound(faults, composite.offsets) else None
    zeros = None if fits is None else fits.zeros
    estimates = [validated(c, data, composite, left_out, predicted, zeros, report) for c in criteria]

    common, own = [*notes, *filter(None, map(stillness, others))], data_checks([*training, *validation])
    if composite is not None:
        own += remarks(composite, fits, faults)
    published = estimates[-1]
    assessed = [assess(each, data.settings, faults, common) for each in estimates if each is not published]
    assessed.append(assess(published, data.settings, faults, [*common, *own]))
    return Identification(
        settings=data.settings,
        estimates=tuple(assessed),
        faults=faults,
        interval=float(np.median([m.interval for m in data.motions])),
        smoothing=data.smoothing,
        validation=basis(len(predicted), len(left_out), len(data.motions)),
        link_length=link_length(data.motions, published.model, published.effort.delay),
        effects=() if composite is None else composite.effects,
        unmodelled=None if composite is None or composite.exact else composite.unexplained,
    )


def prepare(
    training: Sequence[Trajectory], validation: Sequence[Trajectory], settings: Settings
) -> tuple[TrainingData, list[Trajectory]]:
    """Require informative and plausible motion; return smoothed training, and validation data with even stamps.

    Raises:
        TrajectoryError, ExcitationError: as :func:`identify`.
    """
    motions, others = ([evenly_stamped(motion.require_samples()) for motion in part] for part in (training, validation))
    require_excitation(motions, settings)
    data = TrainingData.prepare(motions, settings.of_rig(motions))
    for motion in others:
        if not stillness(motion):
            energy_regression(motion, settings.sliding, data.smoothing)  # refuses a jump or gap before the long fit
    return data, others
