# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Splines and piecewise polynomials, beside those of scipy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline, PPoly

from pendubot_identification.trajectories.piecewise import Piecewise, cubic_spline
from test.model.paths import both_paths, path


@both_paths
@given(count=st.integers(2, 70), jitter=st.floats(0, 0.9), seed=st.integers(0, 2**32 - 1))
def test_a_spline_and_its_derivatives_are_those_of_scipy(compiled, count, jitter, seed):
    rng = np.random.default_rng(seed)
    x = np.cumsum(0.01 * (1 + jitter * rng.uniform(-1, 1, count)))
    y = rng.normal(size=(count, 3))
    t = rng.uniform(x[0] - 0.005, x[-1] + 0.005, (4, 5))
    theirs = CubicSpline(x, y)
    with path(compiled):
        ours = cubic_spline(x, y)
    for order in range(5):
        rounding = 1e-10 * np.abs(y).max() / np.diff(x).min() ** order
        with path(compiled):
            np.testing.assert_allclose(ours(t, order), theirs(t, order), rtol=1e-8, atol=rounding)


@given(degree=st.integers(0, 3), seed=st.integers(0, 2**32 - 1))
def test_an_antiderivative_is_that_of_scipy(degree, seed):
    rng = np.random.default_rng(seed)
    x = np.cumsum(rng.uniform(0.1, 1, 20))
    c = rng.normal(size=(degree + 1, 19, 2))
    t = rng.uniform(x[0] - 0.1, x[-1] + 0.1, 30)
    np.testing.assert_allclose(Piecewise(c, x).antiderivative()(t), PPoly(c, x).antiderivative()(t), atol=1e-9)


@both_paths
@given(columns=st.integers(1, 9), seed=st.integers(0, 2**32 - 1))
def test_times_in_any_order_and_any_number_of_columns_give_what_each_alone_gives(compiled, columns, seed):
    rng = np.random.default_rng(seed)
    x = np.sort(rng.uniform(size=40))
    made = Piecewise(rng.normal(size=(3, 39, columns)), x)
    t = np.concatenate([x, rng.uniform(-0.1, 1.1, 30)])
    rng.shuffle(t)
    with path(compiled):
        np.testing.assert_array_equal(made(t), [made(each) for each in t])
        np.testing.assert_array_equal(
            made(t), np.column_stack([Piecewise(made.c[..., k, None], x)(t) for k in range(columns)])
        )


@both_paths
def test_a_single_time_gives_a_single_value(compiled):
    line = cubic_spline(np.array([0.0, 1.0]), np.array([[0.0], [2.0]]))
    with path(compiled):
        assert line(0.25).shape == (1,)
        assert line(0.25)[0] == pytest.approx(0.5)
