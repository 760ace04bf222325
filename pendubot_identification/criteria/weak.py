# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The weak criterion: residuals of both joints' momentum and of energy, under smooth test functions.

Each residual says that a function of the state, p, changes by what is done to it. Multiplied with a test function w(t)
that is zero at both ends and integrated, the change becomes ``- integral of w' p dt``: no acceleration appears.

    - integral w' p_i dt - integral w dL/dq_i dt = integral w (tau_i - friction_i) dt        for both joints
    - integral w' E dt = integral w (tau - friction) q' dt

    p1 = (P1 + P2 + 2 P3 c2) q1' + (P2 + P3 c2) q2'     dL/dq1 = -G1
    p2 = (P2 + P3 c2) q1' + (P2 + J2) q2'               dL/dq2 = -P3 s2 q1' (q1' + q2') - G2

All of this is linear in theta. The integrals are sums of the weak-form residuals of short cells of time, weighted with
w in the middle of the cell; summed by parts, that is what stands above (Messenger and Bortz, Multiscale Model. Simul.
19, 2021).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import PPoly
from scipy.optimize import minimize_scalar

from pendubot_identification.arrays import Array
from pendubot_identification.errors import TrajectoryError
from pendubot_identification.model.dynamics import GRAVITY, dry_friction_terms, energy_terms
from pendubot_identification.model.parameters import MODELS, Bounds
from pendubot_identification.trajectories.motion import Motion

from .energy import Regression, require_plausible_speed
from .quadratic import Quadratic

#: Of a test function, from zero to zero [s].
WIDTH = 0.3
#: From one test function to the next [s].
STRIDE = 0.01
#: The longest cell [s]: within it the motion of a bench-top rig is nearly straight.
LONGEST_CELL = 0.005
#: Of the weak-form residuals of the shoulder's momentum, the elbow's [both N m], and energy [W, divided by about a
#: rig's speed].
WEIGHTS = (1.0, 1.0, 1 / 3)
#: Steps of the first search for a delay [s]: pulses that change from sample to sample make a narrow valley.
DELAY_STEP = 0.005
#: A delay is 0 unless it reduces the residual below this fraction: an effort that hardly changes does not determine it.
REDUCED = 0.98
#: Columns of the largest model that no torque changes; the others are those of k1 and k2.
STILL = 12
#: Stride of the test functions in the search for a delay [s]; more of them are hardly more informative.
DELAY_STRIDE = 0.03


def weak_regression(
    motion: Motion,
    model: str,
    delay: float = 0.0,
    *,
    weights: ArrayLike = (1.0, 1.0, 1.0),
    stride: float = STRIDE,
    coarse: bool = False,
) -> Regression:
    """Return the three weak-form residuals of a motion under each of K test functions, one every ``stride`` [s].

    ``model`` is one of :data:`.parameters.MODELS`; ``delay`` that of the effort [s]: what acts at t is the torque
    recorded at t - delay; ``weights`` are factors of the three weak-form residuals, see :func:`residual_weights`. Where
    they are but compared, ``coarse`` sums over the longest cells, however near the samples are.

    Returns:
        3 K residuals [N m; of energy W times its weight] in the order of time, of each test function those of shoulder,
        elbow, energy. ``phi`` has a column for each of the model's parameters.

    Raises:
        TrajectoryError: the motion is shorter than the test function, or faster than a rig can be.
    """
    test_functions = _TestFunctions.cover(motion, stride, delay, delay, coarse)
    rows = _WeakResiduals(motion, test_functions).rows(delay) * np.reshape(weights, (3, 1))
    weighted = rows.reshape(-1, rows.shape[2])
    return Regression(weighted[:, : MODELS[model]], weighted[:, -1], np.repeat(test_functions.centres, 3))


