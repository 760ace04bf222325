# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Prediction errors of parameters: simulations from measured states, compared with the measured motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.arrays import Array
from pendubot_identification.criteria.prediction_error import Simulations
from pendubot_identification.trajectories.motion import Motion

#: Prediction horizons [s].
HORIZONS = (0.1, 0.25, 0.5, 1.0)
#: Time from one start to the next [s].
STRIDE = 0.05
#: Number of horizons by which models and criteria are compared; at 1 s some motions are chaotic.
ASSESSED = 3
#: Largest error of a simulation, in standard deviations; all larger ones count as this.
LOST = 1e3


@dataclass(frozen=True, slots=True)
class Prediction:
    """Simulation errors at the end of each of :data:`HORIZONS`, over the states' standard deviations.

    Attributes:
        errors: root mean square by horizon and state q1 q2 q1' q2', shape (H, 4); NaN if all motions are shorter.
        still: the same for a prediction of constant state, shape (H, 4).
        starts: number of simulations of each horizon, shape (H,).
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
        """The same for a prediction of constant state, shape (H,)."""
        return np.asarray(np.sqrt((self.still**2).mean(axis=1)))

    @property
    def fit(self) -> Array:
        """Fit of each state in per cent, 100 (1 - error / standard deviation), shape (H, 4)."""
        return 100 * (1 - self.errors)

    @classmethod
    def none(cls) -> Prediction:
        """Return a prediction without simulations."""
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
    """A part of a recording that is predicted from the rest of the data.

    Attributes:
        held_out: the part.
        recording: index of its recording.
        rest: the other data.
    """

    held_out: Motion
    recording: int
    rest: tuple[Motion, ...]


def folds(motions: Sequence[Motion], several: int = 3, blocks: int = 5) -> list[Fold]:
    """Return a fold for each recording or, with fewer than ``several``, for each of about five blocks of time."""
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
        motions: to be predicted.
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
