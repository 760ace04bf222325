# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A least-squares criterion reduced by QR: values and exact minimum at a cost independent of the sample count."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import lsq_linear, minimize_scalar

from pendubot_identification.arrays import Array, Flags
from pendubot_identification.errors import ParameterError
from pendubot_identification.model.parameters import LARGEST_COUPLING, MODELS, Bounds, coupling_excess

#: The model for the size of the search box, the largest factor of the default size, and the part of the box that
#: contains the least-squares solution.
SIZING, LARGEST_RIG, INNER = 'rotor', 1e6, 0.5
#: Number of rows of one factorisation, which fits into the cache and starts no threads.
BLOCK = 256


@dataclass(frozen=True, slots=True)
class Quadratic:
    """J(theta) = |phi theta - y|^2 / N, held as the R factor of the QR factorisation of [phi, y]."""

    r_factor: Array  #: shape (D+1, D+1), upper triangular.
    count: int  #: N, the number of residuals.
    #: Weight of the penalty for an indefinite mass matrix, see :class:`Penalised`.
    worth: ClassVar[float] = 0.0

    @classmethod
    def reduce(cls, phi: Array, y: Array) -> Quadratic:
        """Reduce N residuals, ``phi`` of shape (N, D) and ``y`` of shape (N,)."""
        return cls(_r_factor(np.column_stack([phi, y])), len(y))

    @classmethod
    def pool(cls, parts: Sequence[Quadratic]) -> Quadratic:
        """Return the criterion of all the residuals together."""
        return cls(_r_factor(np.vstack([part.r_factor for part in parts])), sum(part.count for part in parts))

    def scaled(self, factor: float) -> Quadratic:
        """Return the criterion of residuals multiplied by a factor."""
        return Quadratic(self.r_factor * factor, self.count)

    def along(self, directions: Array) -> Quadratic:
        """Return the criterion of x, shape (F,), where theta = directions @ x, shape (D, F)."""
        rows = np.column_stack([self.r_factor[:, :-1] @ directions, self.r_factor[:, -1]])
        return Quadratic(_r_factor(rows), self.count)

    @property
    def phi(self) -> Array:
        """The reduced regressor, shape (D, D)."""
        return self.r_factor[:-1, :-1]

    @property
    def y(self) -> Array:
        """The reduced right-hand side, shape (D,)."""
        return self.r_factor[:-1, -1]

    @property
    def floor(self) -> float:
        """The part of J that no theta removes."""
        return float(self.r_factor[-1, -1] ** 2 / self.count)

    @property
    def root(self) -> Array:
        """The R factor over the square root of N: J is |root [theta, -1]|^2."""
        return self.r_factor / math.sqrt(self.count)

    def __call__(self, theta: ArrayLike) -> Array:
        """Return J for parameter vectors of shape (..., D), as an array of shape (...).

        The sum is by columns: in BLAS, the order of addition depends on the processor, so that the same seed
        would give different results.
        """
        vectors = np.asarray(theta, dtype=float)
        x = np.ascontiguousarray(vectors.reshape(-1, vectors.shape[-1]).T)
        root = self.root
        residuals = np.repeat(-root[:-1, -1:], x.shape[1], axis=1)
        for j, component in enumerate(x):
            residuals[: j + 1] += root[: j + 1, j, None] * component
        return np.asarray((np.square(residuals).sum(axis=0) + self.floor).reshape(vectors.shape[:-1]))

    def minimum(self, bounds: Bounds) -> Array:
        """Return the exact minimiser, shape (D,), within the bounds and where M(q) is positive definite for every q.

        If the names of the bounds begin with P1, P2, P3, the minimiser lies in the convex cone |P3| <= c sqrt(P1 P2),
        c = :data:`.parameters.LARGEST_COUPLING`. For a given s = P1 / P2 the cone is linear, and bounded-variable least
        squares is exact. As the problem is convex, J has one valley over s.

        Raises:
            ParameterError: no P1, P2, P3 within the bounds lie in the cone.
        """
        theta = self.minimum_in_box(bounds)
        if bounds.names[:3] != ('P1', 'P2', 'P3') or not _coupled(theta):
            return theta
        side = float(np.sign(theta[2]))
        low, high = _ratios(bounds, side)

        def best(logarithm: float) -> Array:
            return self._of_ratio(math.exp(min(max(logarithm, low), high)), side, bounds)

        # Far from the valley J may be constant, with P1 = P2 = P3 = 0. The second search gives the last digits of a
        # minimum at a kink of J.
        coarse = np.linspace(low, high, math.ceil(high - low) + 2)
        floors = [self.along(_with_ratio(math.exp(x), len(self.y))).floor for x in coarse]
        optimum = smallest(coarse, floors, lambda x: float(self(best(x))))
        for reach in (1.0, 1e-6):
            centre = optimum

            def offset_costs(offset: float, centre: float = centre) -> float:
                return float(self(best(centre + offset)))

            how = {'bounds': (-reach, reach), 'method': 'bounded', 'options': {'xatol': 1e-9 * reach}}
            optimum = centre + min(0.0, minimize_scalar(offset_costs, **how).x, key=offset_costs)
        return np.clip(best(optimum), bounds.lower, bounds.upper)

    def minimum_in_box(self, bounds: Bounds) -> Array:
        """Return the exact minimiser within the bounds, with any mass matrix, shape (D,)."""
        return self._within(bounds.lower, bounds.upper, np.eye(len(bounds.lower)))

    def least_in_box(self, bounds: Bounds) -> float:
        """Return the least J within the bounds, with any mass matrix."""
        return float(self(self.minimum_in_box(bounds)))

    def _of_ratio(self, s: float, side: float, bounds: Bounds) -> Array:
        """Return the minimiser among the vectors with P1 = s P2."""
        directions = _with_ratio(s, len(bounds.lower))
        lower, upper = bounds.lower[1:].copy(), bounds.upper[1:].copy()
        lower[0], upper[0] = max(lower[0], bounds.lower[0] / s, 0.0), min(upper[0], bounds.upper[0] / s)
        theta = self._within(lower, upper, directions)
        if not _coupled(theta):
            return theta
        # The cone is active: P3 is proportional to P2 as well.
        coupling = side * LARGEST_COUPLING * math.sqrt(s)
        directions[2, 0] = coupling
        nearest, farthest = sorted((lower[1] / coupling, upper[1] / coupling))
        lower[0], upper[0] = max(lower[0], nearest), min(upper[0], farthest)
        return self._within(np.delete(lower, 1), np.delete(upper, 1), np.delete(directions, 1, axis=1))

    def _within(self, lower: Array, upper: Array, directions: Array) -> Array:
        """Return the minimiser among ``directions @ x``, lower <= x <= upper (bounded-variable least squares)."""
        phi = self.phi @ directions
        scale = _column_scale(phi)
        low = lower * scale
        high = np.maximum(upper * scale, low + 1e-12 * np.abs(low) + 1e-300)  # equal, or reversed by a rounding error
        x = lsq_linear(phi / scale, self.y, (low, high), 'bvls', tol=1e-15).x
        return np.asarray(directions @ np.clip(x / scale, lower, upper))

    def free_minimum(self) -> Array:
        """Return the minimiser without bounds, shape (D,); the smallest one if it is not unique."""
        scale = _column_scale(self.phi)
        return np.asarray(np.linalg.lstsq(self.phi / scale, self.y, rcond=None)[0] / scale)

    def condition_number(self, which: Flags | slice = slice(None)) -> float:
        """Return the condition number of some columns of the regressor, scaled to one; infinite if one is zero."""
        singular = np.linalg.svd((self.phi / _column_scale(self.phi))[:, which], compute_uv=False)
        return float(singular[0] / singular[-1]) if singular[-1] > 0 else float('inf')

    def undetermined(self, tolerance: float) -> Flags:
        """Return which parameters the data do not determine, shape (D,).

        Their column is zero, or they are part of a singular vector, of columns scaled to one. Its singular value is at
        most ``tolerance`` times the largest.
        """
        _, singular, right = np.linalg.svd(self.phi / _column_scale(self.phi))
        lost = np.abs(right[singular <= tolerance * singular[0]]).max(axis=0, initial=0.0) > 0.1
        return np.asarray(lost | (np.linalg.norm(self.phi, axis=0) == 0))


