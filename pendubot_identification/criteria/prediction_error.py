# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Open-loop prediction errors: recordings are simulated from their smoothed states on, again and again.

As a criterion, with the composite likelihood's quadratic approximation as prior:

    J = (theta - theta1)' A (theta - theta1) / 2 + g' (theta - theta1) + kappa eps sum[ log S + (r / S)^2 / 2 ]

r is the error of each state after each horizon, S its scale, the product of one number for each state and horizon and
one for each recording, so that one odd recording cannot dominate. eps counts overlapping simulations as independent
once each longest horizon.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.errors import TrajectoryError
from pendubot_identification.model.parameters import Bounds
from pendubot_identification.model.rollout import roll, sensitivities
from pendubot_identification.trajectories.motion import Motion

from .likelihood import Readings, bounded_step, physical

Array = NDArray[np.float64]

#: Runge-Kutta step [s], which divides all horizons.
STEP = 0.005


@dataclass(frozen=True, slots=True)
class PredictionSettings:
    """What is simulated, and how much it counts.

    Attributes:
        horizons: [s].
        stride: from one start to the next [s].
        weight: kappa; a magnitude adjustment of the composite likelihood gives .07 to .8, median .27.
        shrinkage: so many independent simulations hold each recording's scale at 1.
        alternations: of scales and parameters.
    """

    horizons: tuple[float, ...] = (0.1, 0.25, 0.5)
    stride: float = 0.05
    weight: float = 0.2
    shrinkage: float = 20.0
    alternations: int = 5


