# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""From motions to parameters: prepare, choose the model, minimise every criterion, predict, judge."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.criteria.trajectory_fit import TrajectoryFit
from pendubot_identification.errors import TrajectoryError
from pendubot_identification.level import Level
from pendubot_identification.model.parameters import MODELS, Parameters
from pendubot_identification.trajectories.long import STRETCH, Long, Recording, held_parts
from pendubot_identification.trajectories.signals import evenly_stamped
from pendubot_identification.trajectories.suspicions import suspicions

from .agreement import contradictions
from .diagnosis import Fault, diagnose, link_length
from .estimate import Estimate, Progress
from .judgement import judge, require_excitation
from .linear import Linear, linear
from .prediction import Prediction, predict
from .recipes import Data, estimate, prepared
from .selection import Fold, ModelScore, compare_models, folds
from .settings import Settings

Array = NDArray[np.float64]

#: In the order of trust, where two criteria predict equally well; and how much better, in the logarithm of the error,
#: is better at all.
TRUST, BETTER = ('trajectory', 'weak', 'energy'), 0.02


@dataclass(frozen=True, slots=True)
class Identification:
    """Every criterion's answer, which one is published, and everything that says how far to trust it.

    Attributes:
        settings: what was asked for.
        estimates: one a criterion, in the order of the settings.
        published: the number of the one that predicts the validation data best.
        faults: of the recordings.
        models: what the choice of the model compared; empty where the model was given.
        comparison: in words, by which criterion and how.
        interval: between the training samples [s].
        smoothing: the window [s] that made the states.
        validation: what the predictions are of, in words.
        link_length: P3 / P5 [m] of the elbow's own equation, and its standard error.
    """

    settings: Settings
    estimates: tuple[Estimate, ...]
    published: int
    faults: tuple[Fault, ...]
    models: tuple[ModelScore, ...]
    comparison: str
    interval: float
    smoothing: float
    validation: str
    link_length: tuple[float, float]

    @property
    def best(self) -> Estimate:
        """The estimate that is published."""
        return self.estimates[self.published]

    @property
    def parameters(self) -> Parameters:
        """The published parameters."""
        return self.best.parameters

    @property
    def level(self) -> Level:
        """How far to trust them."""
        return self.best.level

    @property
    def warnings(self) -> tuple[str, ...]:
        """Why, in sentences for the user."""
        return self.best.warnings


def identify(
    training: Sequence[Recording],
    validation: Sequence[Recording] = (),
    settings: Settings | None = None,
    progress: Progress | None = None,
    notes: Sequence[str] = (),
) -> Identification:
    """Estimate the parameters of a rig from one or more of its motions.

    Of a long recording the quadratic criteria, energy and weak, take all, piece by piece. What is not quadratic (the
    choice of smoothing, delay, weights and model, the trajectory criterion, predictions, and what looks for faults)
    takes the stretches that stand for it. Where stamps of another are evidently false, even ones take their place.

    Args:
        training: the motions that estimate; they are pooled.
        validation: motions that only judge. Without any, each recording of several (or block of time of one or two)
            is predicted from the others in turn; the estimates themselves use all of them.
        settings: see :class:`Settings`.
        progress: called with what is being done, how much of it is done, of how much (0: not known), and the best J.
        notes: warnings that come with the data, such as a bag that was never closed.

    Raises:
        TrajectoryError: a motion that is too short or has gaps.
        ExcitationError: a motion from which some parameters cannot be told.
    """
    settings, progress = settings or Settings(), progress or _silent
    given = [*training, *validation]
    training, validation = (
        [r if isinstance(r, Long) else evenly_stamped(r) for r in part] for part in (training, validation)
    )
    held, held_judges = held_parts(training), held_parts(validation)
    for motion in (*held, *held_judges):
        motion.require_samples()
    if settings.sliding is not None and settings.sliding >= STRETCH and any(isinstance(m, Long) for m in training):
        raise TrajectoryError(
            f'the sliding window of {settings.sliding:g} s is too long for a long recording, which is looked at in '
            f'stretches of {STRETCH:g} s; choose a shorter one, or none'
        )
    require_excitation(held, settings)
    settings = settings.of_rig(held)
    notes = [*notes, *suspicions(given)]
    progress('preparing', 0, 0, np.nan)
    data = Data.prepare(training, settings)
    groups, whole_judges = prepared(validation, data.smoothing, data.hold)
    judges = [motion for group in groups for motion in group]
    comparison = _Comparison(data, progress)
    model, scores = comparison.choose() if settings.model == 'auto' else (settings.model, [])

    estimates = []
    for criterion in settings.criteria:
        answer = estimate(criterion, data, (judges, whole_judges), model, progress)
        parts = [predict([j], answer.theta, answer.effort.delay, data.scale) for j in judges]
        parts = parts or comparison.predicted(criterion, model)
        estimates.append(replace(answer, prediction=Prediction.pool(parts)))
    published = _best(estimates)
    best = estimates[published]
    progress('checking signs, zeros and stamps', 0, 0, best.J)
    length = link_length(data.motions, model, best.effort.delay)
    low, high = settings.delays
    declared = low if low == high else 0.0
    faults = diagnose(held, data.smoothing, data.hold, model, declared, settings.link_length)
    # Recordings that have a grave fault in common seem to contradict each other, too; but not for a delay, which is
    # estimated along.
    spoiled = any(f.level is Level.ERROR and f.name not in ('delay', 'motion') for f in faults)
    if len(data.groups) > 1 and settings.criteria != ('energy',) and not spoiled:
        notes += contradictions(data, model, comparison.fit(model), comparison.without(model))
    if faults:
        # Zeros of single recordings would make up for what is wrong with all of them.
        estimates = [replace(e, zeros=None) for e in estimates]
    lost = [
        f'{e.criterion} did not converge, so that it does not confirm what others say: start it elsewhere, or choose '
        'another part of the recording'
        for e in estimates
        if not e.converged
    ]
    return Identification(
        settings=settings,
        estimates=tuple(
            judge(e, settings, length, faults, [*notes, *lost] if e.converged else notes) for e in estimates
        ),
        published=published,
        faults=faults,
        models=tuple(scores),
        comparison=f'{comparison.deciding}, {comparison.method}' if scores else '',
        interval=float(np.median([m.interval for m in data.motions])),
        smoothing=data.smoothing,
        validation='on data that was not used for estimation' if judges else comparison.method,
        link_length=length,
    )


