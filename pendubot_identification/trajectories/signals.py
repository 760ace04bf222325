# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Uniform sampling and zero-phase differentiation: nothing later depends on logged velocities."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from pendubot_identification.errors import TrajectoryError

from .trajectory import Trajectory

Array = NDArray[np.float64]

#: Stamps that stray from a uniform grid by less than this fraction of the interval are taken to lie on it.
JITTER = 0.1
#: A hole longer than this [s], and than five intervals, is not interpolated: the motion in it is unknown.
LONGEST_GAP = 0.1
#: The default differentiator's window [s]: what the paper's central differences span at its 100 Hz. Faster sampling
#: fits a polynomial to the same span instead of dividing single encoder counts by ever smaller intervals.
SMOOTHING = 0.02
#: Windows [s] from which one is chosen for smooth states; below five samples they are central differences.
WINDOWS = (0.02, 0.03, 0.04, 0.05, 0.06, 0.08, 0.1)
#: Polynomial degree of the Savitzky-Golay filter.
DEGREE = 3
#: Stamps are false where a motion through them is rougher than one through even ones by more than this factor, over
#: stretches of so many samples, of which there are so many or more.
ROUGHER, STRETCH, FEWEST = 1.1, 7, 50


def resample(trajectory: Trajectory) -> Trajectory:
    """Return the trajectory, of at least two samples, on a uniform grid.

    Stamps that jitter by little more than a clock's mapping does are moved onto the grid and nothing else changes.
    Otherwise positions and velocities are interpolated by cubic splines, and torques held, as the board holds them.

    Raises:
        TrajectoryError: samples too far apart, or a gap too long to be bridged.
    """
    t, step = trajectory.t, trajectory.interval
    gaps = np.diff(t)
    widest = int(np.argmax(gaps))
    if step > LONGEST_GAP:
        raise TrajectoryError(
            f'{trajectory.name}: its samples are {step:g} s apart and at most {LONGEST_GAP:g} s is '
            'expected; are its stamps in seconds? record at a higher rate'
        )
    if gaps[widest] > max(LONGEST_GAP, 5 * step):
        raise TrajectoryError(
            f'{trajectory.name}: {gaps[widest]:.3f} s without a sample begin at {t[widest] - t[0]:.3f} s, where '
            f'{step:.4g} s is the usual interval; choose a window on one side of the gap'
        )
    even = np.linspace(t[0], t[-1], len(t))
    if np.abs(even - t).max() < JITTER * step:
        return replace(trajectory, t=even)
    # Positions and velocities by cubic splines, and torques as they were held.
    grid = t[0] + step * np.arange(int((t[-1] - t[0]) / step + 1e-6) + 1)
    qd = None if trajectory.qd is None else CubicSpline(t, trajectory.qd)(grid)
    return replace(trajectory, t=grid, q=CubicSpline(t, trajectory.q)(grid), tau=trajectory.tau[held(t, grid)], qd=qd)


def evenly_stamped(trajectory: Trajectory) -> Trajectory:
    """Return the trajectory with even stamps where its own jitter and its samples did not; otherwise as it is.

    A board samples by its timer, and a stamp may be given later, when the sample arrives. Where stamps also wander, as
    they do where samples are missing, even ones cannot be known, and they stay.
    """
    t, number = trajectory.t, np.arange(len(trajectory), dtype=float)
    if not falsely_stamped(trajectory):
        return trajectory
    slope, start = np.polyfit(number, t, 1)
    even = start + slope * number
    late = np.convolve(t - even, np.full(100, 0.01), mode='valid')
    wanders = np.abs(late).max() > np.std(t - even) / 2
    return trajectory if wanders else replace(trajectory, t=even)


def falsely_stamped(trajectory: Trajectory) -> bool:
    """Tell whether the motion is clearly smoother through even stamps than through its own."""
    if len(trajectory) < FEWEST * STRETCH:
        return False
    with np.errstate(over='ignore'):
        own, lasts = _roughness(trajectory.t, trajectory.q)
        even, _ = _roughness(np.arange(len(trajectory), dtype=float), trajectory.q)
    # Neither where nothing moves nor where samples are missing.
    telling = (own > 0) & (even > 0) & (lasts < 1.5 * np.median(lasts))
    own, even = own[telling], even[telling]
    return bool(own.sum() > ROUGHER * even.sum() and np.median(own / even) > 1)