def residual_weights(regressions: Sequence[Regression], bounds: Bounds) -> Array:
    """Return the weights that bring the three weak-form residuals to one size, shape (3,).

    Smoothed and quantised velocities spoil the energy, where they enter squared, more than the momenta, and a small
    elbow's residual would else drown in the shoulder's. The weights are found in turn with the parameters; that of the
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
        TrajectoryError: a motion is shorter than the test function and the range of delays together.
    """
    size = MODELS[model]

    def residuals_of(motion: Motion) -> _WeakResiduals:
        cover = DELAY_STRIDE, lowest, highest, True
        return motion.once(cover, lambda: _WeakResiduals(motion, _TestFunctions.cover(motion, *cover)))

    residuals = [residuals_of(motion) for motion in motions]

    def criterion_at(delay: float) -> tuple[Quadratic, float]:
        """Return the criterion, and the effort in it."""
        parts = np.stack([each.r_factors(delay) for each in residuals]) * np.reshape(weights, (3, 1, 1))
        rows = parts.reshape(-1, parts.shape[-1])
        criterion = Quadratic.reduce(rows[:, :size], rows[:, -1])
        return criterion, float(criterion(np.zeros(size)))

    def unexplained(criterion: Quadratic, effort: float) -> float:
        # Of a short recording a delay may move the only pulse out of what is compared: then there is less to explain.
        return float(criterion(criterion.minimum_in_box(bounds.of(size)))) / effort if effort > 0 else 1.0

    delays = np.linspace(lowest, highest, math.ceil((highest - lowest) / DELAY_STEP - 1e-9) + 1)
    criteria = [criterion_at(delay) for delay in delays]
    # Within bounds no more is explained than without: most delays are ruled out by that.
    without = np.array([criterion.floor / effort if effort > 0 else 1.0 for criterion, effort in criteria])
    within = np.full(len(delays), np.inf)
    for k in np.argsort(without):
        if without[k] <= within.min():
            within[k] = unexplained(*criteria[k])
    best, none = delays[np.argmin(within)], np.argmin(np.abs(delays))
    around = max(lowest, best - DELAY_STEP), min(highest, best + DELAY_STEP)
    found = minimize_scalar(
        lambda delay: unexplained(*criterion_at(delay)), bounds=around, method='bounded', options={'xatol': 1e-5}
    ).x
    reduced = unexplained(*criterion_at(found)) < REDUCED * unexplained(*criteria[none])
    return found if reduced else float(delays[none])


