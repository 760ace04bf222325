# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The conversion of recordings, its options and its corrections."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pendubot_identification.errors import ParameterError
from pendubot_identification.trajectories.conventions import TORQUE_UNITS
from pendubot_identification.trajectories.conversion import QUANTITIES, Affine, Conversion

SIGNS = st.lists(st.sampled_from(QUANTITIES), unique=True).map(lambda names: tuple(sorted(names)))
CONVERSIONS = st.builds(
    Conversion,
    degrees=st.booleans(),
    torque_unit=st.sampled_from(list(TORQUE_UNITS)),
    swap=st.sampled_from(['nothing', 'joints', 'positions', 'efforts']),
    torque_constant=st.one_of(st.just(0.0), st.floats(0.01, 10)),
    negate=SIGNS,
    elbow=st.sampled_from(['relative', 'absolute']),
    zero=st.sampled_from(['horizontal', 'hanging']),
    offset=st.dictionaries(st.sampled_from(QUANTITIES), st.floats(0.01, 3)),
)
NUMBERS = np.array([[0.3, -0.2], [1.0, 2.0], [-2.5, 0.7]])


def motion(conversion):
    return conversion.motion(np.arange(3) / 100, NUMBERS, 2 * NUMBERS, 3 * NUMBERS, 'some')


@given(CONVERSIONS)
def test_the_options_of_a_conversion_give_the_same_conversion(conversion):
    again = motion(Conversion.of(conversion.words()))
    for name in ('q', 'qd', 'tau'):
        np.testing.assert_allclose(getattr(again, name), getattr(motion(conversion), name), rtol=1e-6, atol=1e-8)


@settings(max_examples=10)
@given(CONVERSIONS, CONVERSIONS)
def test_a_conversion_is_corrected_into_another_by_options(one, other):
    """Options express the change between any two conversions with the same torque constant."""
    other = replace(other, torque_constant=one.torque_constant)
    inverse = Affine.of(np.linalg.inv(one.affine.Q), T=np.linalg.inv(one.affine.T))
    undone = inverse._replace(c=-inverse.Q @ one.affine.c, d=-inverse.T @ one.affine.d)
    corrected_conversion = one.then(other.affine.after(undone))
    assert corrected_conversion is not None
    expected, found = motion(other), motion(corrected_conversion)
    turns = (found.q - expected.q) / (2 * np.pi)
    np.testing.assert_allclose(turns, np.rint(turns), atol=1e-6)
    np.testing.assert_allclose(found.tau, expected.tau, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(found.qd, expected.qd, rtol=1e-6, atol=1e-6)


def test_changes_without_options_are_not_corrected():
    assert Conversion().then(Affine.of(T=3 * np.eye(2))) is None


@pytest.mark.parametrize(
    ('given', 'sentence'),
    [
        ({'offset': 'q1'}, "--offset 'q1' is not understood"),
        ({'offset': 'q1=x'}, '--offset q1=x is not understood; a number is expected'),
        ({'swap': 'elbows'}, 'swap is elbows; one of nothing, joints, positions, efforts is expected'),
        ({'colour': 'red'}, "'colour' is no option of the conversion"),
    ],
)
def test_invalid_options_are_one_sentence(given, sentence):
    with pytest.raises(ParameterError, match=sentence):
        Conversion.of(given)
