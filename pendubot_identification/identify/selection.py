# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Which model: cross-validation over recordings, or blocks of time, of the training data alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.criteria.trajectory_fit import TrajectoryFit
from pendubot_identification.errors import TrajectoryError
from pendubot_identification.model.parameters import MODELS
from pendubot_identification.trajectories.motion import Motion

from .estimate import FEWEST_RECORDINGS, Progress, average
from .prediction import JUDGED, Prediction, predict
from .recipes import Data

Array = NDArray[np.float64]

#: So many blocks of time are left out in turn where recordings are too few for that.
BLOCKS = 5
#: In the order of trust, where criteria predict equally well.
TRUST = ('trajectory', 'weak', 'energy')
#: Whose answers are averaged where no model is exact and recordings are few; of three or more the last one's is taken.
#: By how much of the loss a model's weight falls to 1 / e. See docs/criteria.md for the rules that were compared.
AVERAGED, SOFTNESS = ('rotor', 'geared'), 0.2
#: A model that holds a smaller one cannot have a larger cost: where it has so many times it, another minimum was found.
WORSE = 1.05


class Fold(NamedTuple):
    """A motion that is left out, what it is called, and the others, which predict it."""

    name: str
    held_out: Motion
    training: tuple[Motion, ...]


@dataclass(frozen=True, slots=True)
class ModelScore:
    """How a model predicts what it has not seen.

    Attributes:
        model: the name of one of :data:`.parameters.MODELS`.
        error: root mean square error at 0.1, 0.25 and 0.5 s over all folds, in standard deviations, shape (3,).
        loss: mean logarithm of the errors, by which models are compared; the mean over folds.
        behind: how much more that is than the best model's, and the standard error of that difference over folds; NaN
            of a single fold.
        exact: whether the model leaves nothing but the encoders' rounding.
    """

    model: str
    error: Array
    loss: float
    behind: tuple[float, float]
    exact: bool


def folds(motions: Sequence[Motion]) -> list[Fold]:
    """Leave out each recording in turn or, of one or two, each of five blocks of time."""
    if len(motions) >= FEWEST_RECORDINGS:
        return [Fold(m.name, m, tuple(other for other in motions if other is not m)) for m in motions]
    result = []
    blocks = BLOCKS if len(motions) == 1 else (BLOCKS + 1) // 2
    for m in motions:
        for low, high in pairwise(np.linspace(m.start, m.end, blocks + 1)):
            rest = [other for other in motions if other is not m]
            rest += [m.part(begin, end) for begin, end in ((m.start, low), (high, m.end)) if end > begin]
            name = f'{m.name}, {low - m.start:.2f} to {high - m.start:.2f} s'
            result.append(Fold(name, m.part(low, high), tuple(rest)))
    return result


def compare_models(
    predictions: Mapping[str, Sequence[Prediction]], exact: str | None = None
) -> tuple[str, list[ModelScore]]:
    """Return the smallest model whose loss is within one standard error of the best one's, and all scores.

    The standard error is that of the difference between the two models over the folds: what all models find hard
    says nothing about which is better. A single fold has none: then the best model is chosen.

    Args:
        predictions: of every fold, by model, from the smallest model on.
        exact: a model that leaves nothing but the encoders' rounding: it is chosen, whatever the folds say.
    """
    losses = np.array([[p.loss for p in parts] for parts in predictions.values()])
    losses = losses[:, np.isfinite(losses).all(axis=0)]
    mean = losses.mean(axis=1) if losses.size else np.zeros(len(losses))
    best = int(np.argmin(mean))
    scores = []
    for (model, parts), row, loss in zip(predictions.items(), losses, mean, strict=True):
        more = row - losses[best]
        deviation = float(more.std(ddof=1) / np.sqrt(more.size)) if more.size > 1 else np.nan
        behind = float(loss - mean[best]), deviation
        scores.append(ModelScore(model, Prediction.pool(parts).error[:JUDGED], float(loss), behind, model == exact))
    return exact or next(s.model for s in scores if s.behind[0] <= np.nan_to_num(s.behind[1])), scores


