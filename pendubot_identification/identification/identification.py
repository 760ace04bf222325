# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""An identification: its state after each stage, and its result."""

from __future__ import annotations

from dataclasses import dataclass

from pendubot_identification.arrays import Array
from pendubot_identification.level import Level
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.trajectory import Trajectory

from .catalogue import DetectedEffect, compensated
from .conventions import Fault
from .estimate import Estimate
from .fitting import Composite, TrainingData
from .options import CRITERIA
from .prediction import Fold
from .settings import Settings


@dataclass(frozen=True, slots=True)
class Identification:
    """Every criterion's answer, which one is published, and the findings on which its level rests.

    Attributes:
        settings: what was asked for.
        estimates: one a criterion: those that were asked for, and the paper's, energy.
        published: the number of the one that is published.
        faults: of the recordings.
        interval: between the training samples [s].
        smoothing: the window [s] that made the states.
        validation: which data are predicted, in words.
        link_length: P3 / P5 [m] of the elbow's own equation, and its standard error.
        effects: unmodelled effects, the accepted ones first.
        unmodelled: fraction of the innovations' variance of both joints that quantization does not explain; None where
            the likelihood was not minimised, or nothing but quantization is left.
        uncorrected: the identification before the first correction of the recordings; None without one.
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
    uncorrected: Identification | None = None

    @property
    def best(self) -> Estimate:
        """The estimate that is published."""
        return self.estimates[self.published]

    @property
    def level(self) -> Level:
        """How far to trust them."""
        return self.best.level

    @property
    def warnings(self) -> tuple[str, ...]:
        """Why, in sentences for the user."""
        return self.best.warnings

    def compensated(self, motion: Motion) -> Motion:
        """Return a motion with the torques that act, by the accepted effects."""
        return compensated(motion, self.effects, self.best.effort.delay)


@dataclass(frozen=True, slots=True)
class Run:
    """The state of an identification after a stage.

    Attributes:
        settings: what was asked for.
        data: the training recordings.
        validation_motions: motions for validation alone.
        notes: warnings that came with the data, for every criterion.
        remarks: warnings for the published one.
        faults: of the recordings.
        composite: the likelihood's answer.
        folds: the training data, of which each part is predicted from the rest.
        estimates: one a criterion.
    """

    settings: Settings
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
        """Those that were asked for, and the paper's."""
        return [c for c in CRITERIA if c in self.settings.criteria or c == 'energy']

    @property
    def sound(self) -> bool:
        """Whether signs, order and zeros are right."""
        return not any(f.level is Level.ERROR and f.name not in ('delay', 'motion', 'offset') for f in self.faults)

    @property
    def validation(self) -> str:
        """Which data are predicted, in words."""
        if self.validation_motions:
            return 'on data that was not used for estimation'
        if len(self.folds) == len(self.data.motions):
            return 'each recording predicted from the others'
        return f'each of {len(self.folds)} blocks of time predicted from the others'
