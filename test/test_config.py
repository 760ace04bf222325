# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The parameter files in config/: every parameter of its node, with the node's own default, and nothing else."""

import pytest
import yaml

from test.conftest import ROOT

pytestmark = pytest.mark.ros
PROGRAMS = 'balancer', 'bridge', 'exciter', 'identifier', 'player', 'recorder'


def node_classes():
    from pendubot_identification.nodes.balancer import Balancer
    from pendubot_identification.nodes.bridge import Bridge
    from pendubot_identification.nodes.exciter import Exciter
    from pendubot_identification.nodes.identifier import Identifier
    from pendubot_identification.nodes.player import Player
    from pendubot_identification.nodes.recorder import Recorder

    return {c.PROGRAM: c for c in (Balancer, Bridge, Exciter, Identifier, Player, Recorder)}


def test_there_is_one_for_each_node():
    assert {path.stem for path in (ROOT / 'config').glob('*.yaml')} == set(node_classes())


@pytest.mark.parametrize('program', PROGRAMS)
def test_holds_every_parameter_with_its_default_and_a_comment(program):
    path = ROOT / 'config' / f'{program}.yaml'
    parameters = yaml.safe_load(path.read_text())[f'/**/{program}']['ros__parameters']
    assert parameters == {s.name: s.default for s in node_classes()[program].SETTINGS}
    lines = path.read_text().splitlines()
    for name in parameters:
        k = next(k for k, line in enumerate(lines) if line.strip().startswith(f'{name}:'))
        above = lines[k - 1].strip()
        assert above.startswith('#') or above.split(':')[0] in parameters, f'{name} has no comment'


@pytest.mark.parametrize('namespace', ['/', '/lab1', '/building/lab1'])
@pytest.mark.parametrize('program', PROGRAMS)
def test_loads_into_the_node_that_it_names_in_any_namespace(program, namespace):
    import rclpy
    from rclpy.node import Node

    path = ROOT / 'config' / f'{program}.yaml'
    context = rclpy.Context()
    rclpy.init(context=context)
    arguments = ['--ros-args', '--params-file', str(path)]
    node = Node(program, context=context, namespace=namespace, cli_args=arguments)
    try:
        assert set(node._parameter_overrides) == {s.name for s in node_classes()[program].SETTINGS}
        for s in node_classes()[program].SETTINGS:
            declared = node.declare_parameter(s.name, s.default, s.descriptor()).value
            s.check(list(declared) if isinstance(s.default, list) else declared)
    finally:
        node.destroy_node()
        context.try_shutdown()


@pytest.mark.parametrize('program', PROGRAMS)
def test_every_parameter_has_a_descriptor_with_meaning_unit_and_range(program):
    for setting in node_classes()[program].SETTINGS:
        descriptor = setting.descriptor()
        assert descriptor.description
        assert setting.unit == '' or f'[{setting.unit}]' in descriptor.description
        if isinstance(setting.default, (int, float)) and not isinstance(setting.default, bool):
            ranges = [*descriptor.integer_range, *descriptor.floating_point_range]
            assert ranges, f'{setting.name} has no range'
            assert ranges[0].from_value <= setting.default <= ranges[0].to_value
