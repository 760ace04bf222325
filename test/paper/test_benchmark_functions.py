# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The four functions against their formulas written out, and their gradients against differences."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pendubot_identification.paper.benchmark_functions import FUNCTIONS

FORMULAS = {
    'Sphere': lambda x: sum(a * a for a in x),
    'Griewank': lambda x: (
        sum(a * a for a in x) / 4000 - math.prod(math.cos(a / math.sqrt(i)) for i, a in enumerate(x, start=1)) + 1
    ),
    'Ackley': lambda x: (
        -20 * math.exp(-0.2 * math.sqrt(sum(a * a for a in x) / len(x)))
        - math.exp(sum(math.cos(2 * math.pi * a) for a in x) / len(x))
        + 20
        + math.e
    ),
    'Rastrigin': lambda x: 10 * len(x) + sum(a * a - 10 * math.cos(2 * math.pi * a) for a in x),
}
points = st.lists(st.floats(-1, 1), min_size=1, max_size=6)


@pytest.mark.parametrize('function', FUNCTIONS, ids=lambda f: f.name)
@given(points)
def test_values_are_the_formulas(function, unit):
    x = function.half_width * np.array(unit)
    assert float(function.value(x)) == pytest.approx(FORMULAS[function.name](x.tolist()), abs=1e-9, rel=1e-12)
    assert float(function.value(x)) >= -1e-12


@pytest.mark.parametrize('function', FUNCTIONS, ids=lambda f: f.name)
@given(points)
def test_gradients_are_the_slopes(function, unit):
    x = function.half_width * np.array(unit)
    if function.name == 'Ackley' and np.abs(x).max() < 1e-2:
        return  # a kink, where differences mean nothing
    h = 1e-6 * function.half_width
    steps = h * np.eye(len(x))
    slopes = (function.value(x + steps) - function.value(x - steps)) / (2 * h)
    scale = 1 + np.abs(slopes).max()
    np.testing.assert_allclose(function.gradient(x), slopes, atol=2e-4 * scale)


@pytest.mark.parametrize('function', FUNCTIONS, ids=lambda f: f.name)
def test_the_minimum_is_0_at_0_and_any_number_of_points_is_taken_at_once(function):
    assert float(function.value(np.zeros(5))) == pytest.approx(0, abs=1e-14)
    np.testing.assert_array_equal(function.gradient(np.zeros(5)), 0)
    bounds = function.bounds(3)
    assert bounds.upper.tolist() == [function.half_width] * 3 == (-bounds.lower).tolist()
    x = np.random.default_rng(1).uniform(bounds.lower, bounds.upper, (4, 7, 3))
    assert function.value(x).shape == (4, 7)
    assert function.gradient(x).shape == (4, 7, 3)
    np.testing.assert_array_equal(function.value(x)[2, 3], function.value(x[2, 3]))
    np.testing.assert_allclose(function.gradient(x)[2, 3], function.gradient(x[2, 3]), rtol=1e-13)
