# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The URDF, read by ROS's own parser for Python, and its kinematics against the convention of q1 and q2."""

import math

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from urdf_parser_py.urdf import URDF

from pendubot_identification.errors import ParameterError
from pendubot_identification.formats.robots import drawn
from test.conftest import ROOT

lengths = st.floats(0.01, 10.0)
angles = st.floats(-20.0, 20.0)


def parsed(l1=0.2, l2=0.3):
    return URDF.from_xml_string(drawn(l1, l2).encode())


def rotation(axis, angle):
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross


def place(robot, link, positions):
    """Where a link's origin is [m], by the joints from the root to it."""
    turn, at = np.eye(3), np.zeros(3)
    for name in robot.get_chain(robot.get_root(), link, links=False):
        joint = robot.joint_map[name]
        assert joint.origin.rpy == [0, 0, 0]
        at = at + turn @ np.array(joint.origin.xyz)
        if joint.type != 'fixed':
            turn = turn @ rotation(joint.axis, positions[name])
    return at


def test_is_one_tree_with_the_joints_of_joint_states():
    robot = parsed()
    assert robot.get_root() == 'base_link'
    bridge = yaml.safe_load((ROOT / 'config' / 'bridge.yaml').read_text())['/**/bridge']['ros__parameters']
    moving = [joint.name for joint in robot.joints if joint.type != 'fixed']
    assert moving == bridge['joint_names']
    assert {joint.type for joint in robot.joints if joint.name in moving} == {'continuous'}
    for link in robot.links:
        assert robot.get_chain('base_link', link.name)
    assert robot.check_valid() is None


@given(lengths, lengths, angles, angles)
def test_moves_as_the_angles_are_defined(l1, l2, q1, q2):
    robot = parsed(l1, l2)
    elbow = np.array([l1 * math.cos(q1), 0, l1 * math.sin(q1)])
    tip = elbow + np.array([l2 * math.cos(q1 + q2), 0, l2 * math.sin(q1 + q2)])
    positions = {'shoulder': q1, 'elbow': q2}
    scale = l1 + l2
    np.testing.assert_allclose(place(robot, 'link_2', positions), elbow, atol=1e-7 * scale)
    np.testing.assert_allclose(place(robot, 'tip', positions), tip, atol=1e-7 * scale)


@pytest.mark.parametrize('lengths', [(0.0, 1.0), (1.0, -1.0), (math.nan, 1.0), (1.0, math.inf)])
def test_refuses_a_length_that_is_none(lengths):
    with pytest.raises(ParameterError, match='a number above 0 is expected'):
        drawn(*lengths)
