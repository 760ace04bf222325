# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The weak-form residuals of both joints' momentum in each block, and their covariance due to measurement errors.

Weighted with a test function w, a residual is a row of [phi, y] (see :mod:`pendubot_identification.criteria.weak`).
Angles that are off by e change what it leaves, linearised and integrated by parts, by

    integral of ((w M)'' + (w M A_v)' - w M A_q) e dt

where the model's accelerations have the derivatives A_q and A_v. So e, which is an encoder's rounding and nearly white,
tells the covariance of all rows, though test functions overlap and the rig moves fast or slowly. Whitened rows are all
of one noise, as in generalised least squares (WENDy: Bortz, Messenger and Dukic, Bulletin of Mathematical Biology 85,
2023).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PPoly

from pendubot_identification.criteria.energy import require_plausible_speed
from pendubot_identification.criteria.weak import WIDTH
from pendubot_identification.model.dynamics import (
    GRAVITY,
    SIGN_WIDTH,
    acceleration_derivatives,
    dry_friction_terms,
)
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.trajectory import Trajectory

Array = NDArray[np.float64]

#: A block's length [s]: of the test functions that begin in it. From one of them to the next [s]: nearer ones tell
#: nothing more.
BLOCK, STRIDE = 0.4, 0.025
#: Cells over which test functions are summed [s]: within them torque and acceleration may jump. Errors are summed over
#: so many cells at once.
CELL, COARSE = 0.00125, 2
#: Bumps of a block.
K = round(BLOCK / STRIDE)
_STEP, _REACH = round(BLOCK / CELL), round((BLOCK - STRIDE + WIDTH) / CELL)
#: Under a test function that turns no joint by more [rad], nothing moves: what holds a rig still is dry friction, which
#: could be anything.
STILL = 0.02
#: Part of their variance that rows have each for themselves: no more digits are asked of a covariance.
OWN = 1e-5


@dataclass(frozen=True, slots=True)
class Accuracy:
    """What rows are whitened by."""

    theta: Array  #: parameters, about, shape (D,).
    smoothing: float  #: window by which angles are smoothed [s].
    angles: Array  #: variance of both angles' errors [rad^2], shape (2,).
    interval: float  #: of the samples [s].
    #: Variance of the shoulder's velocity [rad^2/s^2]: by so much its square is too large.
    speed: float

    @classmethod
    def of(cls, theta: Array, smoothing: float, angles: Array, interval: float) -> Accuracy:
        """Find out how errors of the angles, smoothed, spoil velocities."""
        fine, t = 40, np.arange(-50.0, 51.0) * interval
        one = np.column_stack([t == 0, t == 0]).astype(float)
        v = Motion.prepare(Trajectory(t, one, one), smoothing).states(np.linspace(t[0], t[-1], 100 * fine))[2]
        return cls(theta, smoothing, angles, interval, float(angles[0] * np.square(v).sum() / fine))


def rows_of(
    motion: Motion, begin: float, count: int, delay: float, sign: PPoly, accuracy: Accuracy
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return the rows of so many blocks of a motion from ``begin`` [s] on: shoulder and elbow, per test function.

    ``delay`` [s] is that of the effort, ``sign`` [s] the integral of the sign of the shoulder's torque outside its dead
    zone. In a row [phi, lag, sines, sign, y], ``phi @ theta + lag delay + sines @ (P4 horizontal, P5 horizontal) +
    sign dead_zone`` is y, near the delay and dead zone that were taken.

    Returns:
        rows with noise 1 and in N m, shape (B, 2 K, D+5), and which of them are not 0 because something moves.

    Raises:
        TrajectoryError: it moves faster than a rig can.
    """
    # One node more at either end, for the means over cells.
    nodes = begin + CELL * np.arange(-1.0, (count - 1) * _STEP + _REACH + 2)
    states = np.ascontiguousarray(motion.states(nodes))
    require_plausible_speed(motion.name, nodes - motion.start, states[2:].T, motion.interval)
    impulse = np.ascontiguousarray(motion.impulse(nodes - delay).T)
    signs = np.diff(sign(nodes - delay)[:, 0])[1:-1]
    cells = _under(_columns(states, impulse, signs, len(accuracy.theta), accuracy.speed), _REACH)
    rows = cells @ _TEST_FUNCTIONS[0, :, 1:-1:2].T
    lag = cells[:, -1:] @ -_TEST_FUNCTIONS[1, :, 1:-1:2].T
    size = len(accuracy.theta)
    rows = np.concatenate([rows[:, :size], lag, rows[:, size:-1], rows[:, -1:] + lag * delay], axis=1)
    rows = np.ascontiguousarray(rows.transpose(2, 3, 0, 1)).reshape(count, 2 * K, -1)

    seen = slice(1, -1, COARSE)
    effects = _linearised(accuracy.theta, states[:, seen], np.gradient(impulse, CELL, axis=1)[:, seen])
    spread = _spread(effects, np.sqrt(COARSE * CELL * accuracy.interval * accuracy.angles))
    moving = np.repeat(moves_under(motion, begin, count), 2, axis=1)
    rows = rows * moving[:, :, None]
    covariance = spread @ spread.swapaxes(1, 2) * (moving[:, :, None] & moving[:, None])
    own = np.einsum('bkk->bk', covariance)
    own += np.where(moving, OWN * own, 1.0)
    return np.asarray(np.linalg.solve(np.linalg.cholesky(covariance), rows)), rows, moving


def moves_under(motion: Motion, begin: float, count: int) -> NDArray[np.bool_]:
    """Tell whether anything moves under each test function of so many blocks from ``begin`` [s] on, shape (B, K)."""
    # Seven points tell.
    t = begin + STRIDE * np.arange(count * K)[:, None] + WIDTH * np.linspace(0, 1, 7)
    turned = np.ptp(motion.states(t)[:2], axis=-1).max(axis=0)
    return np.asarray(turned > STILL).reshape(count, K)


def _columns(states: Array, impulse: Array, signs: Array, size: int, noise: float) -> Array:
    """Return what the weak-form residuals of single cells are made of, shape (2, D+4, cells)."""
    q, v, v12 = states[:2], states[2:], states[2:].sum(axis=0)
    c2, s2 = np.cos(q[1]), np.sin(q[1])
    q12 = q.sum(axis=0)
    gravity = GRAVITY * np.stack([np.cos(q[0]), np.cos(q12), -np.sin(q[0]), -np.sin(q12)])
    cells = np.zeros((2, size + 4, states.shape[1] - 3))
    cells[0, 0] = np.diff(v[0])[1:-1]
    cells[:, 1] = np.diff(v12)[1:-1]
    cells[0, 2] = np.diff(c2 * (v[0] + v12))[1:-1]
    cells[1, 2] = np.diff(c2 * v[0])[1:-1] + _integrals(s2 * (v[0] * v12 - noise))
    cells[0, 3], cells[:, 4], cells[0, size], cells[:, size + 1] = _integrals(gravity)
    cells[0, size + 2] = signs
    pushes = np.diff(impulse)[:, 1:-1]
    cells[:, -1] = pushes
    for joint in (0, 1):
        cells[joint, 5 + joint] = _integrals(v[joint])
        if size >= 9:
            sense = _senses(v[joint])
            cells[joint, 7 + joint] = sense
        if size >= 10:
            cells[1, 9] = np.diff(v[1])[1:-1]
        if size >= 14:
            stribeck = dry_friction_terms(v[joint], 0.0)[:, 1]
            cells[joint, 10 + joint] = _integrals(stribeck)
            cells[joint, 12 + joint] = sense / CELL * np.abs(pushes[joint])
    return cells


def _integrals(f: Array) -> Array:
    """Return integrals over the cells between nodes, but the outer ones, by cubic polynomials."""
    return np.asarray(CELL / 24 * (13 * (f[..., 1:-2] + f[..., 2:-1]) - f[..., :-3] - f[..., 3:]))


def _senses(v: Array) -> Array:
    """Return integrals of the sign of dry friction, for velocities that are straight lines within a cell."""
    begin, end = v[1:-2] / SIGN_WIDTH, v[2:-1] / SIGN_WIDTH
    change = end - begin
    straight = np.abs(change) > 1e-3
    whole = np.logaddexp(end, -end) - np.logaddexp(begin, -begin)
    return np.asarray(CELL * np.where(straight, whole / np.where(straight, change, 1.0), np.tanh((begin + end) / 2)))


def _linearised(theta: Array, states: Array, tau: Array) -> tuple[Array, Array, Array]:
    """Return what multiplies w'', w' and w in what errors of the angles do, each of shape (2, 2, nodes)."""
    q, v = states[:2], states[2:]
    _, derivatives = acceleration_derivatives(theta, q, v, tau)
    P1, P2, P3 = theta[:3]
    c2 = np.cos(q[1])
    M = np.empty((2, 2, len(c2)))
    M[0, 0], M[0, 1], M[1, 0], M[1, 1] = P1 + P2 + 2 * P3 * c2, P2 + P3 * c2, P2 + P3 * c2, P2
    if len(theta) >= 10:
        M[1, 1] += theta[9]
    MA_q = np.einsum('ijn,jkn->ikn', M, derivatives[:, :2])
    MA_v = np.einsum('ijn,jkn->ikn', M, derivatives[:, 2:4])
    rate = np.gradient(M, COARSE * CELL, axis=2)
    return M, 2 * rate + MA_v, np.gradient(rate + MA_v, COARSE * CELL, axis=2) - MA_q


def _spread(factors: Sequence[Array], scale: Array) -> Array:
    """Return what errors at each node, of each joint's ``scale``, shape (2,), do to rows, shape (B, 2 K, 2 nodes).

    ``factors`` multiply the test functions' second derivative, their first, and the test functions.
    """
    spread: Array = np.zeros(1)
    for test_functions, factor in zip(_TEST_FUNCTIONS[::-1, :, :: 2 * COARSE], factors, strict=True):
        under = np.moveaxis(_under(factor * scale[:, None], test_functions.shape[1], _STEP // COARSE), 2, 0)
        spread = spread + test_functions[None, :, None, None] * under[:, None]
    return spread.reshape(len(spread), 2 * K, -1)


def _under(values: Array, reach: int, step: int = _STEP) -> Array:
    """Return what lies under the test functions of each block, of arrays (..., N): (..., B, reach)."""
    return np.lib.stride_tricks.sliding_window_view(values, reach, axis=-1)[..., ::step, :]


def _test_functions() -> Array:
    """Return the test functions of a block [1/s] and two derivatives, at nodes and middles of cells in turn."""
    half = WIDTH / 2
    x = (np.arange(2 * _REACH + 1) * CELL / 2 - STRIDE * np.arange(K)[:, None]) / half - 1
    x = np.clip(x, -1, 1)
    r = 1 - x * x
    test_functions = np.stack([r**3, -6 * x * r**2 / half, (24 * x * x * r - 6 * r**2) / half**2])
    return np.asarray(test_functions * 35 / 32 / half)


_TEST_FUNCTIONS = _test_functions()
