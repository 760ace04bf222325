# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The weak criterion: the balances of both joints' momentum and of energy, weighted in time by smooth bumps.

Each balance says that a function of the state, p, changes by what is done to it. Multiplied with a bump w(t) that is
zero at both ends and integrated, the change becomes ``- integral of w' p dt``: no acceleration appears.

    - integral w' p_i dt - integral w dL/dq_i dt = integral w (tau_i - friction_i) dt        for both joints
    - integral w' E dt = integral w (tau - friction) q' dt

    p1 = (P1 + P2 + 2 P3 c2) q1' + (P2 + P3 c2) q2'     dL/dq1 = -G1
    p2 = (P2 + P3 c2) q1' + (P2 + J2) q2'               dL/dq2 = -P3 s2 q1' (q1' + q2') - G2

All of this is linear in theta. The integrals are sums of the balances of short cells of time, weighted with w in the
middle of the cell; summed by parts, that is what stands above (Messenger and Bortz, Multiscale Model. Simul. 19, 2021).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize_scalar

from pendubot_identification.errors import TrajectoryError
from pendubot_identification.model.dynamics import GRAVITY, dry_friction_terms, energy_terms
from pendubot_identification.model.parameters import MODELS, Bounds
from pendubot_identification.trajectories.motion import AnyMotion, Motion

from .energy import Regression, Residuals, require_plausible_speed
from .quadratic import Quadratic

Array = NDArray[np.float64]

#: Of a bump, from zero to zero [s].
WIDTH = 0.3
#: From one bump to the next [s].
STRIDE = 0.01
#: The longest cell [s]: within it the motion of a bench-top rig is nearly straight.
LONGEST_CELL = 0.005
#: Of the balances of the shoulder's momentum, the elbow's [both N m], and energy [W, divided by about a rig's speed].
WEIGHTS = (1.0, 1.0, 1 / 3)
#: Steps of the first search for a delay [s]: pulses that change from sample to sample make a narrow valley.
DELAY_STEP = 0.005
#: An effort that hardly changes says nothing of its delay: one that leaves more than this fraction of what none
#: leaves unexplained is not looked at.
TELLING = 0.98
#: How often bumps begin in the search for a delay [s]; more of them tell little more.
DELAY_STRIDE = 0.03


def weak_regression(
    motion: Motion, model: str, delay: float = 0.0, *, weights: ArrayLike = (1.0, 1.0, 1.0), stride: float = STRIDE
) -> Regression:
    """Return the three balances of a motion under each of K bumps, one every ``stride`` [s].

    ``model`` is one of :data:`.parameters.MODELS`; ``delay`` that of the effort [s]: what acts at t is the torque
    recorded at t - delay; ``weights`` are factors of the three balances, see :func:`balance_weights`.

    Returns:
        3 K residuals [N m; of energy W times its weight] in the order of time, of each bump those of shoulder, elbow,
        energy. ``phi`` has a column for each of the model's parameters.

    Raises:
        TrajectoryError: the motion is shorter than the bump, or faster than a rig can be.
    """
    return _regression(motion, _Bumps.cover(motion, stride, delay, delay), MODELS[model], delay, weights)


def weak_residuals(motion: AnyMotion, model: str, delay: float, weights: ArrayLike) -> Residuals:
    """Return the same of a motion that may be long, in parts, which may raise what :func:`weak_regression` does."""
    bumps = _Bumps.cover(motion, STRIDE, delay, delay)

    def parts() -> Iterator[Regression]:
        for piece, begin, end in motion.pieces(WIDTH + abs(delay)):
            own = bumps.between(begin, end)
            if len(own):
                yield _regression(piece, own, MODELS[model], delay, weights)

    return Residuals(3 * len(bumps), bumps.stride * bumps.step * (len(bumps) - 1), parts)


def _regression(motion: Motion, bumps: _Bumps, size: int, delay: float, weights: ArrayLike) -> Regression:
    phi, y = _state_columns(motion, bumps, size), _torque_columns(motion, bumps, size, delay)
    rows = _weighted(phi, y, weights)
    return Regression(rows[:, :-1], rows[:, -1], np.repeat(bumps.centres, 3))


def _weighted(phi: Array, y: Array, weights: ArrayLike) -> Array:
    """Return all columns together, each balance times its weight, shape (3 K, D + 1)."""
    rows = np.concatenate([phi, y], axis=2)
    return np.asarray((rows * np.reshape(weights, (3, 1))).reshape(-1, rows.shape[2]))


