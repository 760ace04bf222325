# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pendubot_identification.errors import ParameterError
from pendubot_identification.model.dynamics import GRAVITY, energy
from pendubot_identification.model.parameters import (
    LARGEST_COUPLING,
    MODELS,
    NAMES,
    PAPER,
    Bounds,
    Parameters,
    default_bounds,
    repaired,
)
from test.strategies import angles, physical_parameters, velocities


@pytest.mark.parametrize(
    ('change', 'model'),
    [
        ({}, 'viscous'),
        ({'Fc1': 0.1}, 'coulomb'),
        ({'Fc2': 0.1}, 'coulomb'),
        ({'J2': 1e-4}, 'rotor'),
        *(({name: 0.1}, 'geared') for name in ('Fs1', 'Fs2', 'k1', 'k2')),
    ],
)
def test_parameters_have_the_smallest_sufficient_model_and_complete_vectors(change, model):
    parameters = replace(PAPER, **change)
    assert parameters.model == model
    for requested, size in MODELS.items():
        theta = parameters.vector(requested)
        assert len(theta) == max(size, MODELS[model])
        assert Parameters.from_vector(theta) == parameters


@pytest.mark.parametrize(
    ('change', 'text'),
    [
        ({'P1': -1e-3}, 'P1'),
        ({'P2': 0.0}, 'P2'),
        ({'P3': 0.1}, 'positive definite'),
        ({'P3': 1e300}, 'positive definite'),
        # The inertia of a rotor does not make the links physical.
        ({'P3': 0.1, 'J2': 1.0}, 'positive definite'),
        *(({name: -1e-6}, name) for name in ('b1', 'b2', 'Fc1', 'Fc2', 'J2', 'Fs1', 'Fs2', 'k1', 'k2')),
        *(({name: float('nan')}, name) for name in NAMES),
    ],
)
def test_unphysical_values_are_reported(change, text):
    (problem, *_) = replace(PAPER, **change).unphysical()
    assert text in problem


@pytest.mark.parametrize('size', [0, 6, 8, 13, 15])
def test_a_vector_of_another_length_is_refused(size):
    with pytest.raises(ParameterError, match=f'{size} values was given; 7, 9, 10, 14 are expected'):
        Parameters.from_vector(np.ones(size))


inertias = st.floats(1e-9, 1e3)


@given(inertias, inertias, st.floats(-3, 3), st.sampled_from(list(MODELS.values())))
def test_repaired_vectors_are_physical_and_differ_only_in_P3_if_necessary(P1, P2, coupling, size):
    theta = np.array([P1, P2, coupling * math.sqrt(P1 * P2), *np.linspace(1, 2, size - 3)])
    before = theta.copy()
    result = repaired(theta)
    assert result[0] * result[1] > result[2] ** 2
    assert Parameters.from_vector(result).unphysical() == ()
    np.testing.assert_array_equal(repaired([theta, result]), [result, result])
    np.testing.assert_array_equal(np.delete(result, 2), np.delete(theta, 2))
    if abs(coupling) < LARGEST_COUPLING:
        assert result[2] == theta[2]
    else:
        assert result[2] == pytest.approx(math.copysign(LARGEST_COUPLING, coupling) * math.sqrt(P1 * P2))
    np.testing.assert_array_equal(theta, before)


@pytest.mark.parametrize(
    ('name', 'low', 'high', 'sentence'),
    [
        ('P9', 0, 1, "no parameter 'P9'"),
        *(('P1', 0, high, 'the bounds of P1 are 0 to .* numbers between') for high in (math.inf, math.nan, 1e308)),
        *((name, 0.5, 0.499, f'{name} are inverted') for name in NAMES),
    ],
)
def test_invalid_bounds_are_refused_by_name(name, low, high, sentence):
    with pytest.raises(ParameterError, match=sentence):
        default_bounds().replaced(name, low, high)
    with pytest.raises(ParameterError, match='6 lower and 6 upper'):
        Bounds(np.zeros(6), np.ones(6))


@given(physical_parameters(), angles, velocities, st.floats(0.01, 1.0))
def test_a_payload_adds_the_energy_of_a_point_mass_on_link_2(rig, q, v, payload):
    (q1, q2), (v1, v2) = q, v
    l1, d = rig.P3 / rig.P5, 1.5 * rig.P2 / rig.P5
    angle, rate = q1 + q2, v1 + v2
    vx = -l1 * math.sin(q1) * v1 - d * math.sin(angle) * rate
    vy = l1 * math.cos(q1) * v1 + d * math.cos(angle) * rate
    added = payload * ((vx**2 + vy**2) / 2 + GRAVITY * (l1 * math.sin(q1) + d * math.sin(angle)))
    carrying = rig.carrying(payload)
    more, less = (energy(each.vector('geared'), q, v) for each in (carrying, rig))
    assert more == pytest.approx(less + added, rel=1e-9, abs=1e-9)
    assert not carrying.unphysical()
