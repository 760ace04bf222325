# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""How well parameters predict a motion: simulated from a measured state on, and held against what then happened."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.arrays import Array
from pendubot_identification.criteria.prediction_error import Simulations
from pendubot_identification.trajectories.motion import Motion

#: Seconds ahead.
HORIZONS = (0.1, 0.25, 0.5, 1.0)
#: Seconds from one start to the next.
STRIDE = 0.05
#: The horizons by which models and criteria are compared; at 1 s some motions are chaotic.
ASSESSED = 3
#: A simulation this many standard deviations off is as good as any other that is lost.
LOST = 1e3


@dataclass(frozen=True, slots=True)
class Prediction:
    """Simulation errors at the end of each of :data:`HORIZONS`, over the states' standard deviations.

    Attributes:
        errors: root mean square by horizon and state q1 q2 q1' q2', shape (H, 4); NaN where no motion is that long.
        still: the same for a rig that keeps its state, shape (H, 4).
        starts: how many simulations each horizon had, shape (H,).
    """

    errors: Array
    still: Array
    starts: NDArray[np.intp]

    @property
    def error(self) -> Array:
        """Root mean square over the four states, shape (H,)."""
        return np.asarray(np.sqrt((self.errors**2).mean(axis=1)))

    @property
    def persistence(self) -> Array:
        """The same of a rig that keeps its state, shape (H,)."""
        return np.asarray(np.sqrt((self.still**2).mean(axis=1)))

    @property
    def fit(self) -> Array:
        """Fit of each state in per cent, 100 (1 - error / standard deviation), shape (H, 4)."""
        return 100 * (1 - self.errors)

    @property
    def loss(self) -> float:
        """One number to compare by: the mean logarithm of the error up to 0.5 s; NaN without any."""
        errors = self.error[:ASSESSED]
        errors = errors[np.isfinite(errors)]
        return float(np.log(np.maximum(errors, 1e-12)).mean()) if errors.size else np.nan

    @classmethod
    def none(cls) -> Prediction:
        """Return the prediction of nothing."""
        nothing = np.full((len(HORIZONS), 4), np.nan)
        return cls(nothing, nothing.copy(), np.zeros(len(HORIZONS), dtype=np.intp))

    @classmethod
    def pool(cls, parts: Sequence[Prediction]) -> Prediction:
        """Return the errors of several predictions together."""
        starts = np.array([part.starts for part in parts])
        share = starts / np.maximum(starts.sum(axis=0), 1)

        def mean(each: Sequence[Array]) -> Array:
            pooled = np.sqrt(np.einsum('ph,phs->hs', share, np.nan_to_num(each) ** 2))
            return np.where(starts.sum(axis=0)[:, None] > 0, pooled, np.nan)

        return cls(mean([p.errors for p in parts]), mean([p.still for p in parts]), starts.sum(axis=0))


@dataclass(frozen=True, slots=True)
class Fold:
    """Parts of recordings that are left out and predicted from the rest.

    Attributes:
        held_out: the part.
        recording: the number of its recording.
        rest: all else.
    """

    held_out: Motion
    recording: int
    rest: tuple[Motion, ...]


def folds(motions: Sequence[Motion], several: int = 3, blocks: int = 5) -> list[Fold]:
    """Leave out each recording in turn or, of fewer than ``several``, each of about five blocks of time."""
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


def predict(motions: Sequence[Motion], theta: Array, delay: float, scale: Array) -> Prediction:
    """Simulate every motion from its smoothed state on, with its torque, every 50 ms.

    Args:
        motions: what is to be predicted.
        theta: shape (D,).
        delay: of the effort [s].
        scale: the states' standard deviations, shape (4,).
    """
    result = Prediction.none()
    longest = np.array([m.end - m.start - abs(delay) for m in motions])
    for row, horizon in enumerate(HORIZONS):
        long = [m for m, length in zip(motions, longest, strict=True) if length >= horizon + m.interval]
        if not long:
            continue
        simulations = Simulations.of(long, theta, delay, np.zeros(2), (horizon,), STRIDE)
        with np.errstate(all='ignore'):
            off = simulations.errors(theta)[0][0] / scale[:, None]
        off = np.where(np.isfinite(off), np.clip(off, -LOST, LOST), LOST)
        still = (simulations.start - simulations.end[0]) / scale[:, None]
        result.errors[row] = np.sqrt((off**2).mean(axis=1))
        result.still[row] = np.sqrt((still**2).mean(axis=1))
        result.starts[row] = len(simulations.t)
    return result


def state_scale(motions: Sequence[Motion]) -> Array:
    """Return the standard deviations of q1 q2 q1' q2' over all motions [rad, rad/s], shape (4,)."""
    states = [m.states(np.arange(m.start, m.end, 0.01)) for m in motions]
    return np.asarray(np.maximum(np.concatenate(states, axis=1).std(axis=1), 1e-9))
