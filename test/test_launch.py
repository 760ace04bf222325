"""The launch files against stand-ins for the launch library, which no registry of Python packages has."""

import ast
import importlib.util
import re
import sys
from types import ModuleType, SimpleNamespace
from unittest.mock import MagicMock
from xml.etree import ElementTree

import pytest
import yaml

from pendubot_identification import programs as installed
from pendubot_identification.errors import ParameterError
from test.conftest import ROOT
from test.processes import Program

FILES = sorted((ROOT / 'launch').glob('*.launch.py'))
LIBRARY = (
    *('launch', 'launch.actions', 'launch.conditions', 'launch.event_handlers', 'launch.events'),
    *('launch.launch_description_sources', 'launch.substitutions', 'launch_ros', 'launch_ros.actions'),
    *('launch_ros.parameter_descriptions', 'launch_ros.substitutions'),
)
#: Programs of others that are started only when asked for; what is always started must be in package.xml.
OPTIONAL = {'rviz2', 'plotjuggler'}
PACKAGE = 'pendubot_identification'


class Configuration:
    """An argument that is looked up when it is performed, and has to have been declared by then."""

    def __init__(self, name):
        self.name = name

    def perform(self, context):
        return context.launch_configurations[self.name]


class Expression:
    """Python, some of it not known before it is performed."""

    def __init__(self, parts):
        self.parts = parts

    def perform(self, context):
        return str(eval(''.join(part if isinstance(part, str) else part.perform(context) for part in self.parts)))


class Condition:
    """Holds where something is true, as launch wants it written."""

    def __init__(self, what):
        self.what = what

    def evaluate(self, context):
        return {'true': True, '1': True, 'false': False, '0': False}[self.what.perform(context).lower()]


class Value:
    """A parameter's value: of the type that is wanted, or something that becomes it once it is performed."""

    def __init__(self, value, *, value_type):
        if isinstance(value, (str, int, float)) and not isinstance(value, value_type):
            raise TypeError(f'{value!r} is not an instance of {value_type}')
        self.value, self.type = value, value_type

    def evaluate(self, context):
        text = self.value.perform(context) if hasattr(self.value, 'perform') else self.value
        return {'true': True, 'false': False}[text] if self.type is bool else self.type(text)


@pytest.fixture
def launch(monkeypatch):
    """Load a launch file by name, with arguments or their defaults.

    As by the library, one entity is visited after the other. What that starts is then in ``launch.nodes``, what it
    includes in ``included``, and ``context`` has the arguments.
    """
    for name in LIBRARY:
        module = ModuleType(name)
        module.__getattr__ = lambda _: MagicMock()
        monkeypatch.setitem(sys.modules, name, module)

    def entity(visit):
        return lambda *args, **given: SimpleNamespace(visit=lambda: visit(*args, **given))

    def declare(name, **given):
        load.declared[name] = given
        load.context.launch_configurations.setdefault(name, given['default_value'])

    def visit(entities):
        for each in entities:
            each.visit()

    def load(name, **arguments):
        load.nodes, load.included, load.declared = [], [], {}
        load.context = SimpleNamespace(launch_configurations=arguments)
        sys.modules['launch'].LaunchDescription = visit
        sys.modules['launch_ros.actions'].Node = entity(lambda **given: load.nodes.append(given))
        sys.modules['launch.actions'].IncludeLaunchDescription = entity(lambda _, **given: load.included.append(given))
        sys.modules['launch.actions'].DeclareLaunchArgument = entity(declare)
        sys.modules['launch.actions'].OpaqueFunction = entity(lambda function: visit(function(load.context)))
        sys.modules['launch.conditions'].IfCondition = Condition
        sys.modules['launch.substitutions'].LaunchConfiguration = Configuration
        sys.modules['launch.substitutions'].PythonExpression = Expression
        sys.modules['launch_ros.parameter_descriptions'].ParameterValue = Value
        sys.modules['launch.substitutions'].PathJoinSubstitution = lambda parts: '/'.join(map(str, parts))
        sys.modules['launch.launch_description_sources'].PythonLaunchDescriptionSource = str
        sys.modules['launch_ros.substitutions'].FindPackageShare = lambda package: f'<{package}>'
        specification = importlib.util.spec_from_file_location('some_launch', ROOT / 'launch' / f'{name}.launch.py')
        module = importlib.util.module_from_spec(specification)
        specification.loader.exec_module(module)
        module.generate_launch_description()
        return module

    return load


