# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The trajectory criterion: recordings cut into segments, each simulated from an initial state of its own.

What is minimised is the simulation error, by multiple shooting (Bock 1983): J(theta, delay, x_1 .. x_S) = sum over
segments s of |residuals of s|^2, where x_s, a segment's initial state, is known only roughly and estimated along. Two
kinds of residuals:

- :class:`AgainstStates`: all four states over their standard deviation, against the smoothed recording; the initial
  state is held near the smoothed one. For rigs that the model does not describe to the last encoder count.
- :class:`AgainstPositions`: positions as they were recorded, initial states free. Where the model is exact and only
  the encoder errs, this is the maximum-likelihood estimate, the sharper the longer the segments.

Torques live on their own time, ``delay`` [s] before the motion that they cause: a segment that starts at torque time
T is compared with what was measured at T + delay.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.errors import TrajectoryError
from pendubot_identification.model.rollout import roll, sensitivities
from pendubot_identification.trajectories.motion import Motion

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

#: Longest Runge-Kutta step [s]; friction that turns its sign within 0.05 rad/s needs no shorter one on geared rigs.
LONGEST_STEP = 0.004
#: By this part of a sampling interval a segment may reach into the margins.
SLACK = 0.01
#: How far an initial state may lie from the smoothed one, in standard deviations of the states. Simulated segments that
#: start anywhere would fit anything; ones that must start where the smoother says would pass its errors on.
PRIOR = 0.12
#: A torque [N m] that changes a motion by little enough to be linear.
SMALL = 1e-6
#: Over so long [s] derivatives are smooth enough to be interpolated.
SMOOTH = 0.002
#: Between two times at which states are compared, about [s].
SPACING = 0.012
#: A motion is lost when a state is off by so many standard deviations, a position by so much [rad].
LOST_STATE, LOST_ANGLE = 1e5, 10.0


@dataclass(frozen=True, slots=True)
class Segments:
    """Pieces of recordings that are simulated side by side."""

    motions: tuple[Motion, ...]  #: the recordings.
    group: Indices  #: the number of each segment's recording, shape (L,), not decreasing.
    start: Array  #: the torque time [s] at which each begins, shape (L,).
    step: float  #: length of a simulation step [s].
    tau: Array  #: torques of every step [N m], shape (2, K, L).
    #: Unit torques of every step whose sizes are the last E of the unknowns theta, shape (E, 2, K, L).
    unit: Array

    @classmethod
    def cut(
        cls,
        motions: Sequence[Motion],
        length: float,
        stride: float,
        margin: float,
        longest_step: float = LONGEST_STEP,
    ) -> Segments:
        """Cut segments of ``length`` [s] every ``stride`` [s], none from recordings that are shorter.

        All are simulated with one step, the finest that any recording asks for and no longer than ``longest_step`` [s];
        torques that change within one act by their mean. ``margin`` [s] is left out at both ends of a recording, for
        the delay.

        Raises:
            TrajectoryError: all recordings are shorter than a segment, or a segment than a simulation step.
        """
        step = min(motion.interval / np.ceil(motion.interval / longest_step - 1e-9) for motion in motions)
        step *= max(1, int(longest_step / step + 0.1))
        steps = int(length / step + 1e-6)
        longest = max(motion.end - motion.start for motion in motions)
        if steps < 1:
            raise TrajectoryError(
                f'{motions[0].name}: {longest:.3f} s are too short to be cut into segments with their margins; choose '
                'a longer part of the recording'
            )
        starts = []
        for motion in motions:
            # Starts lie on samples, where the torque changes.
            first = np.ceil(margin / motion.interval - SLACK)
            last = np.floor((motion.end - motion.start - margin - steps * step) / motion.interval + SLACK)
            count = int((last - first) * motion.interval / stride + 1e-6) + 1 if last >= first else 0
            samples = first + np.rint(stride / motion.interval * np.arange(count))
            starts.append(motion.start + samples * motion.interval)
        if not any(map(len, starts)):
            raise TrajectoryError(
                f'{motions[0].name}: {longest:.3f} s are shorter than a simulated segment of {length:g} s with its '
                'margins; choose a longer part of the recording'
            )
        group = np.repeat(np.arange(len(motions)), [len(t) for t in starts])
        return cls._stepped(tuple(motions), group, np.concatenate(starts), step, steps)

    @classmethod
    def _stepped(cls, motions: tuple[Motion, ...], group: Indices, start: Array, step: float, steps: int) -> Segments:
        own = [(motion, start[group == number]) for number, motion in enumerate(motions)]
        tau = np.concatenate([motion.torques(t, step, steps) for motion, t in own], axis=2)
        unit = np.concatenate([motion.unit_torques(t, step, steps) for motion, t in own], axis=3)
        return cls(motions, group, start, step, tau, unit)

    def __len__(self) -> int:
        return len(self.start)

    @property
    def steps(self) -> int:
        """Simulation steps of a segment."""
        return int(self.tau.shape[1])

    def roll(self, theta: Array, state: Array) -> Array:
        """Simulate all from states, shape (4, L), by theta and the unit torques' sizes, (D + E,); see :func:`.roll`."""
        size = len(theta) - len(self.unit)
        return roll(theta[:size], state, self._acting(theta), self.step)

    def sensitivities(self, theta: Array, states: Array, every: int = 1) -> Array:
        """Return the states' derivative by initial state, theta and sizes, shape (K // every + 1, 4, 4 + D + E, L)."""
        result = sensitivities(theta[: len(theta) - len(self.unit)], states, self._acting(theta), self.step, every)
        if not len(self.unit):
            return result
        return np.concatenate([result, self.moved_by(self.unit, theta, states)[::every]], axis=2)

    def moved_by(self, units: Array, theta: Array, states: Array) -> Array:
        """Return the states' derivative by the sizes of torques of shape (E, 2, K, L) beside all, (K + 1, 4, E, L)."""
        small = SMALL / np.maximum(np.abs(units).max(axis=(1, 2, 3)), np.finfo(float).tiny)[:, None]
        # Those of all torques are simulated side by side.
        tau = self._acting(theta)[:, :, None] + small * np.moveaxis(units, 0, 2)
        start = np.tile(states[0], len(units))
        moved = roll(theta[: len(theta) - len(self.unit)], start, tau.reshape(*tau.shape[:2], -1), self.step)
        return np.asarray((moved.reshape(*states.shape[:2], *tau.shape[2:]) - states[:, :, None]) / small)

    def _acting(self, theta: Array) -> Array:
        if not len(self.unit):
            return self.tau
        return np.asarray(self.tau + np.tensordot(theta[-len(self.unit) :], self.unit, 1))

    def finer(self, times: int) -> Segments:
        """Return the same with so many steps in the place of one."""
        return self._stepped(self.motions, self.group, self.start, self.step / times, times * self.steps)

    def measured(self, offset: Array, *, rates: bool = False) -> Array:
        """Return smoothed states, or their rates, at times ``offset`` [s], shape (M,), after each segment's start.

        Returns:
            Shape (4, M, L).
        """
        parts = []
        for number, motion in enumerate(self.motions):
            times = self.start[self.group == number] + offset[:, None]
            parts.append(motion.rates(times) if rates else motion.states(times))
        return np.concatenate(parts, axis=2)


