# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Open-loop prediction errors of many simulations that start at smoothed states of recordings.

As a criterion, with the composite likelihood's quadratic approximation as prior:

    J = (theta - theta1)' A (theta - theta1) / 2 + g' (theta - theta1) + kappa eps sum[ log S + (r / S)^2 / 2 ]

r is the error of each state after each horizon. S is its scale: a factor of each state and horizon times a factor of
each recording, so that no recording dominates. eps is the number of independent simulations, one per longest horizon,
over the number of overlapping ones.

As a measure of estimates, :func:`predict` divides the errors by the standard deviations of the states.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pendubot_identification.arrays import Array
from pendubot_identification.errors import TrajectoryError
from pendubot_identification.model.parameters import Bounds, Parameters, repaired
from pendubot_identification.model.rollout import roll, sensitivities
from pendubot_identification.model.simulation import substeps
from pendubot_identification.trajectories.motion import Motion, root_mean_square_torque

from .likelihood import FilterData, bounded_step

#: Runge-Kutta step [s], a divisor of all horizons; stiff friction needs substeps.
STEP = 0.01
#: Prediction horizons [s].
HORIZONS = (0.1, 0.25, 0.5, 1.0)
#: Time from one start to the next [s].
STRIDE = 0.05
#: Number of horizons by which models and criteria are compared; at 1 s some motions are chaotic.
ASSESSED = 3
#: Largest error of a simulation, in standard deviations; all larger ones count as this.
LOST = 1e3


@dataclass(frozen=True, slots=True)
class PredictionSettings:
    """The simulations, and their weight beside the prior."""

    horizons: tuple[float, ...] = HORIZONS[:ASSESSED]  #: prediction horizons [s].
    stride: float = STRIDE  #: time from one start to the next [s].
    weight: float = 0.2  #: kappa; a magnitude adjustment of the composite likelihood gives .07 to .8, median .27.
    shrinkage: float = 20.0  #: weight of a prior scale of 1 for each recording, in independent simulations.
    alternations: int = 5  #: largest number of alternations between scales and parameters.
    steps: int = 3  #: largest number of Gauss-Newton steps in an alternation.
    tolerance: float = 0.01  #: least decrease of J in an alternation before another one.


