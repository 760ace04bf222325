# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Piecewise polynomials of time, and cubic splines.

As ``scipy.interpolate`` has them, whose import takes as long as identifying a recording.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pendubot_identification import kernel

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Piecewise:
    """C polynomials of degree K - 1 side by side, over each of N - 1 pieces of time."""

    c: Array  #: the coefficients, of the highest power first, of the time since the piece began, shape (K, N-1, C).
    x: Array  #: where pieces begin and end, shape (N,), increasing.

    def __call__(self, t: ArrayLike, order: int = 0) -> Array:
        """Return the values, or a derivative, at times of shape (...), as (..., C); the end pieces go on beyond."""
        t = np.asarray(t, dtype=float)
        if (library := kernel.library()) is not None:
            c, x, at = (np.ascontiguousarray(each, dtype=float) for each in (self.c, self.x, t))
            values = np.empty((*t.shape, c.shape[2]))
            pointers = [each.ctypes.data for each in (c, x, at, values)]
            library.pendubot_piecewise(t.size, *c.shape, order, *pointers)
            return values
        c = self.c
        for _ in range(order):
            c = c[:-1] * np.arange(len(c) - 1.0, 0.0, -1.0)[:, None, None] if len(c) > 1 else np.zeros_like(c)
        piece = np.clip(np.searchsorted(self.x, t, side='right') - 1, 0, len(self.x) - 2)
        since = (t - self.x[piece])[..., None]
        value = c[0].take(piece, axis=0)
        for row in c[1:]:
            value *= since
            value += row.take(piece, axis=0)
        return np.asarray(value)

    def antiderivative(self) -> Piecewise:
        """Return the integral since the first time."""
        degree, lasts = len(self.c), np.diff(self.x)[:, None]
        c = np.zeros((degree + 1, *self.c.shape[1:]))
        c[:-1] = self.c / np.arange(degree, 0.0, -1.0)[:, None, None]
        grown = np.zeros_like(c[0])
        for row in c:
            grown = grown * lasts + row
        np.cumsum(grown[:-1], axis=0, out=c[-1, 1:])
        return Piecewise(c, self.x)


def cubic_spline(x: Array, y: Array) -> Piecewise:
    """Return the cubic spline through ``y`` of shape (N, C) at times ``x``, shape (N,); two or three make a polynomial.

    Its third derivative is continuous also at the second and at the last but one of them ("not a knot"; de Boor, A
    Practical Guide to Splines, 1978, chapter IV).
    """
    h = np.diff(x)
    slope = np.diff(y, axis=0) / h[:, None]
    s = _slopes(y, h, slope) if len(x) > 3 else np.asarray(np.gradient(y, x, axis=0, edge_order=2 if len(x) > 2 else 1))
    bend = (s[:-1] + s[1:] - 2 * slope) / h[:, None]
    return Piecewise(np.stack([bend / h[:, None], (slope - s[:-1]) / h[:, None] - bend, s[:-1], y[:-1]]), x)


def _slopes(y: Array, h: Array, slope: Array) -> Array:
    """Return the spline's slopes at its knots, shape (N, C), by the lengths and the mean slopes of its pieces."""
    # For the slopes s at the knots: h[k] s[k-1] + 2 (h[k-1] + h[k]) s[k] + h[k-1] s[k+1] = right[k], and at both ends
    # a condition of the first two slopes; with it the first slope is taken out of the second equation.
    below, middle, above = h[1:].copy(), 2 * (h[:-1] + h[1:]), h[:-1].copy()
    right = 3 * (h[1:, None] * slope[:-1] + h[:-1, None] * slope[1:])
    first, last = h[0] + h[1], h[-1] + h[-2]
    start = ((h[0] + 2 * first) * h[1] * slope[0] + h[0] ** 2 * slope[1]) / first
    end = (h[-1] ** 2 * slope[-2] + (2 * last + h[-1]) * h[-2] * slope[-1]) / last
    middle[0] -= first
    right[0] -= start
    middle[-1] -= last
    right[-1] -= end
    below[0] = above[-1] = 0.0
    s = np.empty_like(y)
    s[1:-1] = _tridiagonal(below, middle, above, right)
    s[0] = (start - first * s[1]) / h[1]
    s[-1] = (end - last * s[-2]) / h[-2]
    return s


def _tridiagonal(below: Array, middle: Array, above: Array, right: Array) -> Array:
    """Solve ``below[k] s[k-1] + middle[k] s[k] + above[k] s[k+1] = right[k]`` for s, shape (N, C).

    That needs no pivots where the middle outweighs its neighbours, as a spline's does. Without the kernel it is done by
    cyclic reduction: every second unknown is taken out of the equations of its neighbours, until one is left.
    """
    count = len(middle)
    if (library := kernel.library()) is not None:
        spent, solved = middle.copy(), np.array(right, order='C')
        pointers = [each.ctypes.data for each in (below, spent, above, solved)]
        library.pendubot_tridiagonal(count, solved.shape[1], *pointers)
        return solved
    if count == 1:
        return np.asarray(right / middle[:, None])
    # Of unknowns 0, 2, 4 ... those between are taken out; beyond the ends there are none.
    out = slice(1, count, 2)
    inverse = 1 / middle[out]
    before, after = below[out] * inverse, above[out] * inverse
    known = right[out] * inverse[:, None]
    m, b, a, r = middle[::2].copy(), np.zeros((count + 1) // 2), np.zeros((count + 1) // 2), right[::2].copy()
    up, down = above[::2][: len(inverse)], below[2::2]
    m[: len(inverse)] -= up * before
    a[: len(inverse)] = -up * after
    r[: len(inverse)] -= up[:, None] * known
    n = len(down)
    m[1:] -= down * after[:n]
    b[1:] = -down * before[:n]
    r[1:] -= down[:, None] * known[:n]
    s = np.empty_like(right)
    s[::2] = even = _tridiagonal(b, m, a, r)
    s[out] = known - before[:, None] * even[: len(inverse)]
    s[1 : 2 * n : 2] -= after[:n, None] * even[1:]
    return s
