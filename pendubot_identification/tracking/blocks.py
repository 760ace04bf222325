# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Samples as they come, in; the weak criterion's weak-form residuals out, 0.4 s at a time, each reduced to a R factor.

A test function is complete once the samples under it are there. Those that begin within the same 0.4 s are a block: its
rows are reduced to one R factor, so that nothing later depends on how fast the rig is sampled.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PPoly

from pendubot_identification.criteria.energy import Regression
from pendubot_identification.criteria.quadratic import Quadratic
from pendubot_identification.criteria.weak import WIDTH, estimate_delay, residual_weights, weak_regression
from pendubot_identification.errors import TrajectoryError
from pendubot_identification.model.parameters import MODELS, Bounds, Parameters
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.signals import (
    LONGEST_GAP,
    choose_smoothing,
    differentiate,
    encoder_step,
    resample,
)
from pendubot_identification.trajectories.trajectory import Trajectory

from .residuals import BLOCK, CELL, STILL, STRIDE, Accuracy, K, moves_under, rows_of

Array = NDArray[np.float64]

#: Blocks at most that are made at once, where many samples come together.
TOGETHER = 16
#: Angles are smoothed by no wider a window [s]: whitened rows need it less than they suffer from bent motion.
WIDEST = 0.03
#: Samples after which the end of a cubic spline is no longer felt: (2 - sqrt 3)^12 is 1e-7.
SETTLED = 12
#: Stamps that run back by more [s] are those of a clock that began anew; by less, of a sample that is late or repeated.
RESTART = 1.0
#: More delay, and less, by which is seen what it does [s].
LAG = 1e-3
#: What may be wrong with a sample, in words.
NOT_FINITE, REPEATED = 'a number that is not finite', 'a stamp that repeats or runs back'
#: An effort is at its limit in a block where it stands there in more than this part of the samples that have any.
SATURATED = 0.5


