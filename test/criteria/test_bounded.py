# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Least squares within bounds and the lowest point of a valley, beside those of scipy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from pendubot_identification.criteria.bounded import least_squares_within, lowest_between


@given(
    unknowns=st.integers(1, 12),
    width=st.floats(0.01, 10),
    twice=st.booleans(),
    seed=st.integers(0, 2**32 - 1),
)
def test_nothing_within_the_bounds_is_better_than_what_scipy_finds(unknowns, width, twice, seed):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(unknowns + 3, unknowns))
    if twice:  # a column that says nothing new
        A[:, -1] = A[:, 0]
    A /= np.linalg.norm(A, axis=0)
    b = rng.normal(size=unknowns + 3)
    lower = rng.normal(size=unknowns) - width / 2
    upper = lower + width * rng.uniform(0.1, 1, unknowns)
    x = least_squares_within(A, b, lower, upper)
    assert (x >= lower).all()
    assert (x <= upper).all()
    theirs = lsq_linear(A, b, (lower, upper), method='bvls', tol=1e-15).x
    assert np.linalg.norm(A @ x - b) <= np.linalg.norm(A @ theirs - b) + 1e-9


@given(at=st.floats(-0.99, 0.99), power=st.sampled_from([1.0, 1.5, 2.0, 4.0]), slope=st.floats(0.3, 3))
def test_the_lowest_point_of_a_valley_is_found(at, power, slope):
    calls = []

    def value(x: float) -> float:
        calls.append(x)
        return (slope if x > at else 1.0) * abs(x - at) ** power

    assert lowest_between(value, -1.0, 1.0, 1e-6) == pytest.approx(at, abs=1e-6 if power <= 2 else 1e-3)
    assert all(-1 < x < 1 for x in calls)
    assert len(calls) < 100


def test_a_valley_that_ends_at_a_side_is_followed_to_it():
    assert lowest_between(math.exp, -1.0, 2.0, 1e-6) == pytest.approx(-1, abs=1e-6)
