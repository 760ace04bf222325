import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pendubot_identification.core.errors import ParameterError
from pendubot_identification.core.parameters import NAMES, PAPER, Bounds, Parameters, default_bounds
from test.core.strategies import physical_parameters


def test_order_of_theta_is_the_papers():
    assert NAMES == ('P1', 'P2', 'P3', 'P4', 'P5', 'b1', 'b2')
    assert PAPER.vector().tolist() == [0.002207, 0.000400, 0.000101, 0.022447, 0.003326, 0.006592, 0.00009]


@given(physical_parameters())
def test_vector_and_back_is_the_identity(parameters):
    assert Parameters.from_vector(parameters.vector()) == parameters


@given(physical_parameters())
def test_a_rig_that_can_be_built_is_physical(parameters):
    assert parameters.unphysical() == ()


@pytest.mark.parametrize(
    ('change', 'named'),
    [
        ({'P1': -1e-3}, 'P1'),
        ({'P2': 0.0}, 'P2'),
        ({'P3': 0.1}, 'positive definite'),
        ({'b1': -1e-6}, 'b1'),
        ({'b2': -1e-6}, 'b2'),
        ({'P4': float('nan')}, 'P4'),
    ],
)
def test_what_no_rig_can_have_is_named(change, named):
    values = dict(zip(NAMES, PAPER.vector(), strict=True)) | change
    assert any(named in problem for problem in Parameters(**values).unphysical())


def test_a_vector_of_another_length_is_refused():
    with pytest.raises(ParameterError, match='6 values was given, 7 are expected'):
        Parameters.from_vector(np.ones(6))


@given(st.sampled_from(NAMES), st.floats(-1, 1), st.floats(0, 1))
def test_inverted_or_empty_bounds_are_refused_by_name(name, low, excess):
    with pytest.raises(ParameterError, match=rf'{name} are inverted or empty'):
        default_bounds().replaced(name, low, low - excess)


def test_bounds_of_an_unknown_parameter_or_infinite_ones_are_refused():
    with pytest.raises(ParameterError, match="no parameter 'P9'"):
        default_bounds().replaced('P9', 0, 1)
    with pytest.raises(ParameterError, match='finite'):
        default_bounds().replaced('P1', 0, float('inf'))
    with pytest.raises(ParameterError, match='6 lower and 6 upper'):
        Bounds(np.zeros(6), np.ones(6))


def test_bounds_tell_what_lies_on_them():
    bounds = default_bounds()
    theta = PAPER.vector()
    assert not bounds.at_bound(theta).any()
    theta[5] = 0.0
    assert np.flatnonzero(bounds.at_bound(theta)).tolist() == [5]