def balance_weights(regressions: Sequence[Regression], bounds: Bounds) -> Array:
    """Return the weights of the three balances with which their residuals are of one size, shape (3,).

    Smoothed and quantised velocities spoil the energy, where they enter squared, more than the momenta, and a small
    elbow's balance would else drown in the shoulder's. The weights are found in turn with the parameters; that of the
    shoulder stays 1, so that J keeps its unit. ``regressions``: of :func:`weak_regression`, all weights 1, one a
    recording.
    """
    parts = [Quadratic.pool([Quadratic.reduce(r.phi[k::3], r.y[k::3]) for r in regressions]) for k in range(3)]
    least = 1e-10 * max(float(part(np.zeros(len(bounds.names)))) for part in parts) + np.finfo(float).tiny
    weights = np.ones(3)
    for _ in range(3):
        theta = Quadratic.pool([part.scaled(w) for part, w in zip(parts, weights, strict=True)]).minimum(bounds)
        size = np.array([float(part(theta)) for part in parts]) + least
        weights = np.sqrt(size[0] / size)
    return weights


def estimate_delay(
    motions: Sequence[Motion],
    model: str,
    bounds: Bounds,
    lowest: float = -0.1,
    highest: float = 0.1,
    *,
    weights: ArrayLike = WEIGHTS,
) -> float:
    """Return the delay of the effort [s] with which motions of one rig are explained best, from lowest to highest.

    It is negative where the recorded torque lags behind the one that acted.

    Raises:
        TrajectoryError: a motion is shorter than the bump and the range of delays together.
    """
    size = MODELS[model]
    bumps = [_Bumps.cover(motion, DELAY_STRIDE, lowest, highest) for motion in motions]
    phi = [_state_columns(motion, cover, size) for motion, cover in zip(motions, bumps, strict=True)]

    def unexplained(delay: float) -> float:
        y = [_torque_columns(motion, cover, size, delay) for motion, cover in zip(motions, bumps, strict=True)]
        rows = np.concatenate([_weighted(*part, weights) for part in zip(phi, y, strict=True)])
        criterion = Quadratic.reduce(rows[:, :-1], rows[:, -1])
        # Of a short recording a delay may move the only pulse out of what is compared: then there is less to explain.
        effort = float(criterion(np.zeros(size)))
        return float(criterion(criterion.minimum_in_box(bounds.of(size)))) / effort if effort > 0 else 1.0

    delays = np.linspace(lowest, highest, math.ceil((highest - lowest) / DELAY_STEP - 1e-9) + 1)
    unexplained_at = np.array([unexplained(delay) for delay in delays])
    best, none = delays[np.argmin(unexplained_at)], np.argmin(np.abs(delays))
    around = max(lowest, best - DELAY_STEP), min(highest, best + DELAY_STEP)
    found = minimize_scalar(unexplained, bounds=around, method='bounded', options={'xatol': 1e-5})
    return float(found.x if found.fun < TELLING * unexplained_at[none] else delays[none])


@dataclass(frozen=True, slots=True)
class _Bumps:
    """Bumps that cover a motion or a part of it, and the cells of time over which they are summed."""

    origin: float  #: the motion's start [s].
    start: float  #: where the first cell of the motion begins [s].
    step: float  #: a cell's length [s].
    first: int  #: the number of the first cell under these bumps.
    cells: int  #: how many there are.
    weights: Array  #: of the cells under one bump [1/s], with integral 1.
    stride: int  #: cells from one bump to the next.

    @classmethod
    def cover(cls, motion: AnyMotion, stride: float, lowest: float, highest: float) -> _Bumps:
        """Cover what is known of a motion for delays of the effort from ``lowest`` to ``highest`` [s]."""
        start, end = motion.start + max(highest, 0.0), motion.end + min(lowest, 0.0)
        per_stride = math.ceil(stride / min(motion.interval, LONGEST_CELL) - 1e-9)
        step = stride / per_stride
        cells = int((end - start) / step + 1e-6)
        under = max(4, round(WIDTH / step))
        if cells < under:
            raise TrajectoryError(
                f'{motion.name}: {end - start:.3f} s with known torque are shorter than the bump of {WIDTH:g} s; '
                'choose a longer part of the recording'
            )
        x = (np.arange(under) + 0.5) / under * 2 - 1
        bump = (1 - x**2) ** 3
        return cls(motion.start, start, step, 0, cells, bump / (bump.sum() * step), per_stride)

    def __len__(self) -> int:
        return (self.cells - len(self.weights)) // self.stride + 1

    def between(self, begin: float, end: float) -> _Bumps:
        """Return the bumps that begin at begin <= t < end [s]."""
        places = (np.array([begin, end]) - self.start) / (self.step * self.stride)
        low, high = np.clip(np.ceil(places), 0, len(self)).astype(int).tolist()
        cells = (high - low - 1) * self.stride + len(self.weights)
        return replace(self, first=self.first + low * self.stride, cells=cells)

    @property
    def nodes(self) -> Array:
        """Where cells begin and end [s], shape (cells + 1,)."""
        return self.start + self.step * np.arange(self.first, self.first + self.cells + 1.0)

    @property
    def centres(self) -> Array:
        """The bumps' middles [s], shape (K,)."""
        return self.nodes[:: self.stride][: len(self)] + len(self.weights) * self.step / 2

    def integrate(self, cells: Array) -> Array:
        """Return what every bump makes of cells' own integrals, shape (cells, ...) to (K, ...)."""
        flat = cells.reshape(len(cells), -1)
        under = np.lib.stride_tricks.sliding_window_view(flat, len(self.weights), axis=0)[:: self.stride]
        return np.asarray((under @ self.weights).reshape(-1, *cells.shape[1:]))