class _Comparison:
    """What is predicted of training data from the rest of it."""

    def __init__(self, data: Data, progress: Progress) -> None:
        self._data, self._progress = data, progress
        self._folds = folds(data.motions)
        self._whole: dict[str, TrajectoryFit] = {}
        self._fits: dict[str, list[TrajectoryFit]] = {}
        self._predictions: dict[tuple[str, str], list[Prediction]] = {}
        self._made: dict[tuple[str, str], Linear] = {}
        self.deciding = next(c for c in TRUST if c in data.settings.criteria)

    @property
    def method(self) -> str:
        """In words, what predicts what."""
        if len(self._folds) == len(self._data.motions):
            what = 'stretch' if self._data.long else 'recording'
            return f'each {what} predicted from the others'
        return f'each of {len(self._folds)} blocks of time predicted from the others'

    def choose(self) -> tuple[str, list[ModelScore]]:
        """Return the model that the most trusted of the criteria predicts with, and what was compared.

        A model that leaves nothing but the encoders' rounding needs no comparison: the smallest of them is the rig's.
        """
        compared: dict[str, list[Prediction]] = {}
        for model in MODELS:
            compared[model] = self.predicted(self.deciding, model)
            if self.deciding == 'trajectory' and self._data.exact(model, self.fit(model)) is not None:
                return compare_models(compared, exact=model)
        return compare_models(compared)

    def predicted(self, criterion: str, model: str) -> list[Prediction]:
        """Return the prediction of every fold."""
        if (criterion, model) not in self._predictions:
            predictions = []
            for k, fold in enumerate(self._folds):
                self._progress(f'{criterion}, {model} model: cross-validation', k, len(self._folds), np.nan)
                predictions.append(self._predicted(criterion, model, fold))
            self._predictions[criterion, model] = predictions
        return self._predictions[criterion, model]

    def without(self, model: str) -> list[TrajectoryFit]:
        """Return the fits that leave out each recording, where these were the folds."""
        return self._fits.get(model, []) if self._folds[0].held_out is self._data.motions[0] else []

    def _predicted(self, criterion: str, model: str, fold: Fold) -> Prediction:
        try:
            theta, delay = self._solve(criterion, model, fold)
        except TrajectoryError:
            return Prediction.none()  # what is left is too short to be learned from
        return predict([fold.held_out], theta, delay, self._data.scale)

    def _solve(self, criterion: str, model: str, fold: Fold) -> tuple[Array, float]:
        rest = self._data.only(fold.training)
        if criterion != 'trajectory':
            return rest.solve_linear(criterion, model, self._linear(criterion, model))
        found = rest.fit(model, near=self.fit(model))
        self._fits.setdefault(model, []).append(found)
        return found.fit.theta, found.fit.delay

    def _linear(self, criterion: str, model: str) -> Linear:
        """Return the criterion of all motions, whose delay those of the folds share."""
        if (criterion, model) not in self._made:
            self._made[criterion, model] = linear(criterion, self._data.motions, model, self._data.settings)
        return self._made[criterion, model]

    def fit(self, model: str) -> TrajectoryFit:
        """Return the fit of all motions, from which those of the folds start."""
        if model not in self._whole:
            found = self._data.fit(model, like=self._linear('weak', 'rotor'))
            smaller = [self._whole[m] for m in MODELS if m in self._whole and MODELS[m] < MODELS[model]]
            if smaller and 1.05 * smaller[-1].fit.cost < found.fit.cost:
                # A model that holds another one cannot be worse: a local minimum was found.
                found = self._data.fit(model, near=smaller[-1])
            self._whole[model] = found
        return self._whole[model]


def _best(estimates: Sequence[Estimate]) -> int:
    """Return the number of the estimate to publish.

    One that leaves nothing but the encoders' rounding predicts as well as can be measured: what then tells predictions
    apart is how well the states are known in which they start.
    """
    if exact := [k for k, e in enumerate(estimates) if e.exact]:
        return exact[0]
    losses = [e.prediction.loss if e.prediction is not None else np.nan for e in estimates]
    least = min((loss for loss in losses if np.isfinite(loss)), default=np.nan)
    good = [k for k, loss in enumerate(losses) if not loss > least + BETTER]
    return min(good, key=lambda k: TRUST.index(estimates[k].criterion))


def _silent(what: str, done: int, of: int, best: float) -> None:
    pass
