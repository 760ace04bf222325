# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A recording prepared for simulation: states as smooth functions of time, torques as impulses."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np
from scipy.interpolate import CubicSpline, PPoly

from pendubot_identification.arrays import Array

from .conversion import Affine
from .signals import differentiate, resample
from .trajectory import Trajectory

T = TypeVar('T')


@dataclass(frozen=True, slots=True)
class Motion:
    """States and torques of one recording as functions of time."""

    name: str  #: of the recording.
    start: float  #: time of its first sample [s].
    end: float  #: time of its last sample [s].
    interval: float  #: its sampling interval [s].
    smoothed: PPoly  #: q1, q2, q1', q2' [rad, rad/s] as a spline of time.
    impulse: PPoly  #: integral of both torques [N m s] since the start, as a piecewise polynomial of time.
    recorded: Trajectory  #: the recording itself.
    #: Results that depend on this motion alone, by key.
    _made: dict[Hashable, Any] = field(default_factory=dict, init=False, repr=False, compare=False)

    def once(self, key: Hashable, make: Callable[[], T]) -> T:
        """Return the result of ``make``, which is called once per key."""
        if key not in self._made:
            self._made[key] = make()
        made: T = self._made[key]
        return made

    @classmethod
    def prepare(cls, trajectory: Trajectory, smoothing: float, hold: str = 'zero') -> Motion:
        """Smooth the positions with a window [s] and integrate the torques; recorded velocities are not used.

        ``hold``: ``zero``: a torque is applied from its sample until the next one, as this package's bridge records it.
        ``linear``: it was measured at its sample and changes linearly until the next one.
        """
        even = resample(trajectory)
        interval = even.interval
        q, qd = differentiate(even.q, interval, smoothing)
        if q is even.q:
            # Too few samples for smoothing: a spline's velocity is ten times as accurate as differences.
            qd = CubicSpline(even.t, q)(even.t, 1)
        t, tau = trajectory.t, trajectory.tau
        pieces = [tau[:-1]] if hold == 'zero' else [np.diff(tau, axis=0) / np.diff(t)[:, None], tau[:-1]]
        return cls(
            name=trajectory.name,
            start=float(even.t[0]),
            end=float(even.t[-1]),
            interval=interval,
            smoothed=CubicSpline(even.t, np.column_stack([q, qd])),
            impulse=PPoly(np.array(pieces), t).antiderivative(),
            recorded=trajectory,
        )

    def part(self, start: float, end: float) -> Motion:
        """Return the part of the motion from time ``start`` to time ``end`` [s]."""
        start, end, t = max(start, self.start), min(end, self.end), self.recorded.t
        return replace(self, start=start, end=end, recorded=self.recorded[(t >= start) & (t <= end)])

    def middle(self, share: float) -> Motion:
        """Return the middle part of the motion, with this fraction of its duration."""
        margin = (1 - share) / 2 * (self.end - self.start)
        return self.part(self.start + margin, self.end - margin)

    def changed(self, change: Affine) -> Motion:
        """Return the motion after an affine map of its angles and torques, without smoothing it again."""
        Q, c, T, d = change
        recorded, x = self.recorded, self.impulse.x
        states = self.smoothed.c @ np.kron(np.eye(2), Q).T
        states[-1, :, :2] += c
        impulses = self.impulse.c @ T.T
        impulses[-2] += d
        impulses[-1] += (x[:-1] - x[0])[:, None] * d
        return replace(
            self,
            smoothed=PPoly(states, self.smoothed.x),
            impulse=PPoly(impulses, x),
            recorded=replace(recorded, q=recorded.q @ Q.T + c, tau=recorded.tau @ T.T + d, qd=None),
        )

    def states(self, t: Array) -> Array:
        """Return q1, q2, q1', q2' at the times t [s], shape (4, ...)."""
        return np.moveaxis(self.smoothed(t), -1, 0)

    def torques(self, edges: Array) -> tuple[Array, Array]:
        """Return the torques [N m] of K steps between times [s], shape (K + 1, ...): mean, and half of their change.

        Both have the shape (K, ..., 2). A torque that changes linearly in each step has the recorded impulse, and the
        same effect on the position at the end of the step.
        """
        per_step, integrals = 1 / np.diff(edges, axis=0)[..., None], self.once('integrals', self._integrals)(edges)
        mean, mean_impulse = np.split(np.diff(integrals, axis=0) * per_step, 2, axis=-1)
        impulse = integrals[..., :2]
        return mean, 3 * per_step * (impulse[1:] + impulse[:-1] - 2 * mean_impulse)

    def _integrals(self) -> PPoly:
        """Return the integrals of both torques, and the integrals of these, as one function of time."""
        single, double = np.pad(self.impulse.c, ((1, 0), (0, 0), (0, 0))), self.impulse.antiderivative().c
        return PPoly(np.concatenate([single, double], axis=2), self.impulse.x)


def root_mean_square_torque(motions: Sequence[Motion]) -> Array:
    """Return the root mean square of both recorded torques [N m], shape (2,)."""
    return np.asarray(np.sqrt(np.mean(np.concatenate([m.recorded.tau for m in motions]) ** 2, axis=0)))