@dataclass(frozen=True, slots=True)
class _TestFunctions:
    """Test functions that cover a motion, and the cells of time over which they are summed."""

    origin: float  #: the motion's start [s].
    start: float  #: where the first cell begins [s].
    step: float  #: a cell's length [s].
    cells: int  #: how many there are.
    weights: Array  #: of the cells under one test function [1/s], with integral 1.
    stride: int  #: cells from one test function to the next.

    @classmethod
    def cover(cls, motion: Motion, stride: float, lowest: float, highest: float, coarse: bool) -> _TestFunctions:
        """Cover what is known of a motion for delays of the effort from ``lowest`` to ``highest`` [s]."""
        start, end = motion.start + max(highest, 0.0), motion.end + min(lowest, 0.0)
        longest = LONGEST_CELL if coarse else min(motion.interval, LONGEST_CELL)
        per_stride = math.ceil(stride / longest - 1e-9)
        step = stride / per_stride
        cells = int((end - start) / step + 1e-6)
        under = max(4, round(WIDTH / step))
        if cells < under:
            raise TrajectoryError(
                f'{motion.name}: {end - start:.3f} s with known torque are shorter than the test function of '
                f'{WIDTH:g} s; choose a longer part of the recording'
            )
        x = (np.arange(under) + 0.5) / under * 2 - 1
        test_function = (1 - x**2) ** 3
        return cls(motion.start, start, step, cells, test_function / (test_function.sum() * step), per_stride)

    def __len__(self) -> int:
        return (self.cells - len(self.weights)) // self.stride + 1

    @property
    def nodes(self) -> Array:
        """Where cells begin and end [s], shape (cells + 1,)."""
        return self.start + self.step * np.arange(self.cells + 1.0)

    @property
    def centres(self) -> Array:
        """The test functions' middles [s], shape (K,)."""
        return self.nodes[:: self.stride][: len(self)] + len(self.weights) * self.step / 2

    def columns(self, cells: dict[tuple[int, int], Array], count: int) -> Array:
        """Return the sums of cells' own integrals, shapes (cells,), by residual and column: shape (K, 3, count)."""
        result, (residual, column) = np.zeros((len(self), 3, count)), zip(*cells, strict=True)
        result[:, residual, column] = self._sums(list(cells.values()))
        return result

    def _sums(self, cells: Sequence[Array]) -> Array:
        """Return what every test function makes of n rows of cells, shape (K, n)."""
        # Neighbouring test functions are summed together, by one matrix product.
        under, count = len(self.weights), -(-len(self.weights) // self.stride)
        together, reach = count * self.stride, (count - 1) * self.stride + under
        weights = np.zeros((count, reach))
        for k, row in enumerate(weights):
            row[k * self.stride :][:under] = self.weights
        padded = np.zeros((len(cells), (len(self) - 1) // count * together + reach))
        used = min(self.cells, padded.shape[1])
        padded[:, :used] = [values[:used] for values in cells]
        windows = np.lib.stride_tricks.sliding_window_view(padded, reach, axis=1)[:, ::together]
        sums = (np.ascontiguousarray(windows) @ weights.T).reshape(len(cells), -1)
        return np.asarray(sums[:, : len(self)].T)


class _WeakResiduals:
    """The three weak-form residuals of a motion under K test functions, for the largest model and any input delay.

    What no delay changes is made once.
    """

    def __init__(self, motion: Motion, test_functions: _TestFunctions) -> None:
        self._impulse, self._test_functions, self._nodes = motion.impulse, test_functions, test_functions.nodes
        self._r_factors: dict[float, Array] = {}
        states = np.ascontiguousarray(motion.states(self._nodes))
        q, v = states[:2], states[2:]
        require_plausible_speed(motion.name, self._nodes, v.T, motion.interval)
        (q1, q2), (v1, v2), v12 = q, v, v.sum(axis=0)
        c2, gravity = np.cos(q2), GRAVITY * np.cos(q1 + q2)
        sense, stribeck, _ = np.moveaxis(dry_friction_terms(v, np.zeros_like(v)), -1, 0)
        # By residual and column what changes by what happens meanwhile: every residual is "change of this = integral of
        # that".
        change = {(0, 0): v1, (0, 1): v12, (1, 1): v12, (0, 2): c2 * (v1 + v12), (1, 2): c2 * v1, (1, 9): v2}
        change |= {(2, k): term for k, term in enumerate(energy_terms(q.T, v.T).T)} | {(2, 9): v2**2 / 2}
        happens = {(1, 2): np.sin(q2) * v1 * v12, (0, 3): GRAVITY * np.cos(q1), (0, 4): gravity, (1, 4): gravity}
        for first, friction in ((5, v), (7, sense), (10, stribeck)):
            happens |= {(joint, first + joint): friction[joint] for joint in (0, 1)}
            happens |= {(2, first + joint): friction[joint] * v[joint] for joint in (0, 1)}
        #: The columns that no torque changes, shape (K, 3, STILL).
        self._still = test_functions.columns({place: np.diff(values) for place, values in change.items()}, STILL)
        self._still += test_functions.columns(
            {place: _means(values) * test_functions.step for place, values in happens.items()}, STILL
        )
        self._sense, self._sensed = _means(sense), _means(sense * v)
        self._angles = PPoly(np.ascontiguousarray(motion.smoothed.c[:, :, :2]), motion.smoothed.x)

    def r_factors(self, delay: float) -> Array:
        """Return the R factor of the QR factorisation of each residual, shape (3, 15, 15)."""
        if delay not in self._r_factors:
            basis, r_factor = self._factors
            moved = _by_equation(self._moved(delay))
            along = basis.transpose(0, 2, 1) @ moved
            made = np.zeros((3, STILL + 3, STILL + 3))
            made[:, :STILL, :STILL], made[:, :STILL, STILL:] = r_factor, along
            made[:, STILL:, STILL:] = np.linalg.qr(moved - basis @ along, mode='r')
            self._r_factors[delay] = made
        return self._r_factors[delay]

    @cached_property
    def _factors(self) -> tuple[Array, Array]:
        """The QR factorisation of what no torque changes: most of that of all, at any delay."""
        basis, r_factor = np.linalg.qr(_by_equation(self._still))
        return basis, r_factor

    def rows(self, delay: float) -> Array:
        """Return the columns of all parameters and what the torques do, shape (K, 3, 15)."""
        return np.concatenate([self._still, self._moved(delay)], axis=2)

    def _moved(self, delay: float) -> Array:
        """Return the columns that the torques change, of k1 and k2, and what they do, shape (K, 3, 3).

        Within a cell a torque may change from sample to sample. So impulse and work are summed over the parts between
        its changes: a held torque does the work tau (q[end] - q[start]), whatever the motion in between.
        """
        nodes, impulse = self._nodes, self._impulse
        changes = impulse.x + delay
        edges = np.sort(np.concatenate([nodes, changes[(changes > nodes[0]) & (changes < nodes[-1])]]), kind='stable')
        edges = edges[np.append(True, edges[1:] > edges[:-1])]
        pushes = np.diff(impulse(edges - delay).T)
        work = (pushes / np.diff(edges) * np.diff(self._angles(edges).T)).sum(axis=0)
        cells = np.add.reduceat([*pushes, work, *np.abs(pushes)], np.searchsorted(edges, nodes[:-1]), axis=1)
        columns = {(residual, 2): cells[residual] for residual in range(3)}
        for joint, load in enumerate(cells[3:]):
            columns |= {(joint, joint): self._sense[joint] * load, (2, joint): self._sensed[joint] * load}
        return self._test_functions.columns(columns, 3)


def _by_equation(rows: Array) -> Array:
    """Return rows of shape (K, 3, C) as (3, K, C), with as many as a QR factorisation of all columns needs."""
    return np.asarray(np.pad(rows, ((0, max(0, STILL + 3 - len(rows))), (0, 0), (0, 0))).swapaxes(0, 1))


def _means(at_nodes: Array) -> Array:
    return np.asarray((at_nodes[..., 1:] + at_nodes[..., :-1]) / 2)
