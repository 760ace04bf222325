# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The URDF for display, read by ROS's parser; test_engines.py tests the URDF with masses."""

import math

import pytest
import yaml
from urdf_parser_py.urdf import URDF

from pendubot_identification.errors import ParameterError
from pendubot_identification.formats.robots import drawn
from test.conftest import ROOT


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