class Comparison:
    """What parts of the training data are predicted to be from the rest of them; nothing is fitted twice."""

    def __init__(self, data: Data, progress: Progress) -> None:
        self._data, self._progress = data, progress
        self._folds = folds(data.motions)
        self._fits: dict[str, TrajectoryFit] = {}
        self._of_folds: dict[str, list[TrajectoryFit]] = {}
        self._answers: dict[tuple[str, str], list[tuple[Array, float] | None]] = {}
        self.deciding = next(c for c in TRUST if c in data.settings.criteria)

    @property
    def method(self) -> str:
        """In words, what predicts what."""
        if len(self._folds) == len(self._data.motions):
            return 'each recording predicted from the others'
        return f'each of {len(self._folds)} blocks of time predicted from the others'

    def choose(self) -> tuple[tuple[str, ...], list[ModelScore]]:
        """Return the model to take, or those whose answers are averaged, and what was compared.

        A model that leaves nothing but the encoders' rounding needs no comparison: the smallest of them is the rig's.
        Only the trajectory criterion tells that. Of rigs of which none is exact it takes the largest, or averages the
        two largest where few recordings tell too little of its parameters.
        """
        if self.deciding != 'trajectory':
            chosen, scores = compare_models({model: self.predicted(self.deciding, {model: 1.0}) for model in MODELS})
            return (chosen,), scores
        if (model := self._exact()) is not None:
            return (model,), compare_models({model: self.predicted(self.deciding, {model: 1.0})}, exact=model)[1]
        models = AVERAGED if len(self._data.groups) < FEWEST_RECORDINGS else AVERAGED[-1:]
        return models, compare_models({model: self.predicted(self.deciding, {model: 1.0}) for model in models})[1]

    def _exact(self) -> str | None:
        """Return the smallest model that leaves nothing but the encoders' rounding; None where none does."""

        def is_exact(model: str) -> bool:
            return self._data.exact(model, self.fit(model)) is not None

        smallest, *between, largest = MODELS
        if is_exact(smallest):
            return smallest
        # The largest holds all others: where it leaves more, so do they.
        return next((m for m in between if is_exact(m)), largest) if is_exact(largest) else None

    def weights(self, criterion: str, models: Sequence[str]) -> dict[str, float]:
        """Return by how much each model's answer counts in a criterion's average.

        A choice by cross-validation over four or five recordings is decided by an odd one of them; weights that fall
        with the loss are not, and what one of two models errs the other half makes up for.
        """
        if len(models) == 1:
            return {models[0]: 1.0}
        losses = [[p.loss for p in self.predicted(criterion, {model: 1.0})] for model in models]
        told = np.array(losses)[:, np.isfinite(losses).all(axis=0)]
        weight = np.exp(-(told.mean(axis=1) if told.size else np.zeros(len(models))) / SOFTNESS)
        return dict(zip(models, (weight / weight.sum()).tolist(), strict=True))

    def predicted(self, criterion: str, models: Mapping[str, float]) -> list[Prediction]:
        """Return the prediction of every fold by the average of models' answers by these weights."""
        found, weights = [], list(models.values())
        for k, fold in enumerate(self._folds):
            answers = [self._answered(criterion, model)[k] for model in models]
            known = [a for a in answers if a is not None]
            if len(known) < len(answers):
                found.append(Prediction.none())
                continue
            theta = average([theta for theta, _ in known], weights)
            delay = float(np.dot(weights, [delay for _, delay in known]))
            found.append(predict([fold.held_out], theta, delay, self._data.scale))
        return found

    def _answered(self, criterion: str, model: str) -> list[tuple[Array, float] | None]:
        """Return theta and delay without each fold; None of what is left is too short to be learned from."""
        if (criterion, model) not in self._answers:
            found = self._answers[criterion, model] = []
            for k, fold in enumerate(self._folds):
                self._progress(f'{criterion}, {model} model: cross-validation', k, len(self._folds), np.nan)
                rest = self._data.only(fold.training)
                try:
                    if criterion == 'trajectory':
                        fit = rest.fit(model, near=self.fit(model))
                        self._of_folds.setdefault(model, []).append(fit)
                        found.append((fit.fit.theta, fit.fit.delay))
                    else:
                        found.append(rest.solve_linear(criterion, model, self._data.linear(criterion, model)))
                except TrajectoryError:
                    found.append(None)
        return self._answers[criterion, model]

    def fit(self, model: str) -> TrajectoryFit:
        """Return the fit of all motions, from which those of the folds start."""
        if model not in self._fits:
            found = self._data.fit(model, like=self._data.linear('weak', 'rotor'))
            smaller = [self._fits[m] for m in MODELS if m in self._fits and MODELS[m] < MODELS[model]]
            if smaller and WORSE * smaller[-1].fit.cost < found.fit.cost:
                found = self._data.fit(model, near=smaller[-1])
            self._fits[model] = found
        return self._fits[model]

    def without(self, model: str) -> list[TrajectoryFit]:
        """Return the fits that leave out each recording, where these were the folds."""
        return self._of_folds.get(model, []) if self._folds[0].held_out is self._data.motions[0] else []