def _state_columns(motion: Motion, bumps: _Bumps, size: int) -> Array:
    """Return the columns of theta that the torque does not change: all but k1 and k2, shape (K, 3, 7 to 12)."""
    nodes = bumps.nodes
    states = motion.states(nodes)
    q, v = states[:2].T, states[2:].T
    require_plausible_speed(motion.name, nodes - bumps.origin, v)
    s2, c2 = np.sin(q[:, 1]), np.cos(q[:, 1])
    v1, v2 = v.T
    v12 = v1 + v2
    dry = dry_friction_terms(v, np.zeros_like(v))
    # What changes by what happens meanwhile: every balance is "change of this = integral of that".
    change = np.zeros((len(q), 3, min(size, 12)))
    change[:, 0, 0] = v1
    change[:, :2, 1] = v12[:, None]
    change[:, 0, 2] = c2 * (v1 + v12)
    change[:, 1, 2] = c2 * v1
    change[:, 2, :5] = energy_terms(q, v)
    happens = np.zeros_like(change)
    happens[:, 1, 2] = s2 * v1 * v12
    happens[:, 0, 3] = GRAVITY * np.cos(q[:, 0])
    happens[:, :2, 4] = GRAVITY * np.cos(q[:, :1] + q[:, 1:])
    for first, friction in ((5, v), (7, dry[..., 0]), (10, dry[..., 1])):
        if first < size:
            happens[:, [0, 1], [first, first + 1]] = friction
            happens[:, 2, first : first + 2] = friction * v
    if size > 9:
        change[:, 1, 9] = v2
        change[:, 2, 9] = v2**2 / 2
    return bumps.integrate(np.diff(change, axis=0) + _means(happens) * bumps.step)


def _torque_columns(motion: Motion, bumps: _Bumps, size: int, delay: float) -> Array:
    """Return the columns of k1 and k2, where the model has them, and what the torques do, shape (K, 3, 1 or 3).

    Within a cell a torque may change from sample to sample. So impulse and work are summed over the parts between
    its changes: a held torque does the work tau (q[end] - q[start]), whatever the motion in between.
    """
    nodes, changes = bumps.nodes, motion.impulse.x + delay
    edges = np.union1d(nodes, changes[(changes > nodes[0]) & (changes < nodes[-1])])
    impulse = np.diff(motion.impulse(edges - delay), axis=0)
    work = impulse / np.diff(edges)[:, None] * np.diff(motion.states(edges)[:2].T, axis=0)
    parts = np.concatenate([impulse, np.abs(impulse), work.sum(axis=1, keepdims=True)], axis=1)
    cells = np.add.reduceat(parts, np.searchsorted(edges, nodes[:-1]))
    columns = np.zeros((len(cells), 3, 1 if size < 14 else 3))
    columns[:, :2, -1], columns[:, 2, -1] = cells[:, :2], cells[:, 4]
    if size == 14:
        v = motion.states(nodes)[2:].T
        sign = dry_friction_terms(v, np.zeros_like(v))[..., 0]
        columns[:, [0, 1], [0, 1]] = _means(sign) * cells[:, 2:4]
        columns[:, 2, :2] = _means(sign * v) * cells[:, 2:4]
    return bumps.integrate(columns)


def _means(at_nodes: Array) -> Array:
    return np.asarray((at_nodes[1:] + at_nodes[:-1]) / 2)