@dataclass(frozen=True, slots=True)
class SegmentSettings:
    """How samples are made weak-form residuals of."""

    model: str  #: one of :data:`.parameters.MODELS`.
    delay: float  #: of the effort [s].
    hold: str  #: how the torque behaves between its samples, see :meth:`.Motion.prepare`.
    accuracy: Accuracy
    rounded: bool  #: whether angles are those of encoders, so that their error is known.
    weights: Array  #: of the criterion weak's three weak-form residuals, shape (3,).
    wide: float  #: the window [s] by which angles are smoothed for these.
    dead_zone: float = 0.0  #: torque that the motor's driver subtracts from every torque [N m].
    #: Whether errors of the angles are all that puts weak-form residuals off; else they are as the criterion weak has
    #: them.
    whitened: bool = True

    @property
    def smoothing(self) -> float:
        """The window by which angles are smoothed [s]."""
        return self.accuracy.smoothing if self.whitened else self.wide

    @classmethod
    def of(
        cls,
        motion: Trajectory,
        model: str,
        bounds: Bounds,
        delays: tuple[float, float],
        hold: str = 'zero',
    ) -> SegmentSettings:
        """Choose what suits a motion; a delay of equal ends is given.

        Raises:
            PendubotError: it is too short, has gaps, or is not that of a rig.
        """
        window = choose_smoothing([motion])
        made, (low, high) = Motion.prepare(motion, window, hold), delays
        delay = low if low == high else estimate_delay([made], model, bounds, low, high)
        regression = weak_regression(made, model, delay)
        weights = residual_weights([regression], bounds)
        each = np.tile(weights, len(regression.y) // 3)
        theta = Quadratic.reduce(each[:, None] * regression.phi, each * regression.y).minimum(bounds)
        if problems := Parameters.from_vector(theta).unphysical():
            raise TrajectoryError(f'not physical: {problems[0]}')
        even = resample(motion).q
        smoothed, _ = differentiate(even, made.interval, window)
        counts = encoder_step(motion.q)
        error = np.where(counts > 0, counts / np.sqrt(12), np.std(even - smoothed, axis=0))
        angles = np.maximum(error, 1e-6) ** 2
        accuracy = Accuracy.of(theta, min(window, WIDEST), angles, made.interval)
        return cls(model, delay, hold, accuracy, bool((counts > 0).all()), weights, window)

    def rows(self, motion: Motion, begin: float, count: int) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Return the rows of so many blocks, of noise 1 and in N m, (B, N, D+5), and which of them move."""
        if self.whitened:
            t, tau = motion.recorded.t, motion.recorded.tau[:-1, :1]
            sign = PPoly(np.sign(tau)[None], t).antiderivative()
            return rows_of(motion, begin, count, self.delay, sign, self.accuracy)
        shorter, longer = (self._weak(motion, begin, count, self.delay + more) for more in (-LAG, LAG))
        y, lag = (longer.y + shorter.y) / 2, (shorter.y - longer.y) / (2 * LAG)
        none = np.zeros((len(y), 3))
        rows = np.column_stack([shorter.phi, lag, none, y + lag * self.delay])
        rows = rows[: 3 * K * count].reshape(count, 3 * K, -1)
        moving = np.repeat(moves_under(motion, begin, count), 3, axis=1)
        rows = rows * moving[:, :, None]
        return rows, rows, moving

    def _weak(self, motion: Motion, begin: float, count: int, delay: float) -> Regression:
        """Return the criterion weak of so many blocks, and perhaps a test function more."""
        part = motion.part(begin - max(delay, 0.0), begin + count * BLOCK + WIDTH - min(delay, 0.0))
        return weak_regression(part, self.model, delay, weights=self.weights, stride=STRIDE)


class Block(NamedTuple):
    """What 0.4 s of motion say of theta.

    Attributes:
        begin, end: the time from which on its first test function, and until which its last one reaches [s].
        R factor: of the QR factorisation of its rows, all of one noise, shape (D+5, D+5); its diagonal is not negative.
        torques: the R factor of the rows as they are [N m], shape (D+5, D+5).
        rows: how many rows they stand for; 0 where nothing moved.
        saturated: whether the effort stood at one value where there was any, beyond which it never went.
    """

    begin: float
    end: float
    r_factor: Array
    torques: Array
    rows: int
    saturated: bool

    def unexplained(self, theta: Array) -> float:
        """Return the torque that all unknowns, shape (D+4,), leave unexplained, RMS under test functions [N m]."""
        return float(np.linalg.norm(self.torques @ np.append(theta, -1.0))) / math.sqrt(self.rows)


class Samples:
    """The newest usable samples without a gap, of any portions; who follows forgets those that are no longer needed."""

    def __init__(self, held: Array | None = None) -> None:
        self.held = np.empty((0, 5)) if held is None else held  #: t [s], q1, q2 [rad], tau1, tau2 [N m].
        self.notes: dict[str, int] = {}  #: what was wrong with samples, and how often.

    def append(self, samples: Array) -> Iterator[bool]:
        """Take samples, and tell of each part without a gap whether there is a gap before it."""
        samples, gap = samples[self._usable(samples)], False
        while len(samples):
            together = np.concatenate([self.held[-1:], samples])[:, 0]
            steps = np.diff(together)
            recent = np.diff(np.concatenate([self.held[-50:, 0], samples[:50, 0]]))
            usual = float(np.median(recent)) if len(recent) else 0.0
            apart = np.flatnonzero(np.abs(steps) > max(LONGEST_GAP, 5 * usual))
            cut = int(apart[0]) + (not len(self.held)) if len(apart) else len(samples)
            self.held = np.concatenate([self.held, samples[:cut]])
            yield gap
            if gap := cut < len(samples):
                back = len(self.held) and samples[cut, 0] < self.held[-1, 0]
                self.say('the stamps began anew' if back else 'a gap between samples')
                self.held = np.empty((0, 5))
            samples = samples[cut:]

    def _usable(self, samples: Array) -> NDArray[np.bool_]:
        finite = np.isfinite(samples).all(axis=1)
        if not finite.all():
            self.say(NOT_FINITE, int((~finite).sum()))
        t, latest = samples[:, 0], self.held[-1, 0] if len(self.held) else -np.inf
        if finite.all() and (np.diff(t, prepend=latest) > 0).all():
            return np.asarray(finite)
        kept = finite.copy()
        for k in np.flatnonzero(finite):
            if latest - RESTART < t[k] <= latest:
                kept[k] = False
            else:
                latest = t[k]
        if repeated := int((finite & ~kept).sum()):
            self.say(REPEATED, repeated)
        return np.asarray(kept)

    def say(self, what: str, times: int = 1) -> None:
        """Count what is wrong."""
        # As a whole, so that another thread never sees half of it.
        self.notes = {**self.notes, what: self.notes.get(what, 0) + times}


class Blocks:
    """Makes blocks of samples, and leaves no more of these than are under incomplete test functions."""

    def __init__(self, segment_settings: SegmentSettings) -> None:
        self.segment_settings = segment_settings  #: which may become another one.
        self.begin = np.nan  #: where the next test function begins [s]; after a gap, it is not known.
        self._greatest = 0.0

    def complete(self, samples: Samples) -> Iterator[Block]:
        """Return the blocks that are complete."""
        how = self.segment_settings
        while len(samples.held) > 2 * SETTLED:
            t = samples.held[:, 0]
            interval = float(np.median(np.diff(t)))
            margin = SETTLED * interval + how.smoothing + CELL
            if np.isnan(self.begin):
                self.begin = float(t[0]) + margin + max(how.delay, 0.0)
            late = margin + interval + max(-how.delay, 0.0)
            count = min(math.floor((t[-1] - late - WIDTH - self.begin) / BLOCK + 1e-9), TOGETHER)
            if count < 1:
                return
            used = int(np.searchsorted(t, self.begin + count * BLOCK + WIDTH + late, side='right'))
            yield from self._blocks(samples.held[:used], count, samples)
            self.begin += count * BLOCK
            first = int(np.searchsorted(t, self.begin - margin - max(how.delay, 0.0) - interval)) - 1
            samples.held = samples.held[max(first, 0) :]

    def _blocks(self, samples: Array, count: int, notes: Samples) -> Iterator[Block]:
        """Return so many blocks from :attr:`begin` on."""
        how, begin = self.segment_settings, self.begin
        begins = begin + BLOCK * np.arange(count)
        size = MODELS[how.model] + 5
        none = np.zeros((size, size))
        nothing = [Block(t, t + BLOCK + WIDTH, none, none, 0, False) for t in begins.tolist()]
        if np.ptp(samples[:, 1:3], axis=0).max() < STILL:
            yield from nothing
            return
        try:
            tau = np.where(np.abs(samples[:, 3:5]) > [how.dead_zone, 0.0], samples[:, 3:5], 0.0)
            recorded = Trajectory(samples[:, 0], samples[:, 1:3], tau, name='the samples')
            motion = Motion.prepare(recorded, how.smoothing, how.hold)
            rows, torques, moving = how.rows(motion, begin, count)
        except TrajectoryError:
            notes.say('samples that no rig gives: too fast a motion, or too far apart')
            yield from nothing
            return
        r_factors = np.asarray(np.linalg.qr(rows, mode='r'))
        r_factors = r_factors * np.where(np.einsum('bkk->bk', r_factors) < 0, -1.0, 1.0)[:, :, None]
        torques = np.asarray(np.linalg.qr(torques, mode='r'))
        for k, kept in enumerate(moving.sum(axis=1).tolist()):
            if kept < 2 * (MODELS[how.model] + 2):
                yield nothing[k]
                continue
            now = (recorded.t >= nothing[k].begin) & (recorded.t < nothing[k].end)
            saturated = self._saturated(recorded.tau[now, 0])
            yield Block(*nothing[k][:2], r_factors[k], torques[k], kept, saturated)

    def _saturated(self, effort: Array) -> bool:
        size = np.abs(effort)
        self._greatest = max(self._greatest, float(size.max(initial=0.0)))
        some = size[size > 1e-9]
        return bool(len(some) and (some > self._greatest * (1 - 1e-6)).mean() > SATURATED)
