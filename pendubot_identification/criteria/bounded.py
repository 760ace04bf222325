# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Least squares of few unknowns within bounds, and the lowest point of a valley.

As ``scipy.optimize`` has them (``lsq_linear``, ``minimize_scalar``), whose import takes as long as identifying a
recording.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: A slope below this, of columns and a right-hand side of size 1, is none.
LEVEL = 1e-15
GOLDEN = (3 - math.sqrt(5)) / 2


def least_squares_within(A: Array, b: Array, lower: Array, upper: Array) -> Array:
    """Return the x, shape (D,), with lower <= x <= upper that makes ``|A x - b|`` least; lower < upper.

    Bounded-variable least squares (Stark and Parker, Computational Statistics 10, 1995): what lies outside is held at
    its bound, until nothing does; then what pulls away from its bound is let go, one at a time.
    """
    x, held = np.zeros(A.shape[1]), np.zeros(A.shape[1])

    def best() -> Array:
        at, free = np.where(held < 0, lower, np.where(held > 0, upper, x)), held == 0
        at[free] = np.linalg.lstsq(A[:, free], b - A[:, ~free] @ at[~free], rcond=None)[0]
        return np.asarray(at)

    def outside(at: Array) -> Array:
        return np.asarray(np.where(at < lower, -1.0, np.where(at > upper, 1.0, 0.0)) * (held == 0))

    x = best()
    while (out := outside(x)).any():
        held += out
        x = best()
    for _ in range(10 * len(x)):
        pull = held * (A.T @ (A @ x - b))
        if not held.any() or pull.max() <= LEVEL:
            break
        held[np.argmax(pull)] = 0
        while (out := outside(at := best())).any():
            # As far as the first bound.
            bound = np.where(out < 0, lower, upper)
            part = np.where(out != 0, (bound - x) / np.where(out != 0, at - x, 1.0), np.inf)
            first = int(np.argmin(part))
            x = x + part[first] * (at - x)
            held[first] = out[first]
        x = at
    return np.asarray(np.clip(x, lower, upper))


def lowest_between(value: Callable[[float], float], low: float, high: float, tolerance: float) -> float:
    """Return where a function with one valley between two places is lowest, to a tolerance.

    By parabolas through three values, and the golden section where they lead nowhere (Brent, Algorithms for
    Minimization without Derivatives, 1973, chapter 5).
    """
    best = second = third = low + GOLDEN * (high - low)
    at_best = at_second = at_third = value(best)
    step = before = 0.0
    while True:
        middle = (low + high) / 2
        least = 1.5e-8 * abs(best) + tolerance / 3
        if abs(best - middle) <= 2 * least - (high - low) / 2:
            return best
        # The lowest point of the parabola is best + up / down.
        left, right = (best - second) * (at_best - at_third), (best - third) * (at_best - at_second)
        up, down = (best - third) * right - (best - second) * left, 2 * (left - right)
        fits = abs(before) > least and down != 0 and abs(up / down) < abs(before) / 2
        if fits and low < best + up / down < high:
            before, step = step, up / down
            if min(best + step - low, high - best - step) < 2 * least:
                step = math.copysign(least, middle - best)
        else:
            before = (low if best >= middle else high) - best
            step = GOLDEN * before
        tried = best + (step if abs(step) >= least else math.copysign(least, step))
        at_tried = value(tried)
        if at_tried <= at_best:
            low, high = (best, high) if tried >= best else (low, best)
            third, at_third, second, at_second, best, at_best = second, at_second, best, at_best, tried, at_tried
        else:
            low, high = (tried, high) if tried < best else (low, tried)
            if at_tried <= at_second or second == best:
                third, at_third, second, at_second = second, at_second, tried, at_tried
            elif at_tried <= at_third or third in (best, second):
                third, at_third = tried, at_tried
