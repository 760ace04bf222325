# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Physical links with given parameters, and the drawn robot of their lengths."""

import math
from dataclasses import replace

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from urdf_parser_py.urdf import URDF

from pendubot_identification.errors import ParameterError
from pendubot_identification.formats.robots import drawn, rig_of
from pendubot_identification.model.parameters import BALANCE, Parameters
from test.conftest import ROOT

sizes = st.floats(1e-6, 1e2)


def parameters(first, second):
    """Return the parameters of links by the definitions of P1 to P5."""
    return (
        first.mass * first.centre**2 + second.mass * first.length**2 + first.inertia,
        second.mass * second.centre**2 + second.inertia,
        second.mass * first.length * second.centre,
        first.mass * first.centre + second.mass * first.length,
        second.mass * second.centre,
    )


@given(sizes, sizes, st.floats(0.001, 0.999), st.floats(-10, 10), sizes, st.sampled_from([-1, 1]))
def test_every_physical_vector_has_links(P1, P2, coupling, P4, P5, sign):
    """The second centre of mass may lie on either side of the elbow."""
    P3 = coupling * np.sqrt(P1 * P2)
    rig = rig_of(Parameters(P1, P2, sign * P3, P4, sign * P5, 0.0, 0.0))
    for link in (rig.first, rig.second):
        assert min(link.length, link.mass, link.inertia) > 0
    expected = np.array([P1, P2, sign * P3, P4, sign * P5])
    # The two terms of P4 may cancel.
    rounding = 1e-9 * np.where(np.arange(5) == 3, rig.second.mass * rig.first.length, abs(expected))
    assert (abs(parameters(rig.first, rig.second) - expected) <= rounding + 1e-9 * abs(expected)).all()


@given(st.floats(0.01, 0.28))
def test_a_measured_length_is_used_and_changes_only_P3(length):
    rig = rig_of(BALANCE, length)
    expected = replace(BALANCE, P3=BALANCE.P5 * length)
    assert (rig.first.length, rig.parameters) == (length, expected)
    p = expected
    np.testing.assert_allclose(parameters(rig.first, rig.second), [p.P1, p.P2, p.P3, p.P4, p.P5], rtol=1e-9)


def test_parameters_near_the_limit_of_physical_ones_are_refused_or_give_positive_inertias():
    refused = 0
    for P1, P2 in np.random.default_rng(1).uniform(0.01, 1.0, (200, 2)):
        try:
            rig = rig_of(Parameters(P1, P2, np.nextafter(np.sqrt(P1 * P2), 0), 0.1, 0.03, 0.0, 0.0))
        except ParameterError:
            refused += 1
        else:
            assert min(rig.first.inertia, rig.second.inertia) > 0
    assert refused


def test_the_urdf_is_one_tree_with_the_joints_of_joint_states():
    robot = URDF.from_xml_string(drawn(0.2, 0.3).encode())
    assert robot.get_root() == 'base_link'
    bridge = yaml.safe_load((ROOT / 'config' / 'bridge.yaml').read_text())['/**/bridge']['ros__parameters']
    moving = [joint.name for joint in robot.joints if joint.type != 'fixed']
    assert moving == bridge['joint_names']
    assert {joint.type for joint in robot.joints if joint.name in moving} == {'continuous'}
    for link in robot.links:
        assert robot.get_chain('base_link', link.name)
    assert robot.check_valid() is None
    assert [joint.origin.xyz for joint in robot.joints] == [[0, 0, 0], [0.2, 0, 0], [0.3, 0, 0]]


@pytest.mark.parametrize('lengths', [(0.0, 1.0), (1.0, -1.0), (math.nan, 1.0), (1.0, math.inf)])
def test_invalid_lengths_are_refused(lengths):
    with pytest.raises(ParameterError, match='a number above 0 is expected'):
        drawn(*lengths)