class AgainstStates:
    """All four states against the smoothed ones, in standard deviations, averaged over a segment.

    Residuals are 4 of the initial state and 4 of each of the ``times`` that are compared. ``scale`` are the states'
    standard deviations, shape (4,).
    """

    def __init__(self, segments: Segments, scale: Array) -> None:
        self.segments = segments
        self._every = max(1, min(segments.steps, round(SPACING / segments.step)))
        self.times = segments.steps // self._every
        #: Times from a segment's start [s] at which it is compared: 0, where its initial state is, and the rest.
        self.offset: Array = segments.step * self._every * np.arange(self.times + 1.0)
        weight = 1 / (scale * np.sqrt(self.times))
        self._weights = np.vstack([1 / (scale * PRIOR), np.tile(weight, (self.times, 1))])
        #: Derivative of a segment's residuals by how far off the zeros of its recording's positions are [rad], (M, 2).
        #: Such positions are too large by a constant, so residuals are linear in it.
        self.by_zeros = (self._weights[:, :, None] * np.eye(4, 2)).reshape(-1, 2)
        #: A residual at which a motion is lost: by how much says nothing.
        self.lost = LOST_STATE / np.sqrt(self.times)

    def initial(self, delay: float) -> Array:
        """Return a guess of the initial states, shape (4, L)."""
        return self.segments.measured(np.array([delay]))[:, 0]

    def residuals(self, states: Array, delay: float) -> Array:
        """Return residuals, shape (L, M), of simulated states, shape (K + 1, 4, L)."""
        measured = np.moveaxis(self.segments.measured(self.offset + delay), 1, 0)
        errors = states[:: self._every] - measured
        return np.asarray((errors * self._weights[:, :, None]).reshape(-1, len(self.segments)).T)

    def jacobian(self, theta: Array, states: Array, delay: float) -> Array:
        """Return the residuals' derivative, shape (L, M, 4 + D + 1 + 2).

        It is that by initial state, theta, delay, and the zeros of the recording's positions.
        """
        rates = self.segments.measured(self.offset + delay, rates=True)
        sensitivity = self.segments.sensitivities(theta, states, self._every)
        rows, _, size, lanes = sensitivity.shape
        result = np.empty((lanes, rows, 4, size + 3))
        np.multiply(np.moveaxis(sensitivity, 3, 0), self._weights[:, :, None], out=result[..., :-3])
        np.multiply(np.moveaxis(rates, (0, 2), (2, 0)), -self._weights, out=result[..., -3])
        result[..., -2:] = self.by_zeros.reshape(rows, 4, 2)
        return result.reshape(lanes, rows * 4, -1)