def _roughness(t: Array, q: Array) -> tuple[Array, Array]:
    """Return what cubic polynomials of time leave of stretches, as sums of squares [rad^2], and how long they last."""
    count = len(t) // STRETCH
    times = t[: count * STRETCH].reshape(count, STRETCH)
    lasts = np.ptp(times, axis=1)
    basis, _ = np.linalg.qr(((times - times[:, :1]) / lasts[:, None] - 0.5)[:, :, None] ** np.arange(DEGREE + 1))
    parts = q[: count * STRETCH].reshape(count, STRETCH, 2)
    return ((parts - basis @ (basis.transpose(0, 2, 1) @ parts)) ** 2).sum(axis=(1, 2)), lasts


def held(t: Array, at: Array) -> NDArray[np.intp]:
    """Return, for each of the times ``at`` [s], the number of the sample at ``t`` whose torque is then applied.

    A time that lies before a sample by no more than the jitter belongs to that sample already.
    """
    tolerance = JITTER * float(np.median(np.diff(t)))
    return np.maximum(np.searchsorted(t, at + tolerance, side='right') - 1, 0)


def differentiate(q: Array, interval: float, window: float) -> tuple[Array, Array]:
    """Return positions and velocities from uniformly sampled positions, without phase shift.

    ``interval`` [s] is that of the samples, ``window`` [s] that of the Savitzky-Golay filter. One that spans fewer than
    5 samples smooths nothing: then the positions stay as they are and the velocities are central differences. All
    arrays have shape (N, 2) [rad, rad/s].

    Raises:
        TrajectoryError: fewer samples than the window holds.
    """
    # Rounded twice, so that the last bits of the interval do not decide about halves.
    length = 2 * round(round(min(window / interval, 2 * len(q)) / 2, 6)) + 1
    if length <= DEGREE + 1:
        return q, np.gradient(q, interval, axis=0)
    if len(q) < length:
        raise TrajectoryError(
            f'{len(q)} samples, {interval * len(q):g} s, are fewer than the smoothing window of {window:g} s holds; '
            'choose a shorter one'
        )
    # As scipy.signal.savgol_filter does, whose import takes half as long as an identification.
    x = np.arange(length) - float(length // 2)
    powers = np.vander(x, DEGREE + 1, increasing=True)
    rates: Array = np.column_stack([np.zeros(length), powers[:, :-1] * np.arange(1, DEGREE + 1)]) / interval
    fitted: Array = np.linalg.pinv(powers)
    return _filtered(q, powers @ fitted), _filtered(q, rates @ fitted)


def _filtered(q: Array, fit: Array) -> Array:
    """Return what a window makes of the samples in it: of its middle, and at both ends of its other places.

    ``fit``: the value at each place of the window by the window's samples, shape (length, length).
    """
    length = len(fit)
    half = length // 2
    middle = [np.convolve(column, fit[half, ::-1], mode='valid') for column in q.T]
    return np.concatenate([fit[:half] @ q[:length], np.column_stack(middle), fit[half + 1 :] @ q[-length:]])


def encoder_step(q: Array) -> Array:
    """Return the step [rad] in which each joint's recorded positions were read, shape (2,); 0 where they have none."""
    steps = np.zeros(q.shape[1])
    for joint, moved in enumerate(np.abs(np.diff(q, axis=0)).T):
        moved = moved[moved > 1e-9]
        if moved.size < 10:
            continue
        # Fine encoders may never have moved by a single count from one sample to the next.
        for step in moved.min() / np.arange(1, 9):
            few = moved[moved < 200 * step]
            counts = np.round(few / step)
            # Of numbers that are no multiples, the distance to the nearest one is uniform, with a deviation of 0.29;
            # of ten of them it is below 0.1 now and then.
            off = np.std(few / step - counts)
            if (few.size >= 10 and off < 1e-3) or (few.size >= 20 and off < 0.1):
                steps[joint] = np.median(few / counts)
                break
    return steps


def choose_smoothing(trajectories: Sequence[Trajectory]) -> float:
    """Return the widest window [s] that takes noise from the positions and leaves the motion.

    The noise is an encoder's rounding, or what the narrowest window takes away where that is more. A window that
    takes half as much again has begun to bend the motion.

    Raises:
        TrajectoryError: samples too far apart, a gap, or fewer samples than the narrowest window holds.
    """
    chosen = WINDOWS[-1]
    for trajectory in trajectories:
        even = resample(trajectory)
        windows = [w for w in WINDOWS if w < len(even) * even.interval / 2] or [WINDOWS[0]]
        removed = [np.std(differentiate(even.q, even.interval, w)[0] - even.q, axis=0) for w in windows]
        noise = np.maximum(encoder_step(trajectory.q) / np.sqrt(12), removed[0])
        fitting = [w for w, r in zip(windows, removed, strict=True) if (r <= 1.5 * np.maximum(noise, 1e-9)).all()]
        chosen = min(chosen, fitting[-1] if fitting else WINDOWS[0])
    return chosen