def started(launch, program):
    """The files and the other parameters with which a program is started."""
    (node,) = [node for node in launch.nodes if node['executable'] == program]
    files = [p for p in node['parameters'] if isinstance(p, str)]
    typed = [p for p in node['parameters'] if isinstance(p, dict)]
    assert node['parameters'] == [*files, *typed], 'what is given as an argument has to come last, to count'
    return files, {name: value.evaluate(launch.context) for each in typed for name, value in each.items()}


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
        ('rig', ['virtual_board', 'bridge', 'recorder', 'exciter']),
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


@pytest.fixture
def own(tmp_path):
    """Somebody's own parameter files."""
    for name in ('bridge', 'exciter'):
        (tmp_path / f'{name}.yaml').write_text(yaml.safe_dump({name: {'ros__parameters': {}}}))
    return {name: str(tmp_path / f'{name}.yaml') for name in ('bridge', 'exciter')}


def packaged(program):
    return f'<{PACKAGE}>/config/{program}.yaml'


@pytest.mark.parametrize(
    ('arguments', 'expected'),
    [
        ({}, {}),
        ({'port': '/dev/x'}, {'port': '/dev/x'}),
        ({'port': '7', 'baud': '115200'}, {'port': '7', 'baud': 115200}),
        ({'virtual': 'true'}, {'port': '/tmp/pendubot'}),
        ({'virtual': 'true', 'port': '/tmp/x'}, {'port': '/tmp/x'}),
    ],
)
def test_the_bridges_parameters_are_those_of_the_file_but_for_what_is_an_argument(launch, own, arguments, expected):
    """A limit on the torque above all. With a virtual board never the port of the file, where a rig may be."""
    launch('rig', **arguments)
    assert started(launch, 'bridge') == ([packaged('bridge')], expected)
    launch('rig', bridge=own['bridge'], **arguments)
    assert started(launch, 'bridge') == ([own['bridge']], expected)
    (board,) = [node for node in launch.nodes if node['executable'] == 'virtual_board']
    assert board['condition'].evaluate(launch.context) == ('virtual' in arguments)
    assert 'virtual' not in arguments or board['arguments'] == ['--link', expected['port']]


def test_an_excitation_that_is_given_is_the_files_and_else_the_arguments(launch, own):
    launch('rig', amplitude='0.5', duration='10', seed='3', arm='true')
    train = {'arm': True, 'duration': 10.0, 'amplitude_min': -0.5, 'amplitude_max': 0.5, 'seed': 3}
    assert started(launch, 'exciter') == ([packaged('exciter')], train)
    launch('rig', amplitude='0.5', excitation=own['exciter'])
    assert started(launch, 'exciter') == ([own['exciter']], {'arm': False})


@pytest.mark.parametrize(('argument', 'program'), [('bridge', 'bridge'), ('excitation', 'exciter')])
def test_a_file_that_is_not_there_is_refused_before_anything_is_started(launch, tmp_path, argument, program):
    """An error in such a function ends the launch with one line and status 1; what came before it would be running."""
    missing = tmp_path / 'mine.yaml'
    for wrong in (missing, tmp_path):
        with pytest.raises(ParameterError) as refused:
            launch('rig', **{argument: str(wrong)})
        assert str(refused.value) == (
            f'nothing was started: {argument} is {wrong}, and there is no such file; name a parameter file of {program}'
        )
        assert launch.nodes == launch.included == []


@pytest.mark.parametrize(('argument', 'program'), [('bridge', 'bridge'), ('excitation', 'exciter')])
def test_a_file_at_home_is_found(launch, tmp_path, monkeypatch, argument, program):
    """No shell makes a home of the ~ in ``bridge:=~/mine.yaml``."""
    monkeypatch.setenv('HOME', str(tmp_path))
    (tmp_path / 'mine.yaml').write_text(yaml.safe_dump({program: {'ros__parameters': {}}}))
    launch('rig', **{argument: '~/mine.yaml'})
    assert started(launch, program)[0] == [str(tmp_path / 'mine.yaml')]


@pytest.mark.ros
@pytest.mark.parametrize(
    ('arguments', 'said'),
    [({}, 'the port /nowhere/own is missing'), ({'port': '/nowhere/given'}, 'the port /nowhere/given is missing')],
)
def test_what_is_made_of_a_file_and_of_arguments_is_what_the_bridge_has(launch, tmp_path, arguments, said):
    """As launch_ros hands it over: one file after the other, the last made of the arguments and for any node."""
    own, typed = tmp_path / 'own.yaml', tmp_path / 'typed.yaml'
    own.write_text('bridge: {ros__parameters: {port: /nowhere/own}}')
    launch('rig', bridge=str(own), **arguments)
    (file,), values = started(launch, 'bridge')
    typed.write_text(yaml.safe_dump({'/**': {'ros__parameters': values}}))
    with Program('bridge', '--ros-args', '--params-file', file, '--params-file', typed) as bridge:
        bridge.wait_for(said)


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
