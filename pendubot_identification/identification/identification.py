# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The objects that the stages of an identification take and return: its state, and its result."""

from __future__ import annotations

from dataclasses import dataclass

from pendubot_identification.arrays import Array
from pendubot_identification.level import Level
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.trajectory import Trajectory

from . import CRITERIA
from .conventions import Fault
from .effects import DetectedEffect, compensated
from .estimate import Estimate
from .fitting import Composite, TrainingData
from .settings import Settings
from .validation import Fold


@dataclass(frozen=True, slots=True)
class Identification:
    """The estimates of all criteria, and the findings for the level of the published one.

    Attributes:
        settings: of the identification.
        estimates: one for each requested criterion, and for energy.
        published: index of the published estimate.
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
    published: int
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
        return self.estimates[self.published]

    @property
    def level(self) -> Level:
        """The level of the published estimate."""
        return self.best.level

    @property
    def warnings(self) -> tuple[str, ...]:
        """The reasons of the level, in sentences for the user."""
        return self.best.warnings

    def compensated(self, motion: Motion) -> Motion:
        """Return a motion with the acting torques by the accepted effects."""
        return compensated(motion, self.effects, self.best.effort.delay)


@dataclass(frozen=True, slots=True)
class Run:
    """The state of an identification after a stage.

    Attributes:
        data: the training recordings, with the settings of the identification.
        validation_motions: motions for validation alone.
        notes: warnings of the data, for every criterion.
        remarks: warnings for the published criterion.
        faults: of the recordings.
        composite: the estimate by the likelihood.
        folds: parts of the training data, each predicted from the rest.
        estimates: one for each criterion.
    """

    data: TrainingData
    validation_motions: tuple[Trajectory, ...]
    notes: tuple[str, ...]
    remarks: tuple[str, ...]
    faults: tuple[Fault, ...] = ()
    composite: Composite | None = None
    folds: tuple[Fold, ...] = ()
    estimates: tuple[Estimate, ...] = ()

    @property
    def criteria(self) -> list[str]:
        """The requested criteria, and energy."""
        return [c for c in CRITERIA if c in self.data.settings.criteria or c == 'energy']

    @property
    def sound(self) -> bool:
        """Whether signs, order and zeros are right."""
        return not any(f.level is Level.ERROR and f.name not in ('delay', 'motion', 'offset') for f in self.faults)

    @property
    def validation(self) -> str:
        """The predicted data, in words."""
        if self.validation_motions:
            return 'on data that was not used for estimation'
        if len(self.folds) == len(self.data.motions):
            return 'each recording predicted from the others'
        return f'each of {len(self.folds)} blocks of time predicted from the others'
