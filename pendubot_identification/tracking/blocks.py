# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The buffer of arriving samples, and blocks of weak-form residuals of the momentum of both joints.

A block holds the test functions that begin within 0.4 s. Its rows are reduced to an R factor, so that the cost of a
block does not depend on the sampling rate.

The linearised residual under a test function w changes by an angle error e, after integration by parts, by

    integral of ((w M)'' + (w M A_v)' - w M A_q) e dt

where A_q and A_v are the derivatives of the accelerations. Quantization errors are nearly white, so that this gives the
covariance of all residuals, although test functions overlap. Whitened residuals all have the standard deviation 1, as
in generalised least squares (WENDy: Bortz, Messenger and Dukic, Bulletin of Mathematical Biology 85, 2023).
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.interpolate import PPoly

from pendubot_identification.arrays import Array, Flags
from pendubot_identification.criteria.energy import Regression, require_plausible_speed
from pendubot_identification.criteria.weak import WIDTH, weak_regression
from pendubot_identification.errors import TrajectoryError
from pendubot_identification.model.dynamics import GRAVITY, dry_friction_terms, linearised, padded
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.signals import LONGEST_GAP
from pendubot_identification.trajectories.trajectory import LARGEST, Trajectory

Rows = tuple[Array, Array, Flags]

#: Duration of a block, stride of its test functions, step of the integration nodes [s]; step of the error nodes, in
#: integration nodes.
BLOCK, STRIDE, CELL, COARSE = 0.4, 0.025, 0.00125, 2
#: Number of test functions of a block; of nodes from one block to the next; of nodes under all test functions.
K = round(BLOCK / STRIDE)
_STEP, _REACH = round(BLOCK / CELL), round((BLOCK - STRIDE + WIDTH) / CELL)
#: Rotation under a test function [rad] below which a joint is at rest, where dry friction is undetermined.
STILL = 0.02
#: Independent part of the variance of each residual, so that the covariance has a Cholesky factor.
INDEPENDENT = 1e-5
#: Step of the delay [s] for the finite difference of the criterion weak.
DELAY_STEP = 1e-3
#: Largest number of blocks at once. Number of samples after which the end of a cubic spline has no effect:
#: (2 - sqrt 3)^12 is 1e-7.
TOGETHER, SETTLED = 16, 12
#: A stamp that decreases by more than this [s] shows a reset of the clock; by less, a late or repeated sample.
RESTART = 1.0
#: The effort of a block is saturated if more than this fraction of the non-zero efforts equals the largest one.
SATURATED = 0.5


@dataclass(frozen=True, slots=True)
class SegmentSettings:
    """Settings of the regression rows of samples."""

    model: str  #: one of :data:`.parameters.MODELS`.
    delay: float  #: of the effort [s].
    hold: str  #: of the torque between samples, see :meth:`.Motion.prepare`.
    interval: float  #: sampling interval [s].
    smoothing: float  #: smoothing window of the angles [s].
    theta: Array  #: parameters at which angle errors are linearised, shape (D,).
    angle_variance: Array  #: of the errors of both angles [rad^2], shape (2,).
    quantized: bool  #: whether both angles have the quantization step of an encoder.
    weights: Array  #: of the three residuals of the criterion weak, shape (3,).
    whitened: bool  #: whether quantization is the only error; otherwise rows follow the criterion weak.
    dead_zone: float = 0.0  #: torque that the motor's driver subtracts from every torque [N m].


class Block(NamedTuple):
    """The information of 0.4 s of motion about theta, shape (D,), and the further unknowns."""

    begin: float  #: start of its first test function [s].
    end: float  #: end of its last test function [s].
    r_factor: Array  #: of its rows with standard deviation 1, shape (D+5, D+5).
    torques: Array  #: R factor of its rows in N m, shape (D+5, D+5).
    rows: int  #: number of rows; 0 at rest.
    saturated: bool  #: whether the effort is at its limit.

    def residual(self, fixed: Array | None = None) -> float:
        """Return the least mean square of the rows over all unknowns, or with tilt and dead zone fixed, shape (3,)."""
        if fixed is None:
            return float(self.r_factor[-1, -1] ** 2) / self.rows
        return float(np.square(self.r_factor[-4:, -4:] @ np.append(fixed, -1.0)).sum()) / self.rows

    def unexplained(self, x: Array) -> float:
        """Return the RMS residual torque under test functions [N m] for all unknowns, shape (D+4,)."""
        return float(np.linalg.norm(self.torques @ np.append(x, -1.0))) / math.sqrt(self.rows)


class Samples:
    """The buffer of the newest samples without a gap, for the next blocks."""

    def __init__(self, newest: Array | None = None) -> None:
        self.newest = np.empty((0, 5)) if newest is None else newest  #: t [s], q1, q2 [rad], tau1, tau2 [N m].
        self.notes: dict[str, int] = {}  #: count of each fault of samples.
        self._begin = math.nan  # of the next block [s]; NaN after a gap
        self._largest_effort = 0.0

    def append(self, samples: Array) -> Iterator[None]:
        """Append samples, and yield after each part without a gap; a gap clears the buffer."""
        samples = samples[self._usable(samples)]
        if not len(samples):
            return
        t = np.concatenate([self.newest[-50:, 0], samples[:, 0]])
        steps = np.diff(t)
        longest = max(LONGEST_GAP, 5 * float(np.median(steps))) if len(steps) else LONGEST_GAP
        gaps = np.flatnonzero(np.abs(steps) > longest) + 1 - (len(t) - len(samples))
        for begin, end in pairwise([0, *gaps[gaps > 0].tolist(), len(samples)]):
            if len(self.newest) and begin in gaps:
                restarted = samples[begin, 0] < self.newest[-1, 0]
                self._note('a reset of the clock' if restarted else 'a gap between samples')
                self.clear()
            self.newest = np.concatenate([self.newest, samples[begin:end]])
            yield

    def clear(self) -> None:
        """Remove all samples."""
        self.newest, self._begin = np.empty((0, 5)), math.nan

    def _note(self, fault: str, count: int = 1) -> None:
        # A new dictionary, because another thread may read the old one.
        self.notes = {**self.notes, fault: self.notes.get(fault, 0) + count}

    def _usable(self, samples: Array) -> Flags:
        """Return which samples are numbers below the limit and later than all earlier ones; count the others."""
        usable: Flags = np.asarray((np.abs(samples) < LARGEST).all(axis=1))
        if not usable.all():
            self._note('a number that is not finite', int((~usable).sum()))
        t, latest = samples[:, 0], self.newest[-1, 0] if len(self.newest) else -np.inf
        if usable.all() and (np.diff(t, prepend=latest) > 0).all():
            return usable
        for k in np.flatnonzero(usable):
            if latest - RESTART < t[k] <= latest:
                usable[k] = False
                self._note('a stamp that repeats or runs back')
            else:
                latest = t[k]
        return usable

    def take_blocks(self, settings: SegmentSettings) -> list[Block]:
        """Return the next complete blocks, at most :data:`TOGETHER`; remove samples that no later block needs."""
        if len(self.newest) <= 2 * SETTLED:
            return []
        t = self.newest[:, 0]
        interval = float(np.median(np.diff(t)))
        margin = SETTLED * interval + settings.smoothing + CELL
        if math.isnan(self._begin):
            self._begin = float(t[0]) + margin + max(settings.delay, 0.0)
        late = margin + interval + max(-settings.delay, 0.0)
        count = min(math.floor((t[-1] - late - WIDTH - self._begin) / BLOCK + 1e-9), TOGETHER)
        if count < 1:
            return []
        end = self._begin + count * BLOCK
        blocks = self._blocks(self.newest[: int(np.searchsorted(t, end + WIDTH + late, side='right'))], count, settings)
        self._begin = end
        first = int(np.searchsorted(t, end - margin - max(settings.delay, 0.0) - interval)) - 1
        self.newest = self.newest[max(first, 0) :]
        return blocks

    def _blocks(self, samples: Array, count: int, settings: SegmentSettings) -> list[Block]:
        size = len(settings.theta)
        none = np.zeros((size + 5, size + 5))
        begins = (self._begin + BLOCK * np.arange(count)).tolist()
        blocks = [Block(begin, begin + BLOCK + WIDTH, none, none, 0, False) for begin in begins]
        if np.ptp(samples[:, 1:3], axis=0).max() < STILL:
            return blocks
        try:
            tau = np.where(np.abs(samples[:, 3:5]) > [settings.dead_zone, 0.0], samples[:, 3:5], 0.0)
            recorded = Trajectory(samples[:, 0], samples[:, 1:3], tau, name='the samples')
            motion = Motion.prepare(recorded, settings.smoothing, settings.hold)
            rows, torques, moving = residual_rows(motion, self._begin, count, settings)
        except TrajectoryError:
            self._note('implausible samples: too fast, or too far apart')
            return blocks
        r_factors: Array = np.asarray(np.linalg.qr(rows, mode='r'))
        r_factors = r_factors * np.where(np.einsum('bkk->bk', r_factors) < 0, -1.0, 1.0)[:, :, None]
        torques = np.asarray(np.linalg.qr(torques, mode='r'))
        for k, count_moving in enumerate(moving.sum(axis=1).tolist()):
            if count_moving >= 2 * (size + 2):
                begin, end = blocks[k][:2]
                saturated = self._saturated(np.abs(tau[(recorded.t >= begin) & (recorded.t < end), 0]))
                blocks[k] = Block(begin, end, r_factors[k], torques[k], count_moving, saturated)
        return blocks

    def _saturated(self, effort: Array) -> bool:
        self._largest_effort = max(self._largest_effort, float(effort.max(initial=0.0)))
        acting = effort[effort > 1e-9]
        return bool(len(acting) and (acting > self._largest_effort * (1 - 1e-6)).mean() > SATURATED)


def residual_rows(motion: Motion, begin: float, count: int, settings: SegmentSettings) -> Rows:
    """Return the rows [phi, y] of the blocks of a motion from ``begin`` [s] on.

    ``phi`` has columns for theta, the delay, both components of the tilt, and the dead zone; it is linearised at the
    delay and the dead zone of the settings. Rows of test functions without motion are 0.

    Returns:
        rows of standard deviation 1 and rows in N m, shape (count, N, D+5), and whether each moves, shape (count, N).

    Raises:
        TrajectoryError: the motion is implausibly fast.
    """
    if not settings.whitened:
        return _weighted_rows(motion, begin, count, settings)
    nodes = begin + CELL * np.arange((count - 1.0) * _STEP + _REACH + 1)
    states = np.ascontiguousarray(motion.states(nodes))
    require_plausible_speed(motion.name, nodes, states[2:].T, motion.interval)
    t, tau = motion.recorded.t, motion.recorded.tau[:-1, :1]
    impulse = np.ascontiguousarray(motion.impulse(nodes - settings.delay).T)
    signs = PPoly(np.sign(tau)[None], t).antiderivative()(nodes - settings.delay)[:, 0]
    torque = np.gradient(impulse, CELL, axis=1)
    w, w1, w2 = CELL * _TEST_FUNCTIONS
    rates, changes = _columns(states, torque, settings)
    changes[0, -2], changes[:, -1] = signs, impulse
    columns, lag = _under(rates) @ w.T - _under(changes) @ w1.T, _under(impulse[:, None]) @ w2.T
    columns[:, -1:] += lag * settings.delay
    rows = np.insert(columns, [len(settings.theta)], lag, axis=1).transpose(2, 3, 0, 1).reshape(count, 2 * K, -1)

    response = _error_response(states[:, ::COARSE], torque[:, ::COARSE], settings)
    moving = np.repeat(_moving(motion, begin, count), 2, axis=1)
    rows = rows * moving[:, :, None]
    covariance = response @ response.swapaxes(1, 2) * (moving[:, :, None] & moving[:, None])
    diagonal = np.einsum('bkk->bk', covariance)
    diagonal += np.where(moving, INDEPENDENT * diagonal, 1.0)
    return np.asarray(np.linalg.solve(np.linalg.cholesky(covariance), rows)), rows, moving


def _weighted_rows(motion: Motion, begin: float, count: int, settings: SegmentSettings) -> Rows:
    """Return the rows of the criterion weak, which has no columns of tilt and dead zone."""

    def regression(delay: float) -> Regression:
        part = motion.part(begin - max(delay, 0.0), begin + count * BLOCK + WIDTH - min(delay, 0.0))
        return weak_regression(part, settings.model, delay, weights=settings.weights, stride=STRIDE)

    earlier, later = regression(settings.delay - DELAY_STEP), regression(settings.delay + DELAY_STEP)
    y, lag = (later.y + earlier.y) / 2, (earlier.y - later.y) / (2 * DELAY_STEP)
    rows = np.column_stack([earlier.phi, lag, np.zeros((len(y), 3)), y + lag * settings.delay])
    moving = np.repeat(_moving(motion, begin, count), 3, axis=1)
    rows = rows[: 3 * K * count].reshape(count, 3 * K, -1) * moving[:, :, None]
    return rows, rows / settings.weights[0], moving


def _moving(motion: Motion, begin: float, count: int) -> Flags:
    """Return whether a joint turns under each test function of the blocks from ``begin`` [s] on, shape (count, K)."""
    t = begin + STRIDE * np.arange(count * K)[:, None] + WIDTH * np.linspace(0, 1, 7)
    turned = np.ptp(motion.states(t)[:2], axis=-1).max(axis=0)
    return np.asarray(turned > STILL).reshape(count, K)


def _columns(states: Array, torque: Array, settings: SegmentSettings) -> tuple[Array, Array]:
    """Return the integrands of the residuals, and the momenta, both of shape (2, D+4, nodes)."""
    size, q, v, v12 = len(settings.theta), states[:2], states[2:], states[2:].sum(axis=0)
    c2, s2, q12 = np.cos(q[1]), np.sin(q[1]), q.sum(axis=0)
    # The square of a smoothed velocity is too large by its variance.
    variance = settings.angle_variance[0] * _velocity_gain(settings.smoothing, settings.interval)
    rates, changes = np.zeros((2, 2, size + 4, states.shape[1]))
    changes[0, 0], changes[:, 1], changes[0, 2], changes[1, 2] = v[0], v12, c2 * (v[0] + v12), c2 * v[0]
    rates[1, 2] = s2 * (v[0] * v12 - variance)
    rates[0, 3], rates[:, 4] = GRAVITY * np.cos(q[0]), GRAVITY * np.cos(q12)
    rates[0, size], rates[:, size + 1] = -GRAVITY * np.sin(q[0]), -GRAVITY * np.sin(q12)
    friction = dry_friction_terms(v.T, torque.T)
    for joint in (0, 1):
        rates[joint, 5 + joint] = v[joint]
        if size >= 9:
            rates[joint, 7 + joint] = friction[:, joint, 0]
        if size >= 14:
            rates[joint, 10 + joint], rates[joint, 12 + joint] = friction[:, joint, 1:].T
    if size >= 10:
        changes[1, 9] = v[1]
    return rates, changes


@lru_cache(maxsize=8)
def _velocity_gain(smoothing: float, interval: float) -> float:
    """Return the ratio of the variances of a smoothed velocity and of independent angle errors [1/s^2]."""
    fine, t = 40, np.arange(-50.0, 51.0) * interval
    impulse = np.column_stack([t == 0, t == 0]).astype(float)
    motion = Motion.prepare(Trajectory(t, impulse, impulse), smoothing)
    return float(np.square(motion.states(np.linspace(t[0], t[-1], 100 * fine))[2]).sum() / fine)


def _error_response(states: Array, torque: Array, settings: SegmentSettings) -> Array:
    """Return the response of rows to independent errors of both angles at each node, shape (count, 2 K, 2 nodes)."""
    step = COARSE * CELL
    _, M, slopes = linearised(padded(settings.theta), states, torque)
    MA_q, MA_v = slopes[:, :2], slopes[:, 2:]
    rate = np.gradient(M, step, axis=2)
    # Factors of the test functions and of their derivatives.
    factors = np.gradient(rate + MA_v, step, axis=2) - MA_q, 2 * rate + MA_v, M
    scale = np.sqrt(step * settings.interval * settings.angle_variance)[:, None]
    response: Array = np.zeros(1)
    for test_functions, factor in zip(_TEST_FUNCTIONS[:, :, ::COARSE], factors, strict=True):
        under = np.moveaxis(_under(factor * scale, COARSE), 2, 0)
        response = response + test_functions[None, :, None, None] * under[:, None]
    return response.reshape(len(response), 2 * K, -1)


def _under(values: Array, coarse: int = 1) -> Array:
    """Return the part of arrays (..., N) under the test functions of each block, shape (..., count, nodes)."""
    windows = np.lib.stride_tricks.sliding_window_view(values, _REACH // coarse + 1, axis=-1)
    return windows[..., :: _STEP // coarse, :]


def _test_functions() -> Array:
    """Return the test functions of a block [1/s] and two derivatives at its nodes, shape (3, K, nodes)."""
    half = WIDTH / 2
    x = np.clip((CELL * np.arange(_REACH + 1) - STRIDE * np.arange(K)[:, None]) / half - 1, -1, 1)
    r = 1 - x * x
    return np.stack([r**3, -6 * x * r**2 / half, (24 * x * x * r - 6 * r**2) / half**2]) * 35 / 32 / half


_TEST_FUNCTIONS = _test_functions()