class AgainstPositions:
    """Positions as recorded, in units of their noise, at every sample within a segment of the slowest recording.

    What it offers is what :class:`AgainstStates` does; residuals are 2 of every compared sample. ``noise`` is the
    standard deviation of the recorded positions [rad], shape (2,); the delay will lie about ``delay`` [s]; ``initial``
    is a guess of the initial states, shape (4, L), by default the smoothed ones.
    """

    #: Of both ends of a step: which end, and the first of the two states there that a Hermite polynomial weighs.
    _CORNERS = ((0, 0), (1, 0), (0, 2), (1, 2))

    def __init__(self, segments: Segments, noise: Array, delay: float = 0.0, initial: Array | None = None) -> None:
        self.segments = segments
        self.noise = noise
        self._initial = initial
        duration = segments.steps * segments.step
        within = []
        for group, start in zip(segments.group, segments.start, strict=True):
            t = segments.motions[group].recorded.t - delay
            within.append(np.flatnonzero((t > start - 1e-9) & (t < start + duration + 1e-9)))
        # As many of each, spread over all of it, where one is sampled faster than another.
        count = min(map(len, within))
        within = [w[np.rint(np.linspace(0, len(w) - 1, count)).astype(np.intp)] for w in within]
        recorded = [segments.motions[g].recorded for g in segments.group]
        self._q = np.stack([r.q[w] for r, w in zip(recorded, within, strict=True)])  # (L, M, 2)
        self._t = np.stack([r.t[w] for r, w in zip(recorded, within, strict=True)], axis=-1) - segments.start
        self.by_zeros = np.tile(np.diag(1 / noise), (count, 1))
        steps = range(1, int(SMOOTH / segments.step) + 1)
        self._every = max((n for n in steps if segments.steps % n == 0), default=1)
        self.lost = LOST_ANGLE / float(noise.min())

    @property
    def count(self) -> int:
        """How many positions are compared."""
        return self._q.size

    @property
    def times(self) -> Array:
        """When [s], shape (M, L)."""
        return np.asarray(self._t + self.segments.start)

    def initial(self, delay: float) -> Array:
        """Return the guess that was given, or the smoothed states."""
        return self.segments.measured(np.array([delay]))[:, 0] if self._initial is None else self._initial

    def residuals(self, states: Array, delay: float) -> Array:
        """Return the residuals."""
        k, weights, _ = self._interpolation(delay, 1)
        errors = self._between(states[:, :, None], k, weights)[..., 0] - self._q
        return np.asarray((errors / self.noise).reshape(len(errors), -1))

    def moved(self, states: Array, delay: float) -> Array:
        """Return by how much residuals change with states, of shape (K + 1, 4, C, L), as (L, M, C)."""
        k, weights, _ = self._interpolation(delay, 1)
        changes = self._between(states, k, weights) / self.noise[:, None]
        return changes.reshape(len(changes), -1, states.shape[2])

    def jacobian(self, theta: Array, states: Array, delay: float) -> Array:
        """Return their derivative."""
        k, weights, slopes = self._interpolation(delay, self._every)
        by_unknowns = self._between(self.segments.sensitivities(theta, states, self._every), k, weights)
        by_delay = -self._between(states[:: self._every, :, None], k, slopes)
        by_zeros = np.broadcast_to(np.eye(2), (*by_delay.shape[:3], 2))
        result = np.concatenate([by_unknowns, by_delay, by_zeros], axis=3)
        result /= self.noise[:, None]
        return result.reshape(len(result), -1, result.shape[3])

    def _between(self, by_step: Array, k: Indices, weights: Sequence[Array]) -> Array:
        """Return what C values of every step and state, shape (K + 1, 4, C, L), are at the samples, (L, M, 2, C)."""
        _, _, size, lanes = by_step.shape
        flat, first = by_step.ravel(), k * (4 * size * lanes) + np.arange(lanes)
        result = np.empty((lanes, len(k), 2, size))
        # One by one: those of neighbouring lanes lie side by side.
        for joint, column in np.ndindex(2, size):
            total = np.zeros(k.shape)
            for (end, kind), weight in zip(self._CORNERS, weights, strict=True):
                total += weight * flat[((4 * end + kind + joint) * size + column) * lanes :].take(first)
            result[:, :, joint, column] = total.T
        return result

    def _interpolation(self, delay: float, every: int) -> tuple[Indices, tuple[Array, ...], tuple[Array, ...]]:
        """Return in which of so many steps together each sample lies, and its corners' cubic Hermite polynomials."""
        h = self.segments.step * every
        at = (self._t - delay) / h
        k = np.clip(np.floor(at + 1e-6).astype(np.intp), 0, self.segments.steps // every - 1)
        s = at - k
        blend, rise = s * s * (3 - 2 * s), 6 * s * (1 - s) / h
        weights = (1 - blend, blend, h * s * (1 - s) ** 2, h * s * s * (s - 1))
        slopes = (-rise, rise, (1 - s) * (1 - 3 * s), s * (3 * s - 2))
        return k, weights, slopes


#: Residuals of simulated segments and their derivatives.
Comparison = AgainstStates | AgainstPositions
