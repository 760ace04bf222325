"""A least-squares criterion reduced once by QR: its value and its exact minimum, whatever the number of samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import lsq_linear

from .parameters import Bounds

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Quadratic:
    """J(theta) = |phi theta - y|^2 / N, held as the triangle of the QR factorisation of [phi, y].

    Attributes:
        triangle: shape (D+1, D+1), upper triangular.
        count: N, the number of residuals it stands for.
    """

    triangle: Array
    count: int

    @classmethod
    def reduce(cls, phi: Array, y: Array) -> Quadratic:
        """Reduce N residuals, ``phi`` of shape (N, D) and ``y`` of shape (N,)."""
        return cls(_triangle(np.column_stack([phi, y])), len(y))

    @classmethod
    def pool(cls, parts: Sequence[Quadratic]) -> Quadratic:
        """Return the criterion of all the residuals together."""
        return cls(_triangle(np.vstack([part.triangle for part in parts])), sum(part.count for part in parts))

    @property
    def phi(self) -> Array:
        """The reduced regressor, shape (D, D)."""
        return self.triangle[:-1, :-1]

    @property
    def y(self) -> Array:
        """The reduced right-hand side, shape (D,)."""
        return self.triangle[:-1, -1]

    @property
    def floor(self) -> float:
        """The part of J that no theta removes."""
        return float(self.triangle[-1, -1] ** 2 / self.count)

    def __call__(self, theta: ArrayLike) -> Array:
        """Return J for parameter vectors of shape (..., D), as an array of shape (...)."""
        residual = np.asarray(theta) @ self.phi.T
        residual -= self.y
        residual *= residual
        return np.asarray(residual.sum(axis=-1) / self.count + self.floor)

    def minimum(self, bounds: Bounds) -> Array:
        """Return the exact minimiser within the bounds, shape (D,) (bounded-variable least squares)."""
        scale = self.column_scale()
        solution = lsq_linear(
            self.phi / scale, self.y, (bounds.lower * scale, bounds.upper * scale), method='bvls', tol=1e-15
        )
        return np.asarray(np.clip(solution.x / scale, bounds.lower, bounds.upper))

    def free_minimum(self) -> Array:
        """Return the minimiser without bounds, shape (D,); the smallest one where many are as good."""
        scale = self.column_scale()
        return np.asarray(np.linalg.lstsq(self.phi / scale, self.y, rcond=None)[0] / scale)

    def column_scale(self) -> Array:
        """Return the norm of each regressor column, shape (D,); 1 where a column is zero."""
        norms = np.linalg.norm(self.phi, axis=0)
        return np.asarray(np.where(norms > 0, norms, 1.0))

    def condition_number(self) -> float:
        """Return the condition number of the regressor with columns scaled to one; infinite if one is zero."""
        singular = np.linalg.svd(self.phi / self.column_scale(), compute_uv=False)
        return float(singular[0] / singular[-1]) if singular[-1] > 0 else float('inf')

    def undetermined(self, tolerance: float) -> NDArray[np.bool_]:
        """Tell, per parameter, whether it cannot be told from the data, shape (D,).

        It cannot when its column is zero or when it takes part in a combination of parameters (of columns scaled to
        one) to which the residuals respond ``tolerance`` times less than to the strongest one.
        """
        scale = self.column_scale()
        _, singular, right = np.linalg.svd(self.phi / scale)
        silent = np.abs(right[singular <= tolerance * singular[0]]).max(axis=0, initial=0.0) > 0.1
        return np.asarray(silent | (np.linalg.norm(self.phi, axis=0) == 0))


def _triangle(rows: Array) -> Array:
    width = rows.shape[1]
    if len(rows) < width:
        rows = np.vstack([rows, np.zeros((width - len(rows), width))])
    return np.asarray(np.linalg.qr(rows, mode='r'))
