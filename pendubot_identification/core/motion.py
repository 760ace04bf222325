"""A recording made ready for simulation: states as smooth functions of time, torques as impulses."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline, PPoly

from .signals import differentiate, resample
from .trajectory import Trajectory

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Motion:
    """States and torques of one recording at any time.

    Attributes:
        name: of the recording.
        start: time of its first sample [s].
        end: time of its last one [s].
        interval: its sampling interval [s].
        smoothed: q1, q2, q1', q2' [rad, rad/s] as a spline of time.
        impulse: integral of both torques [N m s] since the start, as a piecewise polynomial of time.
        recorded: what all this was made of.
    """

    name: str
    start: float
    end: float
    interval: float
    smoothed: CubicSpline
    impulse: PPoly
    recorded: Trajectory

    @classmethod
    def prepare(cls, trajectory: Trajectory, smoothing: float, hold: str = 'zero') -> Motion:
        """Smooth the positions and integrate the torques.

        Args:
            trajectory: the recording; its own velocities are not used.
            smoothing: the differentiator's window [s].
            hold: ``zero``: a torque is applied from its sample until the next one, as this package's bridge records
                it. ``linear``: it was measured at its sample and changes linearly until the next one.
        """
        even = resample(trajectory)
        q, qd = differentiate(even.q, even.interval, smoothing)
        if q is even.q:
            # Samples too far apart to be smoothed: a spline through them knows their speed ten times better than
            # differences do.
            qd = CubicSpline(even.t, q)(even.t, 1)
        t, tau = trajectory.t, trajectory.tau
        pieces = [tau[:-1]] if hold == 'zero' else [np.diff(tau, axis=0) / np.diff(t)[:, None], tau[:-1]]
        return cls(
            name=trajectory.name,
            start=float(even.t[0]),
            end=float(even.t[-1]),
            interval=even.interval,
            smoothed=CubicSpline(even.t, np.column_stack([q, qd])),
            impulse=PPoly(np.array(pieces), t).antiderivative(),
            recorded=trajectory,
        )

    def part(self, start: float, end: float) -> Motion:
        """Return the motion from ``start`` to ``end`` [s of its own time], cut to what there is."""
        start, end = max(start, self.start), min(end, self.end)
        recorded = self.recorded
        return replace(self, start=start, end=end, recorded=recorded[(recorded.t >= start) & (recorded.t <= end)])

    def states(self, t: Array) -> Array:
        """Return q1, q2, q1', q2' at the times t [s], shape (4, ...)."""
        return np.moveaxis(self.smoothed(t), -1, 0)

    def rates(self, t: Array) -> Array:
        """Return q1', q2', q1'', q2'' at the times t [s], shape (4, ...)."""
        return np.moveaxis(self.smoothed(t, 1), -1, 0)

    def torques(self, start: Array, step: float, steps: int) -> Array:
        """Return the mean torques [N m] over consecutive steps from each of the times ``start``, shape (2, K, L)."""
        edges = start + step * np.arange(steps + 1)[:, None]
        return np.asarray(np.moveaxis(np.diff(self.impulse(edges), axis=0), -1, 0) / step)
