"""The launch files against stand-ins for the launch library, which no registry of Python packages has."""

import ast
import importlib.util
import re
import sys
from types import ModuleType
from unittest.mock import MagicMock
from xml.etree import ElementTree

import pytest

from pendubot_identification import programs as installed
from test.conftest import ROOT

FILES = sorted((ROOT / 'launch').glob('*.launch.py'))
LIBRARY = (
    *('launch', 'launch.actions', 'launch.conditions', 'launch.event_handlers', 'launch.events'),
    *('launch.launch_description_sources', 'launch.substitutions', 'launch_ros', 'launch_ros.actions'),
    *('launch_ros.parameter_descriptions', 'launch_ros.substitutions'),
)
#: Programs of others that are started only when asked for; what is always started must be in package.xml.
OPTIONAL = {'rviz2', 'plotjuggler'}
PACKAGE = 'pendubot_identification'


@pytest.fixture
def launch(monkeypatch):
    """Load a launch file by name; what it would start is then in ``launch.nodes``, what it includes in ``included``."""
    for name in LIBRARY:
        module = ModuleType(name)
        module.__getattr__ = lambda _: MagicMock()
        monkeypatch.setitem(sys.modules, name, module)

    def load(name):
        load.nodes, load.included, load.declared = [], [], {}
        sys.modules['launch_ros.actions'].Node = lambda **given: load.nodes.append(given) or MagicMock()
        sys.modules['launch.actions'].IncludeLaunchDescription = lambda source, **given: load.included.append(given)
        sys.modules['launch.actions'].DeclareLaunchArgument = lambda name, **given: load.declared.update({name: given})
        sys.modules['launch.actions'].OpaqueFunction = lambda function: function(MagicMock())
        sys.modules['launch.substitutions'].PathJoinSubstitution = lambda parts: '/'.join(map(str, parts))
        sys.modules['launch.launch_description_sources'].PythonLaunchDescriptionSource = str
        sys.modules['launch_ros.substitutions'].FindPackageShare = lambda package: f'<{package}>'
        specification = importlib.util.spec_from_file_location('some_launch', ROOT / 'launch' / f'{name}.launch.py')
        module = importlib.util.module_from_spec(specification)
        specification.loader.exec_module(module)
        module.generate_launch_description()
        return module

    return load


def settings(program):
    """The names of a program's parameters."""
    module = importlib.import_module(f'{PACKAGE}.nodes.{program}')
    (node_class,) = [c for c in vars(module).values() if getattr(c, 'PROGRAM', None) == program]
    return {setting.name for setting in node_class.SETTINGS}


def test_there_is_one_for_each_habit():
    assert {f.name.split('.')[0] for f in FILES} == {'rig', 'virtual', 'replay', 'identification', 'view'}


@pytest.mark.ros
@pytest.mark.parametrize(
    ('name', 'programs'),
    [
        ('rig', ['exciter', 'exciter', 'virtual_board', 'bridge', 'recorder']),
        ('identification', ['identifier']),
        ('replay', ['player']),
    ],
)
def test_starts_the_programs_with_parameters_that_they_have(launch, name, programs):
    if name == 'replay':
        pytest.importorskip(f'{PACKAGE}.nodes.player')
    launch(name)
    assert [node['executable'] for node in launch.nodes] == programs
    for node in launch.nodes:
        assert node['package'] == PACKAGE
        program = node['executable']
        assert hasattr(installed, program)
        if program == 'virtual_board':
            continue
        assert node['name'] == program, 'a parameter file is addressed to the node of this name'
        files = [p for p in node['parameters'] if isinstance(p, str)]
        assert files in ([], [f'<{PACKAGE}>/config/{program}.yaml'])
        assert all((ROOT / file.replace(f'<{PACKAGE}>/', '')).exists() for file in files)
        (typed,) = [p for p in node['parameters'] if isinstance(p, dict)]
        assert set(typed) <= settings(program)


def test_the_view_describes_the_rig_and_shows_it_where_wanted(launch):
    launch('view')
    described, *shown = launch.nodes
    assert described['package'] == 'robot_state_publisher'
    assert described['parameters'][0]['robot_description'].startswith('<?xml')
    for node in shown:
        assert node['package'] in OPTIONAL
        assert 'condition' in node
        assert (ROOT / node['arguments'][1].replace(f'<{PACKAGE}>/', '')).exists()


def test_what_is_always_started_is_in_package_xml(launch):
    declared = {e.text for e in ElementTree.parse(ROOT / 'package.xml').iter('exec_depend')} | {PACKAGE}
    for file in FILES:
        launch(file.name.split('.')[0])
        for node in launch.nodes:
            assert node['package'] in declared or (node['package'] in OPTIONAL and 'condition' in node)


@pytest.mark.parametrize('file', FILES, ids=lambda file: file.name)
def test_every_argument_is_described_and_used(launch, file):
    module = launch(file.name.split('.')[0])
    assert set(launch.declared) == set(module.ARGUMENTS)
    for given in launch.declared.values():
        assert isinstance(given['default_value'], str)
        assert given['description']
    source = file.read_text()
    used = {node.value for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Constant)}
    for name in module.ARGUMENTS:
        assert source.count(f"'{name}'") >= 2, f'{name} is declared and nowhere used'
        assert name in used


@pytest.mark.parametrize('file', FILES, ids=lambda file: file.name)
def test_its_examples_and_those_it_includes_name_arguments_that_there_are(launch, file):
    """An argument may also be one of an included file: they are all of one scope."""
    known = set()
    for name in {file.name, *re.findall(r"'(\w+\.launch\.py)'", file.read_text()), 'view.launch.py', 'rig.launch.py'}:
        known |= set(launch(name.split('.')[0]).ARGUMENTS)
    for line in file.read_text().splitlines():
        if line.startswith('ros2 launch'):
            assert f' {PACKAGE} {file.name} ' in line
            assert set(re.findall(r' (\w+):=', line)) <= known