@dataclass(frozen=True, slots=True)
class Simulations:
    """L simulations from smoothed states."""

    recording: NDArray[np.intp]  #: index of the recording of each simulation, shape (L,).
    t: Array  #: time of each start [s], shape (L,).
    start: Array  #: initial states, shape (4, L).
    end: Array  #: smoothed states at every horizon, shape (H, 4, L).
    substeps: int  #: number of parts of :data:`STEP`.
    tau: Array  #: mean torques of every step, shape (2, K, L).
    change: Array  #: half of the torques' change within each step, shape (2, K, L).
    at: tuple[int, ...]  #: number of steps of each horizon.

    @classmethod
    def of(
        cls,
        motions: Sequence[Motion],
        theta: Array,
        delay: float,
        offset: Array,
        horizons: Sequence[float],
        stride: float,
    ) -> Simulations:
        """Prepare all simulations whose horizons lie within a recording, with substeps for theta, shape (D,)."""
        parts = substeps(Parameters.from_vector(theta), root_mean_square_torque(motions), STEP)
        at = tuple(round(horizon / STEP) * parts for horizon in horizons)
        numbers, times, starts, ends, torques = [], [], [], [], []
        steps = STEP / parts * np.arange(max(at) + 1)[:, None]
        shifts = np.pad(np.broadcast_to(offset, (len(motions), 2)), ((0, 0), (0, 2)))[:, :, None]
        for number, (motion, shift) in enumerate(zip(motions, shifts, strict=True)):
            first, last = motion.start + max(delay, 0.0), motion.end + min(delay, 0.0) - max(horizons)
            t = np.arange(first, last, stride)
            numbers.append(np.full(len(t), number))
            times.append(t)
            starts.append(motion.states(t) - shift)
            ends.append([motion.states(t + horizon) - shift for horizon in horizons])
            torques.append(motion.torques(t - delay + steps))
        tau, change = (np.moveaxis(np.concatenate(each, axis=1), -1, 0) for each in zip(*torques, strict=True))
        return cls(
            np.concatenate(numbers),
            np.concatenate(times),
            np.concatenate(starts, axis=1),
            np.concatenate([np.array(e).reshape(len(at), 4, -1) for e in ends], axis=2),
            parts,
            tau,
            change,
            at,
        )

    def errors(self, theta: Array) -> tuple[Array, Array]:
        """Return the errors at every horizon, shape (H, 4, L), and the states of all steps."""
        states = roll(theta, self.start, self.tau, STEP / self.substeps, self.change)
        return states[list(self.at)] - self.end, states

    def derivatives(self, theta: Array, states: Array) -> Array:
        """Return the errors' derivatives by theta, shape (H, 4, D, L)."""
        every = int(np.gcd.reduce(self.at))
        by = sensitivities(theta, states, self.tau, STEP / self.substeps, every, self.change)
        return np.asarray(by[[k // every for k in self.at]][:, :, 4:])


@dataclass(frozen=True, slots=True)
class PredictionFit:
    """The minimum of the criterion."""

    theta: Array  #: shape (D,).
    information: Array  #: of the prior and the errors, shape (D, D).
    slopes: Array  #: of each block's errors, shape (B, D).
    informations: Array  #: of each block's errors, shape (B, D, D).
    scale: Array  #: factor of S of each state and horizon, shape (H, 4).
    factor: Array  #: factor of S of each recording, shape (R,).


@np.errstate(all='ignore')
def refine(
    motions: Sequence[Motion],
    theta: Array,
    prior: Array,
    pull: Array,
    delay: float,
    offset: Array,
    bounds: Bounds,
    filter_data: FilterData,
    settings: PredictionSettings | None = None,
) -> PredictionFit:
    """Minimise the prediction errors, with the composite likelihood as prior.

    Raises:
        TrajectoryError: all recordings are shorter than the longest horizon, or a simulation diverges.

    Args:
        motions: R recordings.
        theta: theta1, shape (D,).
        prior: A, shape (D, D).
        pull: g, shape (D,).
        delay: of the effort [s].
        offset: of the positions in each recording [rad], shape (R, 2); (2,) for all.
        bounds: of theta.
        filter_data: of the same recordings, which defines the blocks of time.
        settings: see :class:`PredictionSettings`.
    """
    settings = settings or PredictionSettings()
    simulations = Simulations.of(motions, theta, delay, offset, settings.horizons, settings.stride)
    if not len(simulations.t):
        raise TrajectoryError(f'all recordings are shorter than {max(settings.horizons):g} s; choose longer windows')
    criterion = _Criterion(simulations, theta, prior, pull, motions, filter_data, settings)
    for _ in range(settings.alternations):
        criterion.rescale(theta)
        theta, gained = criterion.descend(theta, bounds)
        if gained < settings.tolerance:
            break
    slopes, informations = criterion.derivatives(theta)
    information = informations.sum(axis=0) + prior
    return PredictionFit(theta, information, slopes, informations, criterion.scale, criterion.factor)


class _Criterion:
    """J of the simulations, with the scales of their errors, and its derivatives by B blocks of time."""

    def __init__(
        self,
        simulations: Simulations,
        first: Array,
        prior: Array,
        pull: Array,
        motions: Sequence[Motion],
        filter_data: FilterData,
        settings: PredictionSettings,
    ) -> None:
        self._simulations, self._settings = simulations, settings
        self._first, self._prior, self._pull = first, prior, pull
        number, self._blocks = simulations.recording, len(filter_data.owner)
        self._block = np.concatenate([filter_data.block_of(k, simulations.t[number == k]) for k in range(len(motions))])
        duration = sum(m.end - m.start for m in motions)
        self._eps = settings.weight * duration / max(settings.horizons) / len(simulations.t)  # kappa eps
        self.scale, self.factor = np.ones((len(settings.horizons), 4)), np.ones(len(motions))
        self._latest: tuple[Array, tuple[Array, Array]] | None = None

    def rescale(self, theta: Array) -> None:
        """Estimate the scales of the errors at theta."""
        settings, number, count = self._settings, self._simulations.recording, len(self.factor)
        r, simulations = self._errors(theta)[0], np.bincount(number, minlength=count)
        independent = simulations * self._eps / settings.weight
        self.factor = np.ones(count)
        for _ in range(settings.alternations):
            self.scale = np.maximum(np.sqrt(((r / self.factor[number]) ** 2).mean(axis=2)), 1e-12)
            z = ((r / self.scale[:, :, None]) ** 2).mean(axis=(0, 1))
            mean = np.bincount(number, z, minlength=count) / np.maximum(simulations, 1)
            self.factor = np.sqrt((independent * mean + settings.shrinkage) / (independent + settings.shrinkage))

    def _errors(self, theta: Array) -> tuple[Array, Array]:
        """Return the errors and states of all simulations, see :meth:`Simulations.errors`, once per theta."""
        if self._latest is None or (self._latest[0] != theta).any():
            self._latest = theta, self._simulations.errors(theta)
        return self._latest[1]

    def _scaled(self, theta: Array) -> tuple[Array, Array]:
        r, states = self._errors(theta)
        return r / self.scale[:, :, None] / self.factor[self._simulations.recording], states

    def value(self, theta: Array) -> float:
        """Return J without the logarithms; infinite if a simulation diverges."""
        z, step = self._scaled(theta)[0], theta - self._first
        cost = float(step @ self._prior @ step / 2 + self._pull @ step + self._eps / 2 * (z * z).sum())
        return cost if np.isfinite(cost) else np.inf

    def derivatives(self, theta: Array) -> tuple[Array, Array]:
        """Return slopes and information of each block's errors, shapes (B, D), (B, D, D)."""
        z, states = self._scaled(theta)
        by = self._simulations.derivatives(theta, states) / self.scale[:, :, None, None]
        by /= self.factor[self._simulations.recording]
        size, edges = len(theta), np.searchsorted(self._block, np.arange(self._blocks + 1))
        slopes, informations = np.zeros((self._blocks, size)), np.zeros((self._blocks, size, size))
        for k, lanes in enumerate(map(slice, edges, edges[1:])):
            rows = np.moveaxis(by[..., lanes], 2, -1).reshape(-1, size)
            slopes[k] = self._eps * rows.T @ z[..., lanes].reshape(-1)
            informations[k] = self._eps * rows.T @ rows
        if not np.isfinite(informations).all():
            raise TrajectoryError('no simulation follows this motion with these parameters; choose another window')
        return slopes, informations

    def descend(self, theta: Array, bounds: Bounds) -> tuple[Array, float]:
        """Return theta after a few Gauss-Newton steps, and their decrease of J."""
        free, least = bounds.lower < bounds.upper, 0.01 * self._settings.tolerance
        begin = cost = self.value(theta)
        damping = 1e-3
        for _ in range(self._settings.steps):
            slopes, informations = self.derivatives(theta)
            slope = slopes.sum(axis=0) + self._prior @ (theta - self._first) + self._pull
            information = informations.sum(axis=0) + self._prior
            for _ in range(8):
                step, gain = bounded_step(information, slope, damping, bounds.lower - theta, bounds.upper - theta, free)
                trial = repaired(theta + step)
                after = self.value(trial) if gain > least else np.inf
                if after < cost or gain <= least:
                    break
                damping *= 10
            if not after < cost:
                break
            theta, cost, damping = trial, after, damping / 5
        return theta, begin - cost


@dataclass(frozen=True, slots=True)
class Prediction:
    """Simulation errors at the end of each of :data:`HORIZONS`, over the states' standard deviations."""

    errors: Array  #: root mean square by horizon and state q1 q2 q1' q2', shape (H, 4); NaN if all motions are shorter.
    still: Array  #: the same for a prediction of constant state, shape (H, 4).
    starts: NDArray[np.intp]  #: number of simulations of each horizon, shape (H,).

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


def predict(
    motions: Sequence[Motion], theta: Array, delay: float, scale: Array, offset: ArrayLike = (0.0, 0.0)
) -> Prediction:
    """Simulate every motion from its smoothed state on, with its torque, every 50 ms.

    Args:
        motions: to be predicted.
        theta: shape (D,).
        delay: of the effort [s].
        scale: the states' standard deviations, shape (4,).
        offset: of all positions [rad], shape (2,).
    """
    result = Prediction.none()
    longest = np.array([m.end - m.start - abs(delay) for m in motions])
    for row, horizon in enumerate(HORIZONS):
        long = [m for m, length in zip(motions, longest, strict=True) if length >= horizon + m.interval]
        if not long:
            continue
        simulations = Simulations.of(long, theta, delay, np.asarray(offset), (horizon,), STRIDE)
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
