# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Fisher's and Student's distributions.

As ``scipy.special`` has them, whose import takes half as long as identifying a recording.
"""

from __future__ import annotations

import math

#: Beyond this change of a factor [of 1] a continued fraction goes on.
CONVERGED = 1e-15


def exceeded_by_chance(ratio: float, more: float, freedom: float) -> float:
    """Return the probability that Fisher's F of so many degrees of freedom, above and below, exceeds ``ratio``."""
    if ratio <= 0:
        return 1.0
    return _incomplete_beta(freedom / 2, more / 2, freedom / (freedom + more * ratio))


def student_quantile(freedom: float, outside: float = 0.05) -> float:
    """Return what Student's t of so many degrees of freedom exceeds, in size, with the probability ``outside``."""
    low, high = 0.0, 1.0
    while exceeded_by_chance(high**2, 1, freedom) > outside:
        low, high = high, 2 * high
    while low < (middle := (low + high) / 2) < high:
        low, high = (middle, high) if exceeded_by_chance(middle**2, 1, freedom) > outside else (low, middle)
    return high


def _incomplete_beta(a: float, b: float, x: float) -> float:
    """Return the regularised incomplete beta function (NIST Handbook of Mathematical Functions, 8.17.22)."""
    if x > (a + 1) / (a + b + 2):
        return 1 - _incomplete_beta(b, a, 1 - x)
    if x <= 0:
        return 0.0
    # The continued fraction, from its front (Lentz): below and above are the ratios of neighbouring convergents.
    above, below = 1.0, 1 / (1 - (a + b) * x / (a + 1))
    before, value, k = math.inf, below, 0
    while abs(value - before) > CONVERGED * abs(value):
        before, k = value, k + 1
        for d in (
            k * (b - k) * x / ((a + 2 * k - 1) * (a + 2 * k)),
            -(a + k) * (a + b + k) * x / ((a + 2 * k) * (a + 2 * k + 1)),
        ):
            below = 1 / (1 + d * below)
            above = 1 + d / above
            value *= above * below
    scale = a * math.log(x) + b * math.log1p(-x) + math.lgamma(a + b) - math.lgamma(a) - math.lgamma(b)
    return math.exp(scale) * value / a
