"""Uniform sampling and zero-phase differentiation: nothing later depends on logged velocities."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from .errors import TrajectoryError
from .trajectory import Trajectory

Array = NDArray[np.float64]

#: Stamps that stray from a uniform grid by less than this fraction of the interval need no resampling.
JITTER = 0.02
#: A hole longer than this [s], and than five intervals, is not interpolated: the motion in it is unknown.
LONGEST_GAP = 0.1
#: The default differentiator's window [s]: what the paper's central differences span at its 100 Hz. Faster sampling
#: fits a polynomial to the same span instead of dividing single encoder counts by ever smaller intervals.
SMOOTHING = 0.02
#: Polynomial degree of the Savitzky-Golay filter.
DEGREE = 3


def resample(trajectory: Trajectory, interval: float | None = None) -> Trajectory:
    """Return the trajectory on a uniform grid; itself where its stamps are uniform already.

    Positions (and velocities) are interpolated linearly, torques held, as the board holds them.

    Args:
        trajectory: any trajectory of at least two samples.
        interval: the grid's spacing [s]; by default the median interval of the stamps.

    Raises:
        TrajectoryError: a gap too long to be bridged.
    """
    t = trajectory.t
    step = trajectory.interval if interval is None else interval
    gaps = np.diff(t)
    widest = int(np.argmax(gaps))
    if gaps[widest] > max(LONGEST_GAP, 5 * step):
        raise TrajectoryError(
            f'{trajectory.name}: {gaps[widest]:.3f} s without a sample begin at {t[widest] - t[0]:.3f} s, where '
            f'{step:.4g} s is the usual interval; choose a window on one side of the gap'
        )
    grid = t[0] + step * np.arange(int((t[-1] - t[0]) / step + 1e-6) + 1)
    if len(grid) == len(t) and np.abs(grid - t).max() < JITTER * step:
        return trajectory
    held = np.searchsorted(t, grid + 1e-9, side='right') - 1
    qd = None if trajectory.qd is None else _interpolated(grid, t, trajectory.qd)
    return replace(trajectory, t=grid, q=_interpolated(grid, t, trajectory.q), tau=trajectory.tau[held], qd=qd)


def _interpolated(grid: Array, t: Array, values: Array) -> Array:
    return np.column_stack([np.interp(grid, t, column) for column in values.T])


def differentiate(q: Array, interval: float, window: float) -> tuple[Array, Array]:
    """Return positions and velocities from uniformly sampled positions, without phase shift.

    Args:
        q: positions [rad], shape (N, 2).
        interval: sampling interval [s].
        window: length [s] of the Savitzky-Golay window. One that spans fewer than 5 samples smooths nothing: then the
            positions stay as they are and the velocities are central differences.

    Returns:
        Smoothed positions and velocities [rad/s], each of shape (N, 2).

    Raises:
        TrajectoryError: fewer samples than the window holds.
    """
    length = 2 * round(window / interval / 2) + 1
    if length <= DEGREE + 1:
        return q, np.gradient(q, interval, axis=0)
    if len(q) < length:
        raise TrajectoryError(f'{len(q)} samples are fewer than the {length} of the smoothing window of {window:g} s')
    smooth = savgol_filter(q, length, DEGREE, axis=0)
    return smooth, savgol_filter(q, length, DEGREE, deriv=1, delta=interval, axis=0)


def with_velocities(trajectory: Trajectory, window: float) -> Trajectory:
    """Return the trajectory on a uniform grid with velocities of its own; see :func:`differentiate`."""
    uniform = resample(trajectory)
    q, qd = differentiate(uniform.q, uniform.interval, window)
    return replace(uniform, q=q, qd=qd)
