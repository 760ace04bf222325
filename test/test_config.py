# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The parameter files, layouts and parameter descriptors for users of ROS tools."""

import importlib
import json
import re
from contextlib import contextmanager
from xml.etree import ElementTree

import pytest
import yaml

from pendubot_identification.errors import ParameterError
from pendubot_identification.files import refuse_untaken
from test.conftest import ROOT

pytestmark = pytest.mark.ros
#: Files for nodes of other packages.
OTHERS = 'controllers.yaml', 'diagnostic_aggregator.yaml'
#: The topics that a layout may show.
SHOWN = {'/joint_states', '/diagnostics', '/robot_description'}
SHOWN |= {f'/pendubot/{name}' for name in ('effort_command', 'params', 'identification', 'robot_description')}


@contextmanager
def started(name, namespace, file):
    """Yield a node that has read a parameter file."""
    import rclpy
    from rclpy.node import Node

    with rclpy.Context() as context:
        arguments = ['--ros-args', '--params-file', str(file)]
        node = Node(name, context=context, namespace=namespace, cli_args=arguments)
        yield node
        node.destroy_node()


@pytest.mark.parametrize(
    'path',
    sorted({*(ROOT / 'config').glob('*.yaml')} - {ROOT / 'config' / name for name in OTHERS}),
    ids=lambda path: path.stem,
)
def test_a_parameter_file_has_every_parameter_of_its_node_with_default_and_descriptor(path):
    from pendubot_identification.nodes.runtime import descriptor

    module = importlib.import_module(f'pendubot_identification.nodes.{path.stem}')
    settings = getattr(module, path.stem.title()).SETTINGS
    with started(path.stem, '/building/lab1', path) as node:
        assert set(node._parameter_overrides) == {setting.name for setting in settings}
        for setting in settings:
            described = descriptor(setting)
            value = setting.of_ros(node.declare_parameter(setting.name, setting.default, described).value)
            setting.check(value)
            assert value == setting.of_ros(setting.default), 'the file must have the default values'
            assert described.description
            assert f'[{setting.unit}]' in described.description or not setting.unit


def test_the_layouts_show_topics_that_exist():
    """The programs that read the layouts are in no registry of packages."""
    layout = json.loads((ROOT / 'foxglove' / 'pendubot.json').read_text())
    panels = set(re.findall(r'"(?:first|second)": "(.*?)"', json.dumps(layout['layout'])))
    assert panels == set(layout['configById'])
    texts = re.findall(r'"(/[\w/]+)', json.dumps(layout['configById']))
    assert set(texts) == SHOWN
    plot = ElementTree.parse(ROOT / 'config' / 'plotjuggler.xml')
    subscribed = {each.get('name') for each in plot.iter('topic')}
    assert subscribed < SHOWN
    computed = {each.get('name') for each in plot.iter('snippet')}
    names = {each.get('name') for each in plot.iter('curve')} | {each.text for each in plot.iter('linked_source')}
    assert computed <= names
    assert not [name for name in names - computed if not name.startswith(tuple(f'{topic}/' for topic in subscribed))]


def test_the_aggregator_groups_every_program_that_reports():
    content = yaml.safe_load((ROOT / 'config' / 'diagnostic_aggregator.yaml').read_text())
    groups = [v for v in content['/**/analyzers']['ros__parameters'].values() if isinstance(v, dict)]
    words = {word for group in groups for word in group['contains']}
    nodes = ROOT / 'pendubot_identification' / 'nodes'
    reporting = {path.stem for path in nodes.glob('*.py') if re.search(r'\bStatus\(self', path.read_text())}
    assert words == {*reporting, 'controller_manager'}


#: Forms of a node's name in a parameter file.
NAMES = [
    *('bridge', 'bridg', '/**/bridge', '"*/bridge"', '/*/*/bridge', '/**', '/*', 'lab1/bridge', '/**/lab1/bridge'),
    *('/lab1/*', '/lab1/*/bridge', '/lab1: {bridge', '/a: {b: {bridge', '/a: {"**": {bridge', '/a/*: {bridge'),
]


def test_exactly_the_files_from_which_rclpy_reads_no_parameter_are_refused(tmp_path):
    file = tmp_path / 'mine.yaml'
    for name in NAMES:
        file.write_text(f'{name}: {{ros__parameters: {{port: /nowhere}}}}' + '}' * name.count('{'))
        for namespace in ('/', '/lab1', '/a/b'):
            node = f'{namespace.rstrip("/")}/bridge'
            with started('bridge', namespace, file) as bridge:
                read = 'port' in bridge._parameter_overrides
            if read:
                refuse_untaken(str(file), node)
            else:
                with pytest.raises(ParameterError, match=f'{file} has no effect: it contains parameters of /'):
                    refuse_untaken(str(file), node)
    for content, refused in (
        ('bridge: {ros__parameters: {}}', 'it contains no parameters of any node, and none of'),
        ('{', 'is no YAML file; a parameter file of /bridge is expected'),
    ):
        file.write_text(content)
        with pytest.raises(ParameterError, match=refused):
            refuse_untaken(str(file), '/bridge')
