# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Samples as they come, in; the weak criterion's balances out, 0.4 s at a time, each reduced to a triangle.

A bump is complete once the samples under it are there. Those that begin within the same 0.4 s are a block: its
rows are reduced to one triangle, so that nothing later depends on how fast the rig is sampled.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.criteria.weak import WIDTH, balance_weights, estimate_delay, weak_regression
from pendubot_identification.errors import TrajectoryError
from pendubot_identification.model.parameters import MODELS, Bounds
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.signals import LONGEST_GAP, choose_smoothing
from pendubot_identification.trajectories.trajectory import Trajectory

Array = NDArray[np.float64]

#: A block's length [s], and from one of its bumps to the next [s]: nearer ones tell nothing more.
BLOCK, STRIDE = 0.4, 0.02
#: Under a bump that turns no joint by more [rad], nothing moves: what holds a rig still is dry friction, which could be
#: anything.
STILL = 0.02
#: Blocks at most that are made at once, where many samples come together.
TOGETHER = 16
#: Samples after which the end of a cubic spline is no longer felt: (2 - sqrt 3)^12 is 1e-7.
SETTLED = 12
#: Stamps that run back by more [s] are those of a clock that began anew; by less, of a sample that is late or repeated.
RESTART = 1.0
#: What may be wrong with a sample, in words.
NOT_FINITE, REPEATED = 'a number that is not finite', 'a stamp that repeats or runs back'
#: An effort is at its limit in a block where it stands there in more than this part of the samples that have any.
SATURATED = 0.5


@dataclass(frozen=True, slots=True)
class Taking:
    """How samples are made balances of, as in an identification."""

    model: str  #: one of :data:`.parameters.MODELS`.
    delay: float  #: of the effort [s].
    smoothing: float  #: the differentiator's window [s].
    hold: str  #: how the torque behaves between its samples, see :meth:`.Motion.prepare`.
    weights: Array  #: of the three balances, shape (3,).

    @classmethod
    def of(
        cls,
        motion: Trajectory,
        model: str,
        bounds: Bounds,
        delays: tuple[float, float],
        smoothing: float | None = None,
        hold: str = 'zero',
    ) -> Taking:
        """Choose what suits a motion, as the weak criterion does; a delay of equal ends and a smoothing are given.

        Raises:
            TrajectoryError: it is too short, or has gaps.
        """
        smoothing = choose_smoothing([motion]) if smoothing is None else smoothing
        made, (low, high) = Motion.prepare(motion, smoothing, hold), delays
        delay = low if low == high else estimate_delay([made], model, bounds, low, high)
        weights = balance_weights([weak_regression(made, model, delay)], bounds.of(MODELS[model]))
        return cls(model, delay, smoothing, hold, weights)


class Block(NamedTuple):
    """What 0.4 s of motion say of theta.

    Attributes:
        begin, end: the time from which on its first bump, and until which its last one reaches [s].
        triangle: of the QR factorisation of [phi, y], its diagonal not negative, shape (D+1, D+1).
        rows: how many rows it stands for; 0 where nothing moved.
        saturated: whether the effort stood at one value where there was any, beyond which it never went.
    """

    begin: float
    end: float
    triangle: Array
    rows: int
    saturated: bool


