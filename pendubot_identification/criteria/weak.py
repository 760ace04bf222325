# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The weak criterion: residuals of both joints' momentum and of energy, under smooth test functions.

Each residual is the rate p' of a function of the state minus the forces or the power that cause it. Multiplied by a
test function w(t) that is zero at both ends, and integrated by parts, p' becomes ``- integral of w' p dt``.

    - integral w' p_i dt - integral w dL/dq_i dt = integral w (tau_i - friction_i) dt        for both joints
    - integral w' E dt = integral w (tau - friction) q' dt

    p1 = (P1 + P2 + 2 P3 c2) q1' + (P2 + P3 c2) q2'     dL/dq1 = -G1
    p2 = (P2 + P3 c2) q1' + (P2 + J2) q2'               dL/dq2 = -P3 s2 q1' (q1' + q2') - G2

All terms are linear in theta. The integrals are sums over short cells of time. The residual of each cell is
weighted with w in its middle, which is equal by summation by parts (Messenger and Bortz, Multiscale Model. Simul. 19,
2021).
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
from .quadratic import Quadratic, smallest

#: Support of a test function [s].
WIDTH = 0.3
#: Time from one test function to the next [s].
STRIDE = 0.01
#: Longest cell [s], within which the motion of a bench-top rig is nearly linear.
LONGEST_CELL = 0.005
#: Default weights of the weak-form residuals of the momentum of shoulder and elbow [N m] and of energy [W], which is
#: divided by a typical speed.
WEIGHTS = (1.0, 1.0, 1 / 3)
#: Step of the first search for a delay [s]: with pulses that change at every sample the minimum is narrow.
DELAY_STEP = 0.005
#: A delay is 0 unless it reduces the residual below this fraction: a nearly constant effort does not determine it.
REDUCED = 0.98
#: Number of columns of the largest model that do not depend on a torque: all but k1 and k2.
STILL = 12
#: Stride of the test functions in the search for a delay [s]; a smaller one adds little information.
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
    """Return the weak-form residuals of a motion under each of K test functions, one every ``stride`` [s].

    ``model`` is one of :data:`.parameters.MODELS`. ``delay`` is the input delay [s]: the torque recorded at t - delay
    acts at t. ``weights`` are factors of the three residuals, see :func:`residual_weights`; two omit the energy.
    ``coarse`` sums over the longest cells, which suffices for comparisons.

    Returns:
        Residuals [N m; of energy W times its weight] in the order of time, one for each weight: shoulder, elbow and
        energy under each test function. ``phi`` has a column for each parameter of the model.

    Raises:
        TrajectoryError: the motion is shorter than the test function, or faster than a rig can be.
    """
    test_functions = _TestFunctions.cover(motion, stride, delay, delay, coarse)
    factors = np.reshape(weights, (-1, 1))
    rows = _WeakResiduals(motion, test_functions).rows(delay)[:, : len(factors)] * factors
    weighted = rows.reshape(-1, rows.shape[2])
    return Regression(weighted[:, : MODELS[model]], weighted[:, -1], np.repeat(test_functions.centres, len(factors)))


