# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Uniform sampling, smoothing, and zero-phase differentiation, which replaces recorded velocities."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from pendubot_identification.arrays import Array
from pendubot_identification.errors import TrajectoryError

from .trajectory import Trajectory


@dataclass(frozen=True, slots=True)
class SignalSettings:
    """Sampling grids, smoothing, and the test for inconsistent timestamps."""

    jitter: float = 0.1  #: Stamps within this fraction of the interval from a uniform grid are moved onto it.
    #: Smoothing windows [s]; windows below five samples give central differences.
    windows: tuple[float, ...] = (0.02, 0.03, 0.04, 0.05, 0.06, 0.08, 0.1)
    degree: int = 3  #: Polynomial degree of the Savitzky-Golay filter.
    #: Timestamps are inconsistent if even timestamps make the motion smoother by more than this factor.
    rougher: float = 1.1
    stretch: int = 7  #: Number of samples in each stretch over which roughness is computed.
    fewest: int = 50  #: Least number of stretches.


SETTINGS = SignalSettings()
#: A gap is not interpolated if it is longer than this [s] and than five intervals: the motion in it is unknown.
LONGEST_GAP = 0.1
#: Default window of the differentiator [s], the span of the paper's central differences at 100 Hz. At higher rates, a
#: polynomial over this span averages the quantization of the encoders.
SMOOTHING = 0.02


def resample(trajectory: Trajectory) -> Trajectory:
    """Return the trajectory, of at least two samples, on a uniform grid.

    Stamps with little jitter are moved onto the grid, and all samples stay. Otherwise positions and velocities are
    interpolated by cubic splines, and torques by zero-order hold, as on the board.

    Raises:
        TrajectoryError: samples are too far apart, or a gap is too long to interpolate.
    """
    t, step = trajectory.t, trajectory.interval
    gaps = np.diff(t)
    widest = int(np.argmax(gaps))
    if step > LONGEST_GAP:
        apart = f'its samples are {step:g} s apart and at most {LONGEST_GAP:g} s is expected'
        raise TrajectoryError(f'{trajectory.name}: {apart}; are its stamps in seconds? record at a higher rate')
    if gaps[widest] > max(LONGEST_GAP, 5 * step):
        raise TrajectoryError(
            f'{trajectory.name}: {gaps[widest]:.3f} s without a sample begin at {t[widest]:.3f} s, where '
            f'{step:.4g} s is the usual interval; choose a window on one side of the gap'
        )
    even = np.linspace(t[0], t[-1], len(t))
    if np.abs(even - t).max() < SETTINGS.jitter * step:
        return replace(trajectory, t=even)
    grid = t[0] + step * np.arange(int((t[-1] - t[0]) / step + 1e-6) + 1)
    qd = None if trajectory.qd is None else CubicSpline(t, trajectory.qd)(grid)
    return replace(trajectory, t=grid, q=CubicSpline(t, trajectory.q)(grid), tau=trajectory.tau[held(t, grid)], qd=qd)


def evenly_stamped(trajectory: Trajectory) -> Trajectory:
    """Return the trajectory with even stamps if the recorded ones are inconsistent with the motion.

    A board samples by its timer, but the stamp may be the arrival time. Stamps that also drift, for example where
    samples are missing, are not corrected.
    """
    if not has_timestamp_jitter(trajectory):
        return trajectory
    t, number = trajectory.t, np.arange(len(trajectory))
    slope, start = np.polyfit(number, t, 1)
    even = start + slope * number
    late = np.convolve(t - even, np.full(100, 0.01), mode='valid')
    drifts = np.abs(late).max() > np.std(t - even) / 2
    return trajectory if drifts else replace(trajectory, t=even)


def has_timestamp_jitter(trajectory: Trajectory) -> bool:
    """Return whether the motion is significantly smoother with even stamps than with its own."""
    if len(trajectory) < SETTINGS.fewest * SETTINGS.stretch:
        return False
    with np.errstate(over='ignore'):
        recorded, durations = _roughness(trajectory.t, trajectory.q)
        even, _ = _roughness(np.arange(len(trajectory), dtype=float), trajectory.q)
    # Skip rest and missing samples.
    moving = (recorded > 0) & (even > 0) & (durations < 1.5 * np.median(durations))
    recorded, even = recorded[moving], even[moving]
    return bool(recorded.sum() > SETTINGS.rougher * even.sum() and np.median(recorded / even) > 1)


