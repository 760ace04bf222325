# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Fisher's and Student's distributions, beside those of scipy."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import fdtrc, stdtrit

from pendubot_identification.identify.significance import exceeded_by_chance, student_quantile


@given(ratio=st.floats(0, 1e4), more=st.integers(1, 40), freedom=st.floats(0.5, 1e6))
def test_fisher(ratio, more, freedom):
    expected = float(fdtrc(more, freedom, ratio))
    assert exceeded_by_chance(ratio, more, freedom) == pytest.approx(expected, rel=1e-7, abs=1e-290)


def test_of_no_number_there_is_no_chance():
    assert math.isnan(exceeded_by_chance(math.nan, 2, 10))
    assert exceeded_by_chance(math.inf, 2, 10) == 0


@given(freedom=st.integers(1, 10**6), outside=st.floats(1e-4, 0.5))
def test_student(freedom, outside):
    assert student_quantile(freedom, outside) == pytest.approx(float(stdtrit(freedom, 1 - outside / 2)), rel=1e-7)
