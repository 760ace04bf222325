# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Which model: cross-validation over recordings, or blocks of time, of the training data alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.trajectories.motion import Motion

from .prediction import JUDGED, Prediction

Array = NDArray[np.float64]

#: Recordings that are left out in turn; fewer of them are cut into blocks of time.
FEWEST_RECORDINGS = 3
BLOCKS = 5


@dataclass(frozen=True, slots=True)
class Fold:
    """What is left out, and what predicts it.

    Attributes:
        name: of what is left out.
        held_out: the motion that is left out.
        training: all the others.
    """

    name: str
    held_out: Motion
    training: tuple[Motion, ...]


@dataclass(frozen=True, slots=True)
class ModelScore:
    """How a model predicts what it has not seen.

    Attributes:
        model: the name of one of :data:`.parameters.MODELS`.
        predictions: of every fold.
        error: root mean square error at 0.1, 0.25 and 0.5 s over all folds, in standard deviations, shape (3,).
        loss: mean logarithm of the errors, by which models are compared; the mean over folds.
        behind: how much more that is than the best model's, and the standard error of that difference over folds; NaN
            of a single fold.
        exact: whether the model leaves nothing but the encoders' rounding.
    """

    model: str
    predictions: tuple[Prediction, ...]
    error: Array
    loss: float
    behind: tuple[float, float]
    exact: bool = False


def folds(motions: Sequence[Motion]) -> list[Fold]:
    """Leave out each recording in turn or, of one or two, each of five blocks of time."""
    if len(motions) >= FEWEST_RECORDINGS:
        parts = [(m.name, m, m) for m in motions]
    else:
        parts = []
        blocks = BLOCKS if len(motions) == 1 else (BLOCKS + 1) // 2
        for m in motions:
            edges = np.linspace(m.start, m.end, blocks + 1)
            for low, high in pairwise(edges):
                parts.append((f'{m.name}, {low - m.start:.2f} to {high - m.start:.2f} s', m.part(low, high), m))
    result = []
    for name, held_out, whole in parts:
        rest = [m for m in motions if m is not whole]
        if held_out is not whole:
            sides = (whole.start, held_out.start), (held_out.end, whole.end)
            rest += [whole.part(low, high) for low, high in sides if high > low]
        result.append(Fold(name, held_out, tuple(rest)))
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
        scores.append(ModelScore(model, tuple(parts), Prediction.pool(parts).error[:JUDGED], float(loss), behind))
    chosen = exact or next(s.model for s in scores if s.behind[0] <= np.nan_to_num(s.behind[1]))
    return chosen, [replace(s, exact=s.model == exact) for s in scores]