@dataclass(frozen=True, slots=True)
class Penalised:
    """A criterion plus a penalty for an indefinite mass matrix, for an optimiser that has only bounds."""

    criterion: Quadratic  #: of parameter vectors that begin with P1, P2, P3.
    worth: float  #: weight of the penalty :func:`.parameters.coupling_excess`.

    @classmethod
    def of(cls, criterion: Quadratic) -> Penalised:
        """Return the criterion with J at zero parameters as the weight of the penalty."""
        return cls(criterion, float(criterion(np.zeros_like(criterion.y))))

    def __call__(self, theta: Array) -> Array:
        """Return values for parameter vectors of shape (..., D), shape (...)."""
        value, theta = self.criterion(theta), np.asarray(theta, dtype=float)
        P1, P2, P3 = theta[..., 0], theta[..., 1], theta[..., 2]
        # The penalty is slow, and zero for most vectors.
        coupled = (P3 * P3 >= 0.9 * P1 * P2) | (P1 <= 0)
        if coupled.any():
            value[coupled] += self.worth * coupling_excess(theta[coupled])
        return value

    @property
    def root(self) -> Array:
        """The root of the criterion."""
        return self.criterion.root


def _column_scale(phi: Array) -> Array:
    """Return the norm of each column, shape (D,); 1 where a column is zero."""
    norms = np.linalg.norm(phi, axis=0)
    return np.asarray(np.where(norms > 0, norms, 1.0))