def _roughness(t: Array, q: Array) -> tuple[Array, Array]:
    """Return the squared residuals [rad^2] of cubic polynomials over stretches of samples, and their durations."""
    count = len(t) // SETTINGS.stretch
    times = t[: count * SETTINGS.stretch].reshape(count, SETTINGS.stretch)
    durations = np.ptp(times, axis=1)
    basis, _ = np.linalg.qr(
        ((times - times[:, :1]) / durations[:, None] - 0.5)[:, :, None] ** np.arange(SETTINGS.degree + 1)
    )
    parts = q[: count * SETTINGS.stretch].reshape(count, SETTINGS.stretch, 2)
    return ((parts - basis @ (basis.transpose(0, 2, 1) @ parts)) ** 2).sum(axis=(1, 2)), durations


def held(t: Array, at: Array) -> NDArray[np.intp]:
    """Return the index of the sample that holds the torque at each of the times ``at`` [s]; ``t``: sample times [s].

    A time before a sample, within the tolerance of jitter, belongs to that sample.
    """
    tolerance = SETTINGS.jitter * float(np.median(np.diff(t)))
    return np.maximum(np.searchsorted(t, at + tolerance, side='right') - 1, 0)


def differentiate(q: Array, interval: float, window: float) -> tuple[Array, Array]:
    """Return positions and velocities from uniformly sampled positions, without phase shift.

    ``interval`` [s] is the sampling interval, ``window`` [s] the width of the Savitzky-Golay filter. With fewer than 5
    samples in it, positions are unchanged and velocities are central differences. Arrays: (N, 2) [rad, rad/s].

    Raises:
        TrajectoryError: there are fewer samples than the window holds.
    """
    # The first rounding removes the rounding error of the interval.
    length = 2 * round(round(min(window / interval, 2 * len(q)) / 2, 6)) + 1
    if length <= SETTINGS.degree + 1:
        return q, np.gradient(q, interval, axis=0)
    if len(q) < length:
        raise TrajectoryError(f'{len(q)} samples are fewer than the window of {window:g} s holds; choose a shorter one')
    # The import of scipy.signal takes longer than all other imports.
    t, degree = np.linspace(-1, 1, length)[:, None], np.arange(SETTINGS.degree + 1)
    powers, slopes = t**degree, degree * t ** np.maximum(degree - 1, 0) / (interval * (length // 2))
    smooth, rates = (_at_each_sample(values @ np.linalg.pinv(powers), q) for values in (powers, slopes))
    return smooth, rates


def _at_each_sample(weights: Array, q: Array) -> Array:
    """Return the values of the polynomial through the window of each sample, shape (N, 2) like ``q``.

    A row of ``weights``, shape (L, L), gives the value at one sample of a window.
    """
    middle = len(weights) // 2
    inner = [np.correlate(joint, weights[middle], 'valid') for joint in q.T]
    first, last = q[: len(weights)], q[-len(weights) :]
    return np.vstack([weights[:middle] @ first, np.column_stack(inner), weights[middle + 1 :] @ last])


def encoder_step(q: Array) -> Array:
    """Return the quantization step of each joint's encoder [rad], shape (2,); 0 where none is found."""
    steps = np.zeros(q.shape[1])
    for joint, moved in enumerate(np.abs(np.diff(q, axis=0)).T):
        moved = moved[moved > 1e-9]
        if moved.size < 10:
            continue
        # With a fine encoder, every difference of two samples may be several counts.
        for step in moved.min() / np.arange(1, 9):
            few = moved[moved < 200 * step]
            counts = np.round(few / step)
            # Without quantization the distance to the nearest multiple is uniform, with a standard deviation of 0.29;
            # for ten differences it is sometimes below 0.1.
            off = np.std(few / step - counts)
            if (few.size >= 10 and off < 1e-3) or (few.size >= 20 and off < 0.1):
                steps[joint] = np.median(few / counts)
                break
    return steps


def choose_smoothing(trajectories: Sequence[Trajectory]) -> float:
    """Return the widest window [s] that removes noise from the positions and keeps the motion.

    The noise is the quantization of the encoder, or the change by the narrowest window if that is larger. A window that
    changes the positions by more than 1.5 times the noise distorts the motion.

    Raises:
        TrajectoryError: samples are too far apart, have a gap, or are fewer than the narrowest window holds.
    """
    chosen = SETTINGS.windows[-1]
    for trajectory in trajectories:
        even = resample(trajectory)
        windows = [w for w in SETTINGS.windows if w < len(even) * even.interval / 2] or [SETTINGS.windows[0]]
        removed = [np.std(differentiate(even.q, even.interval, w)[0] - even.q, axis=0) for w in windows]
        noise = np.maximum(encoder_step(trajectory.q) / np.sqrt(12), removed[0])
        fitting = [w for w, r in zip(windows, removed, strict=True) if (r <= 1.5 * np.maximum(noise, 1e-9)).all()]
        chosen = min(chosen, fitting[-1] if fitting else SETTINGS.windows[0])
    return chosen