def residual_weights(regressions: Sequence[Regression], bounds: Bounds) -> Array:
    """Return the weights that give the three weak-form residuals the same size, shape (3,).

    Errors of velocities affect the energy, in which they are squared, more than the momenta; and the residual of a
    small elbow is small. Weights and parameters are estimated in turn. The weight of the shoulder stays 1, so that J
    keeps its unit. ``regressions``: one for each recording, by :func:`weak_regression` with all weights 1.
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
    """Return the delay of the effort [s], from lowest to highest, with the least unexplained fraction of the effort.

    It is negative if the recorded torque lags behind the acting torque.

    Raises:
        TrajectoryError: a motion is shorter than the test function and the range of delays together.
    """
    size = MODELS[model]

    def residuals_of(motion: Motion) -> _WeakResiduals:
        cover = DELAY_STRIDE, lowest, highest, True
        return motion.once(cover, lambda: _WeakResiduals(motion, _TestFunctions.cover(motion, *cover)))

    residuals = [residuals_of(motion) for motion in motions]

    def criterion_at(delay: float) -> tuple[Quadratic, float]:
        """Return the criterion, and its value at zero parameters: the mean square of the effort."""
        parts = np.stack([each.r_factors(delay) for each in residuals]) * np.reshape(weights, (3, 1, 1))
        rows = parts.reshape(-1, parts.shape[-1])
        criterion = Quadratic.reduce(rows[:, :size], rows[:, -1])
        return criterion, float(criterion(np.zeros(size)))

    def unexplained(criterion: Quadratic, effort: float) -> float:
        # In a short recording, a delay may move the only pulse outside the test functions, which reduces the effort.
        return criterion.least_in_box(bounds.of(size)) / effort if effort > 0 else 1.0

    delays = np.linspace(lowest, highest, math.ceil((highest - lowest) / DELAY_STEP - 1e-9) + 1)
    criteria = {delay: criterion_at(delay) for delay in delays.tolist()}
    floors = [criterion.floor / effort if effort > 0 else 1.0 for criterion, effort in criteria.values()]
    best, none = smallest(delays, floors, lambda delay: unexplained(*criteria[delay])), min(max(0.0, lowest), highest)
    around = max(lowest, best - DELAY_STEP), min(highest, best + DELAY_STEP)
    found = minimize_scalar(
        lambda delay: unexplained(*criterion_at(delay)), bounds=around, method='bounded', options={'xatol': 1e-5}
    ).x
    reduced = unexplained(*criterion_at(found)) < REDUCED * unexplained(*criterion_at(none))
    return found if reduced else none


@dataclass(frozen=True, slots=True)
class _TestFunctions:
    """Test functions that cover a motion, and the cells of time over which they are summed."""

    start: float  #: start of the first cell [s].
    step: float  #: duration of a cell [s].
    cells: int  #: number of cells.
    weights: Array  #: of the cells under one test function [1/s], with integral 1.
    stride: int  #: number of cells from one test function to the next.

    @classmethod
    def cover(cls, motion: Motion, stride: float, lowest: float, highest: float, coarse: bool) -> _TestFunctions:
        """Cover the part of a motion with known torque for all delays from ``lowest`` to ``highest`` [s]."""
        start, end = motion.start + max(highest, 0.0), motion.end + min(lowest, 0.0)
        longest = LONGEST_CELL if coarse else min(motion.interval, LONGEST_CELL)
        per_stride = math.ceil(stride / longest - 1e-9)
        step = stride / per_stride
        cells = int((end - start) / step + 1e-6)
        under = max(4, round(WIDTH / step))
        if cells < under:
            raise TrajectoryError(
                f'{motion.name}: {max(end - start, 0.0):.3f} s with known torque are shorter than the test function of '
                f'{WIDTH:g} s; choose a longer part of the recording'
            )
        x = (np.arange(under) + 0.5) / under * 2 - 1
        test_function = (1 - x**2) ** 3
        return cls(start, step, cells, test_function / (test_function.sum() * step), per_stride)

    def __len__(self) -> int:
        return (self.cells - len(self.weights)) // self.stride + 1

    @property
    def nodes(self) -> Array:
        """The boundaries of the cells [s], shape (cells + 1,)."""
        return self.start + self.step * np.arange(self.cells + 1.0)

    @property
    def centres(self) -> Array:
        """The middle of each test function [s], shape (K,)."""
        return self.nodes[:: self.stride][: len(self)] + len(self.weights) * self.step / 2

    def columns(self, cells: dict[tuple[int, int], Array], count: int) -> Array:
        """Return the weighted sums, shape (K, 3, count), of cells, shape (cells,), by residual and column."""
        result, (residual, column) = np.zeros((len(self), 3, count)), zip(*cells, strict=True)
        result[:, residual, column] = self._sums(list(cells.values()))
        return result

    def _sums(self, cells: Sequence[Array]) -> Array:
        """Return the weighted sum of n rows of cells under every test function, shape (K, n)."""
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

    Columns that do not depend on a torque are computed once.
    """

    def __init__(self, motion: Motion, test_functions: _TestFunctions) -> None:
        self._impulse, self._test_functions, self._nodes = motion.impulse, test_functions, test_functions.nodes
        self._r_factors: dict[float, Array] = {}
        states = np.ascontiguousarray(motion.states(self._nodes))
        q, v = states[:2], states[2:]
        require_plausible_speed(motion.name, self._nodes, v.T, motion.interval)
        (q1, q2), (v1, v2), v12 = q, v, v.sum(axis=0)
        c2, gravity = np.cos(q2), GRAVITY * np.cos(q1 + q2)
        sign, stribeck, _ = np.moveaxis(dry_friction_terms(v, np.zeros_like(v)), -1, 0)
        # By residual and column: every residual is "change of a function of the state = integral of a rate".
        change = {(0, 0): v1, (0, 1): v12, (1, 1): v12, (0, 2): c2 * (v1 + v12), (1, 2): c2 * v1, (1, 9): v2}
        change |= {(2, k): term for k, term in enumerate(energy_terms(q.T, v.T).T)} | {(2, 9): v2**2 / 2}
        rates = {(1, 2): np.sin(q2) * v1 * v12, (0, 3): GRAVITY * np.cos(q1), (0, 4): gravity, (1, 4): gravity}
        for first, friction in ((5, v), (7, sign), (10, stribeck)):
            rates |= {(joint, first + joint): friction[joint] for joint in (0, 1)}
            rates |= {(2, first + joint): friction[joint] * v[joint] for joint in (0, 1)}
        #: The columns that do not depend on a torque, shape (K, 3, STILL).
        self._fixed = test_functions.columns({place: np.diff(values) for place, values in change.items()}, STILL)
        self._fixed += test_functions.columns(
            {place: _means(values) * test_functions.step for place, values in rates.items()}, STILL
        )
        self._sign, self._sign_speed = _means(sign), _means(sign * v)
        self._angles = PPoly(np.ascontiguousarray(motion.smoothed.c[:, :, :2]), motion.smoothed.x)

    def r_factors(self, delay: float) -> Array:
        """Return the R factor of the QR factorisation of each residual, shape (3, 15, 15)."""
        if delay not in self._r_factors:
            basis, r_factor = self._factors
            columns = _by_equation(self._torque_columns(delay))
            along = basis.transpose(0, 2, 1) @ columns
            r_factors = np.zeros((3, STILL + 3, STILL + 3))
            r_factors[:, :STILL, :STILL], r_factors[:, :STILL, STILL:] = r_factor, along
            r_factors[:, STILL:, STILL:] = np.linalg.qr(columns - basis @ along, mode='r')
            self._r_factors[delay] = r_factors
        return self._r_factors[delay]

    @cached_property
    def _factors(self) -> tuple[Array, Array]:
        """The QR factorisation of the columns that do not depend on a torque, for any delay."""
        basis, r_factor = np.linalg.qr(_by_equation(self._fixed))
        return basis, r_factor

    def rows(self, delay: float) -> Array:
        """Return the columns of all parameters and the right-hand side, shape (K, 3, 15)."""
        return np.concatenate([self._fixed, self._torque_columns(delay)], axis=2)

    def _torque_columns(self, delay: float) -> Array:
        """Return the columns of k1 and k2, and the impulse and work of the torques, shape (K, 3, 3).

        A torque may change within a cell. Therefore impulse and work are summed between its changes: a held torque does
        the work tau (q[end] - q[start]), independent of the motion in between.
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
            columns |= {(joint, joint): self._sign[joint] * load, (2, joint): self._sign_speed[joint] * load}
        return self._test_functions.columns(columns, 3)


def _by_equation(rows: Array) -> Array:
    """Return rows of shape (K, 3, C) as (3, K, C), padded with zeros for a QR factorisation of all columns."""
    return np.asarray(np.pad(rows, ((0, max(0, STILL + 3 - len(rows))), (0, 0), (0, 0))).swapaxes(0, 1))


def _means(at_nodes: Array) -> Array:
    return np.asarray((at_nodes[..., 1:] + at_nodes[..., :-1]) / 2)