def smallest(points: Array, floors: ArrayLike, value: Callable[[float], float]) -> float:
    """Return the point with the smallest value; lower limits of the values, ``floors``, exclude most points."""
    least, values = np.asarray(floors), np.full(len(points), np.inf)
    for k in np.argsort(least, kind='stable'):
        if least[k] <= values.min():
            values[k] = value(float(points[k]))
    return float(points[np.argmin(values)])


def _with_ratio(s: float, size: int) -> Array:
    """Return a basis of the vectors with P1 = s P2, shape (size, size - 1): of P2, P3 and the other parameters."""
    directions = np.eye(size)[:, 1:]
    directions[0, 0] = s
    return directions


def _coupled(theta: Array) -> bool:
    """Return whether P3 is too large for P1 and P2."""
    return bool(abs(theta[2]) > LARGEST_COUPLING * math.sqrt(max(theta[0] * theta[1], 0.0)) * (1 + 1e-12))


def _ratios(bounds: Bounds, side: float) -> tuple[float, float]:
    """Return the least and the greatest log(P1 / P2) for which the cone contains a P3 of this sign in its bounds."""
    P1, P2 = bounds.upper[:2]
    P3 = max(0.0, bounds.lower[2] if side > 0 else -bounds.upper[2]) / LARGEST_COUPLING
    if P1 <= 0 or P2 <= 0 or P3**2 >= P1 * P2:
        raise ParameterError(
            f'the bounds allow at most P1 = {P1:g} and P2 = {P2:g}, and at least |P3| = {P3 * LARGEST_COUPLING:g}; '
            'P1 > 0, P2 > 0 and P1 P2 > P3^2 are expected: widen the bounds'
        )
    P3 = max(P3, 1e-5 * math.sqrt(P1 * P2))
    least = max(bounds.lower[0] / P2, (P3 / P2) ** 2)
    greatest = min(P1 / bounds.lower[1] if bounds.lower[1] > 0 else math.inf, (P1 / P3) ** 2)
    return math.log(least), math.log(greatest)


def _r_factor(rows: Array) -> Array:
    """Return the R factor of a QR factorisation, by blocks and then of their R factors."""
    width = rows.shape[1]
    block = max(BLOCK, 4 * width)
    total = len(rows) // block
    if total > 1:
        blocks = rows[: total * block].reshape(total, block, width)
        r_factors = np.asarray(np.linalg.qr(blocks, mode='r')).reshape(-1, width)
        return _r_factor(np.concatenate([r_factors, rows[total * block :]]))
    if len(rows) < width:
        rows = np.concatenate([rows, np.zeros((width - len(rows), width))])
    return np.asarray(np.linalg.qr(rows, mode='r'))


def box_factor(bounds: Bounds, criterion: Quadratic) -> float:
    """Return the power of ten, at least 1, by which default bounds must grow for a rig.

    The minimum of the least-squares criterion, of the model :data:`SIZING`, then lies in their inner half.
    """
    wide, default = (bounds.scaled(factor).of(MODELS[SIZING]) for factor in (LARGEST_RIG, 1.0))
    theta = criterion.minimum_in_box(wide)
    open_ = wide.upper > default.upper
    share = max(theta[open_] / default.upper[open_], default=0.0)
    return float(10.0 ** max(0, math.ceil(math.log10(max(share / INNER, 1.0)))))
