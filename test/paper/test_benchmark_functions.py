# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The four functions against their formulas written out."""

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


@pytest.mark.parametrize('function', FUNCTIONS, ids=lambda f: f.name)
@given(st.lists(st.floats(-1, 1), min_size=1, max_size=6))
def test_values_are_the_formulas_and_no_less_than_0(function, unit):
    x = function.half_width * np.array(unit)
    expected = FORMULAS[function.name](x.tolist())
    np.testing.assert_allclose(function.value([[x, 0 * x]]), [[expected, 0]], rtol=1e-12, atol=1e-9)
    assert function.value(x) >= -1e-12


def test_gradients_are_the_slopes():
    x = np.array([[0.3, -1.2], [2.0, 0.7]])
    sphere, *_, rastrigin = FUNCTIONS
    np.testing.assert_allclose(sphere.gradient(x), 2 * x, rtol=1e-6)
    np.testing.assert_allclose(rastrigin.gradient(x), 2 * x + 20 * np.pi * np.sin(2 * np.pi * x), rtol=1e-6)
