# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The URDF, read by ROS's own parser for Python, and its kinematics against the convention of q1 and q2."""

import math
from xml.etree import ElementTree

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


@given(lengths, lengths)
def test_links_are_drawn_from_joint_to_joint_and_pass_each_other(l1, l2):
    robot = parsed(l1, l2)
    first, second = (robot.link_map[name].visual for name in ('link_1', 'link_2'))
    for visual, length in ((first, l1), (second, l2)):
        assert visual.geometry.length == pytest.approx(length)
        assert visual.origin.xyz[0] == pytest.approx(length / 2)
    assert abs(second.origin.xyz[1]) > first.geometry.radius + second.geometry.radius


@pytest.mark.parametrize('lengths', [(0.0, 1.0), (1.0, -1.0), (math.nan, 1.0), (1.0, math.inf)])
def test_refuses_a_length_that_is_none(lengths):
    with pytest.raises(ParameterError, match='a number above 0 is expected'):
        drawn(*lengths)


def test_rviz_and_plotjuggler_show_what_the_bridge_publishes():
    rviz = yaml.safe_load((ROOT / 'config' / 'pendubot.rviz').read_text())['Visualization Manager']
    assert rviz['Global Options']['Fixed Frame'] == parsed().get_root()
    (model,) = [d for d in rviz['Displays'] if d['Class'] == 'rviz_default_plugins/RobotModel']
    assert model['Enabled']
    assert model['Description Topic']['Value'] == '/robot_description'

    layout = ElementTree.parse(ROOT / 'config' / 'plotjuggler.xml').getroot()
    curves = {curve.get('name') for curve in layout.iter('curve')}
    fields = {f'/joint_states/{joint}/{field}' for joint in ('shoulder', 'elbow') for field in ('position', 'velocity')}
    assert curves == fields | {'/joint_states/shoulder/effort', '/pendubot/effort_command/data'}
    topics = {topic.get('name') for topic in layout.iter('topic')}
    assert all(any(curve.startswith(topic) for topic in topics) for curve in curves)