class Blocks:
    """Takes samples in any portions, and gives blocks; keeps no more than the samples under incomplete bumps."""

    def __init__(self, taking: Taking) -> None:
        self._taking = taking
        self._held = np.empty((0, 5))  # t q1 q2 tau1 tau2
        self._next = np.nan  # where the next bump begins
        self._greatest = 0.0
        self.notes: dict[str, int] = {}  #: what was wrong with samples, and how often.

    def feed(self, samples: Array) -> Iterator[Block]:
        """Take samples, rows of t [s], q1, q2 [rad], tau1, tau2 [N m], and return the blocks that they complete."""
        samples = samples[self._usable(samples)]
        while len(samples):
            together = np.concatenate([self._held[-1:], samples])[:, 0]
            steps = np.diff(together)
            usual = float(np.median(np.diff(np.concatenate([self._held[-50:, 0], samples[:50, 0]]))))
            apart = np.flatnonzero(np.abs(steps) > max(LONGEST_GAP, 5 * usual))
            cut = len(samples)
            if len(apart):
                cut = int(apart[0]) + (not len(self._held))
            self._held = np.concatenate([self._held, samples[:cut]])
            yield from self._complete()
            if cut < len(samples):
                gap = float(samples[cut, 0] - self._held[-1, 0])
                self._say('the stamps began anew' if gap < 0 else 'a gap between samples')
                self._held, self._next = np.empty((0, 5)), np.nan
            samples = samples[cut:]

    def _usable(self, samples: Array) -> NDArray[np.bool_]:
        finite = np.isfinite(samples).all(axis=1)
        if not finite.all():
            self._say(NOT_FINITE, int((~finite).sum()))
        t, latest = samples[:, 0], self._held[-1, 0] if len(self._held) else -np.inf
        if finite.all() and (np.diff(t, prepend=latest) > 0).all():
            return np.asarray(finite)
        kept = finite.copy()
        for k in np.flatnonzero(finite):
            if latest - RESTART < t[k] <= latest:
                kept[k] = False
            else:
                latest = t[k]
        if repeated := int((finite & ~kept).sum()):
            self._say(REPEATED, repeated)
        return np.asarray(kept)

    def _say(self, what: str, times: int = 1) -> None:
        # As a whole, so that another thread never sees half of it.
        self.notes = {**self.notes, what: self.notes.get(what, 0) + times}

    def _complete(self) -> Iterator[Block]:
        how = self._taking
        while len(self._held) > 2 * SETTLED:
            t = self._held[:, 0]
            interval = float(np.median(np.diff(t)))
            margin = SETTLED * interval + how.smoothing
            if np.isnan(self._next):
                self._next = float(t[0]) + margin + max(how.delay, 0.0)
            late = margin + interval + max(-how.delay, 0.0)
            count = min(math.floor((t[-1] - late - WIDTH - self._next) / BLOCK + 1e-9), TOGETHER)
            if count < 1:
                return
            used = int(np.searchsorted(t, self._next + count * BLOCK + WIDTH + late, side='right'))
            yield from self._blocks(self._held[:used], count)
            self._next += count * BLOCK
            first = int(np.searchsorted(t, self._next - margin - max(how.delay, 0.0) - interval)) - 1
            self._held = self._held[max(first, 0) :]

    def _blocks(self, samples: Array, count: int) -> Iterator[Block]:
        """Return so many blocks from :attr:`_next` on."""
        how, begin, per_block = self._taking, self._next, round(BLOCK / STRIDE)
        begins = begin + BLOCK * np.arange(count)
        size = MODELS[how.model] + 1
        nothing = [Block(t, t + BLOCK + WIDTH, np.zeros((size, size)), 0, False) for t in begins.tolist()]
        if np.ptp(samples[:, 1:3], axis=0).max() < STILL:
            yield from nothing
            return
        try:
            recorded = Trajectory(samples[:, 0], samples[:, 1:3], samples[:, 3:5], name='the samples')
            motion = Motion.prepare(recorded, how.smoothing, how.hold)
            end = begin + count * BLOCK + WIDTH - min(how.delay, 0.0)
            part = motion.part(begin - max(how.delay, 0.0), end)
            regression = weak_regression(part, how.model, how.delay, weights=how.weights, stride=STRIDE)
        except TrajectoryError:
            self._say('samples that no rig gives: too fast a motion, or too far apart')
            yield from nothing
            return
        under = begin + STRIDE * np.arange(count * per_block)[:, None] + WIDTH * np.linspace(0, 1, 7)
        moving = np.ptp(motion.smoothed(under)[..., :2], axis=1).max(axis=1) > STILL
        rows = np.column_stack([regression.phi, regression.y])[: 3 * len(moving)]
        for k, none in enumerate(nothing):
            own = slice(k * per_block, (k + 1) * per_block)
            kept = rows[3 * own.start : 3 * own.stop][np.repeat(moving[own], 3)]
            if len(kept) < 2 * size:
                yield none
                continue
            triangle: Array = np.asarray(np.linalg.qr(kept, mode='r'))
            triangle *= np.where(np.diag(triangle) < 0, -1.0, 1.0)[:, None]
            now = (recorded.t >= none.begin) & (recorded.t < none.end)
            yield none._replace(triangle=triangle, rows=len(kept), saturated=self._saturated(recorded.tau[now, 0]))

    def _saturated(self, effort: Array) -> bool:
        size = np.abs(effort)
        self._greatest = max(self._greatest, float(size.max(initial=0.0)))
        some = size[size > 1e-9]
        return bool(len(some) and (some > self._greatest * (1 - 1e-6)).mean() > SATURATED)