@dataclass(frozen=True, slots=True)
class Simulations:
    """L simulations from smoothed states.

    Attributes:
        recording: the number of the recording of each, shape (L,).
        t: when each begins [s], shape (L,).
        start: states there, shape (4, L).
        end: smoothed states at every horizon, shape (H, 4, L).
        tau: mean torques of every step, shape (2, K, L).
        at: the step at which each horizon ends.
    """

    recording: NDArray[np.intp]
    t: Array
    start: Array
    end: Array
    tau: Array
    at: tuple[int, ...]

    @classmethod
    def of(
        cls, motions: Sequence[Motion], delay: float, offset: Array, horizons: Sequence[float], stride: float
    ) -> Simulations:
        """Cut all simulations whose longest horizon lies within a recording."""
        at = tuple(round(horizon / STEP) for horizon in horizons)
        numbers, times, starts, ends, torques = [], [], [], [], []
        shift = np.array([*offset, 0.0, 0.0])[:, None]
        for number, motion in enumerate(motions):
            first, last = motion.start + max(delay, 0.0), motion.end + min(delay, 0.0) - max(horizons)
            t = np.arange(first, last, stride)
            numbers.append(np.full(len(t), number))
            times.append(t)
            starts.append(motion.states(t) - shift)
            ends.append([motion.states(t + horizon) - shift for horizon in horizons])
            torques.append(motion.torques(t - delay, STEP, max(at)))
        return cls(
            np.concatenate(numbers),
            np.concatenate(times),
            np.concatenate(starts, axis=1),
            np.concatenate([np.array(e).reshape(len(at), 4, -1) for e in ends], axis=2),
            np.concatenate(torques, axis=2),
            at,
        )

    def errors(self, theta: Array) -> tuple[Array, Array]:
        """Return the errors at every horizon, shape (H, 4, L), and the states of all steps."""
        states = roll(theta, self.start, self.tau, STEP)
        return states[list(self.at)] - self.end, states

    def derivatives(self, theta: Array, states: Array) -> Array:
        """Return the errors' derivatives by theta, shape (H, 4, D, L)."""
        every = int(np.gcd.reduce(self.at))
        by = sensitivities(theta, states, self.tau, STEP, every)
        return np.asarray(by[[k // every for k in self.at]][:, :, 4:])


@dataclass(frozen=True, slots=True)
class PredictionFit:
    """Where the criterion is least.

    Attributes:
        theta: shape (D,).
        information: of the prior and the errors, shape (D, D).
        slopes: of each block's errors, shape (B, D).
        informations: likewise, shape (B, D, D).
        scale: S of each state and horizon, shape (H, 4).
        factor: S of each recording, shape (R,).
    """

    theta: Array
    information: Array
    slopes: Array
    informations: Array
    scale: Array
    factor: Array


@np.errstate(all='ignore')
def refine(
    motions: Sequence[Motion],
    theta: Array,
    prior: Array,
    pull: Array,
    delay: float,
    offset: Array,
    bounds: Bounds,
    readings: Readings,
    settings: PredictionSettings | None = None,
) -> PredictionFit:
    """Minimise the prediction errors near the composite likelihood's answer.

    Raises:
        TrajectoryError: all recordings are shorter than the longest horizon, or a simulation is lost.

    Args:
        motions: R recordings.
        theta: theta1, shape (D,).
        prior: A, shape (D, D).
        pull: g, shape (D,).
        delay: of the effort [s].
        offset: of the positions [rad], shape (2,).
        bounds: of theta.
        readings: of the same recordings, for their blocks of time.
        settings: see :class:`PredictionSettings`.
    """
    settings = settings or PredictionSettings()
    simulations = Simulations.of(motions, delay, offset, settings.horizons, settings.stride)
    if not len(simulations.t):
        raise TrajectoryError(f'all recordings are shorter than {max(settings.horizons):g} s; choose longer windows')
    count, number, blocks = len(motions), simulations.recording, len(readings.owner)
    block = np.concatenate([readings.block_of(k, simulations.t[number == k]) for k in range(count)])
    duration = sum(m.end - m.start for m in motions)
    eps = settings.weight * duration / max(settings.horizons) / max(len(number), 1)
    own = np.bincount(number, minlength=count) * eps / settings.weight  # independent simulations of each recording
    first, factor, sought = theta, np.ones(count), bounds.lower < bounds.upper

    def scaled(r: Array) -> tuple[Array, Array]:
        factor, scale = np.ones(count), np.ones(r.shape[:2])
        for _ in range(settings.alternations):
            scale = np.maximum(np.sqrt(((r / factor[number]) ** 2).mean(axis=2)), 1e-12)
            z = ((r / scale[:, :, None]) ** 2).mean(axis=(0, 1))
            mean = np.bincount(number, z, minlength=count) / np.maximum(np.bincount(number, minlength=count), 1)
            factor = np.sqrt((own * mean + settings.shrinkage) / (own + settings.shrinkage))
        return scale, factor

    def value(theta: Array, scale: Array, factor: Array) -> tuple[float, Array, Array]:
        r, states = simulations.errors(theta)
        z = r / scale[:, :, None] / factor[number]
        step = theta - first
        cost = float(step @ prior @ step / 2 + pull @ step + eps / 2 * (z * z).sum())
        return (cost if np.isfinite(cost) else np.inf), z, states

    def derived(theta: Array, z: Array, states: Array) -> tuple[Array, Array]:
        by = simulations.derivatives(theta, states) / scale[:, :, None, None] / factor[number]
        slopes, informations = np.zeros((blocks, len(theta))), np.zeros((blocks, len(theta), len(theta)))
        edges = np.searchsorted(block, np.arange(blocks + 1))
        for k, own in enumerate(map(slice, edges, edges[1:])):
            rows = np.moveaxis(by[..., own], 2, -1).reshape(-1, len(theta))
            slopes[k] = eps * rows.T @ z[..., own].reshape(-1)
            informations[k] = eps * rows.T @ rows
        if not np.isfinite(informations).all():
            raise TrajectoryError(f'{motions[0].name}: no simulation follows this motion with these parameters')
        return slopes, informations

    for _ in range(settings.alternations):
        r, _ = simulations.errors(theta)
        scale, factor = scaled(r)
        damping = 1e-3
        cost, z, states = value(theta, scale, factor)
        moved = 0.0
        for _ in range(3):
            slopes, informations = derived(theta, z, states)
            slope = slopes.sum(axis=0) + prior @ (theta - first) + pull
            information = informations.sum(axis=0) + prior
            for _ in range(8):
                step, gain = bounded_step(
                    information, slope, damping, bounds.lower - theta, bounds.upper - theta, sought
                )
                if gain < 1e-4:
                    break
                trial = value(theta + step, scale, factor) if physical(theta + step) else (np.inf, z, states)
                if trial[0] < cost:
                    break
                damping *= 10
            else:
                break
            if gain < 1e-4:
                break
            moved += cost - trial[0]
            theta, (cost, z, states) = theta + step, trial
            damping /= 5
        if moved < 1e-2:
            break
    slopes, informations = derived(theta, z, states)
    return PredictionFit(theta, informations.sum(axis=0) + prior, slopes, informations, scale, factor)
