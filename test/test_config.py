# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The parameter files in config/ and the descriptors, as a user of ``--params-file`` and ``ros2 param`` meets them."""

import importlib

import pytest

from test.conftest import ROOT

pytestmark = pytest.mark.ros


@pytest.mark.parametrize(
    'path',
    sorted({*(ROOT / 'config').glob('*.yaml')} - {ROOT / 'config' / 'controllers.yaml'}),
    ids=lambda path: path.stem,
)
def test_a_file_loads_into_its_node_in_any_namespace_with_every_parameter_and_a_descriptor_of_each(path):
    import rclpy
    from rclpy.node import Node

    from pendubot_identification.nodes.runtime import descriptor

    module = importlib.import_module(f'pendubot_identification.nodes.{path.stem}')
    settings = getattr(module, path.stem.title()).SETTINGS
    with rclpy.Context() as context:
        arguments = ['--ros-args', '--params-file', str(path)]
        node = Node(path.stem, context=context, namespace='/building/lab1', cli_args=arguments)
        assert set(node._parameter_overrides) == {setting.name for setting in settings}
        for setting in settings:
            described = descriptor(setting)
            value = setting.of_ros(node.declare_parameter(setting.name, setting.default, described).value)
            setting.check(value)
            assert value == setting.of_ros(setting.default), 'a file that is copied changes nothing'
            assert described.description
            assert f'[{setting.unit}]' in described.description or not setting.unit
        node.destroy_node()
