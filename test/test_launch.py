# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The launch files by the rules of the launch library: by that itself where it is, as in a ROS workspace.

No registry of Python packages has it; elsewhere stand-ins go by the same rules: one entity is visited after the other,
what is a program starts at once, and what raises after that leaves it running.
"""

import ast
import importlib.util
import json
import os
import re
import select
import signal
import sys
import tempfile
from itertools import pairwise
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import List, NamedTuple  # noqa: UP035
from xml.etree import ElementTree

import pytest
import yaml

from pendubot_identification import programs as installed
from pendubot_identification.errors import ParameterError, PendubotError
from test import processes
from test.conftest import ROOT
from test.processes import Program

FILES = sorted((ROOT / 'launch').glob('*.launch.py'))
REAL = importlib.util.find_spec('launch_ros') is not None
PACKAGE = 'pendubot_identification'
PROGRAMS = 'bridge', 'recorder', 'exciter', 'player', 'identifier', 'virtual_board'
#: Programs of others, which are packages of the same name.
OTHERS = 'robot_state_publisher', 'rviz2', 'plotjuggler'
RANGE = 'ROS_AUTOMATIC_DISCOVERY_RANGE'


class Started(NamedTuple):
    """A program as it was started: what stands before it, its parameters, and what is done with its exit status."""

    package: str
    executable: str
    before: list
    arguments: list
    files: list
    values: dict
    namespace: str
    discovery: str
    on_exit: object


def described(path):
    """The description that a launch file returns."""
    specification = importlib.util.spec_from_file_location('some_launch', path)
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module.generate_launch_description()


def performed(what, context):
    """The text of a substitution, or of a list of them."""
    if isinstance(what, (list, tuple)):
        return ''.join(performed(each, context) for each in what)
    return what.perform(context) if hasattr(what, 'perform') else what


class Action:
    """What does something when it is visited, where its condition holds; what it returns is visited next."""

    def __init__(self, execute, condition=None):
        self.execute, self.condition = execute, condition

    def visit(self, context):
        return self.execute(context) if self.condition is None or self.condition.evaluate(context) else None


class LaunchConfiguration:
    """An argument that is looked up when it is performed, and has to be there by then, unless it has a default."""

    def __init__(self, name, default=None):
        self.name, self.default = name, default

    def perform(self, context):
        found = context.launch_configurations.get(self.name, self.default)
        assert found is not None, f'launch configuration {self.name} does not exist'
        return found


class IfCondition:
    def __init__(self, what):
        self.what = what

    def evaluate(self, context):
        return {'true': True, '1': True, 'false': False, '0': False}[performed(self.what, context).lower()]


class ParameterValue:
    def __init__(self, value, *, value_type):
        assert value_type == List[str]  # noqa: UP006
        self.value = value


class ExecutableInPackage:
    def __init__(self, executable, package):
        self.path = Path('lib', package, executable)

    def perform(self, context):
        found = [Path(p, self.path) for p in os.environ['AMENT_PREFIX_PATH'].split(':') if Path(p, self.path).exists()]
        if not found:
            raise LookupError(f'{self.path} not found')
        return str(found[0])


def evaluated(value):
    """A parameter's value as launch_ros hands it over; its file has tuples as only Python's YAML reads them."""
    return value.value if isinstance(value, ParameterValue) else tuple(value) if isinstance(value, list) else value


def declare_launch_argument(name, *, default_value, description):
    assert isinstance(default_value, str)
    assert description
    return Action(lambda context: context.launch_configurations.setdefault(name, default_value) and None)


def include_launch_description(path, *, launch_arguments=(), condition=None):
    def execute(context):
        for name, value in launch_arguments:
            context.launch_configurations[name] = performed(value, context)
        return [described(path)]

    return Action(execute, condition)


def node(
    *, package, executable, exec_name, namespace, output, prefix, additional_env,
    parameters=(), arguments=(), remappings=(), name=None, on_exit=None,
):  # fmt: skip
    def execute(context):
        ExecutableInPackage(executable, package).perform(context)
        assert (exec_name, output) == (executable, 'screen')
        files = [each for each in parameters if isinstance(each, str)]
        typed = [each for each in parameters if isinstance(each, dict)]
        values = {key: evaluated(value) for each in typed for key, value in each.items()}
        assert list(parameters) == [*files, *typed], 'what is given as an argument has to come last, to count'
        assert name == (executable if package == PACKAGE else None), 'a parameter file is addressed to this node'
        assert all(re.fullmatch(r'/(\w+)', topic)[1] == relative for topic, relative in remappings)
        where, environment = performed(namespace, context), performed(additional_env[RANGE], context)
        before = performed(prefix, context).split()
        context.started.append(
            Started(package, executable, before, list(arguments), files, values, where, environment, on_exit)
        )

    return Action(execute)


#: Of each module of the library, what the launch files take from it.
STAND_INS = {
    'launch': {
        'LaunchContext': SimpleNamespace,
        'LaunchDescription': lambda entities: SimpleNamespace(visit=lambda context: entities),
    },
    'launch.actions': {
        'DeclareLaunchArgument': declare_launch_argument,
        'EmitEvent': lambda *, event: SimpleNamespace(event=event),
        'IncludeLaunchDescription': include_launch_description,
        'OpaqueFunction': lambda *, function: Action(function),
    },
    'launch.conditions': {'IfCondition': IfCondition},
    'launch.events': {'Shutdown': lambda *, reason: SimpleNamespace(reason=reason)},
    'launch.launch_description_sources': {'PythonLaunchDescriptionSource': str},
    'launch.substitutions': {'LaunchConfiguration': LaunchConfiguration},
    'launch_ros': {},
    'launch_ros.actions': {'Node': node},
    'launch_ros.parameter_descriptions': {'ParameterValue': ParameterValue},
    'launch_ros.substitutions': {'ExecutableInPackage': ExecutableInPackage},
}


def read_back(action):
    """A program as the real library would start it, from its command line and its files of parameters."""
    program = action.process_description
    cut = next(k for k, word in enumerate(program.final_cmd) if word.endswith(f'/{action.node_executable}'))
    before, words = program.final_cmd[:cut], program.final_cmd[cut + 1 :]
    ros = words[words.index('--ros-args') :]
    files, values = [], {}
    for option, file in pairwise(ros):
        if option == '--params-file' and Path(file).name.startswith('launch_params_'):
            ((_, content),) = yaml.safe_load(Path(file).read_text()).items()
            values |= content['ros__parameters']
        elif option == '--params-file':
            files.append(file)
    (namespace,) = [word.removeprefix('__ns:=').removeprefix('/') for word in ros if word.startswith('__ns:=')]
    on_exit = action._ExecuteLocal__on_exit
    arguments = words[: words.index('--ros-args')]
    discovery = program.final_env[RANGE]
    return Started(
        action.node_package, action.node_executable, before, arguments, files, values, namespace, discovery, on_exit
    )


@pytest.fixture
def packages(tmp_path, monkeypatch):
    """The packages that are installed; those of others may be taken away."""
    for package, executables in {
        PACKAGE: PROGRAMS,
        'robot_state_publisher': (),
        'rviz2': (),
        'plotjuggler': (),
    }.items():
        folder = tmp_path / 'prefix' / 'lib' / package
        folder.mkdir(parents=True)
        index = tmp_path / 'prefix' / 'share' / 'ament_index' / 'resource_index' / 'packages'
        index.mkdir(parents=True, exist_ok=True)
        (index / package).touch()
        for name in executables or [package]:
            (folder / name).touch(0o755)
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path / 'prefix'))
    return tmp_path / 'prefix' / 'lib'


@pytest.fixture
def launch(monkeypatch, packages, tmp_path):
    """Launch a file by name, with arguments or their defaults; returns what was started, also in ``launch.started``."""
    monkeypatch.setattr(tempfile, 'tempdir', str(tmp_path))
    monkeypatch.delitem(sys.modules, f'{PACKAGE}.launching', raising=False)
    if REAL:
        import launch as library
        from launch.actions import ExecuteLocal

        def execute(action, context):
            action.prepare(context)
            run.started.append(read_back(action))

        monkeypatch.setattr(ExecuteLocal, 'execute', execute)
    else:
        for name, content in STAND_INS.items():
            module = ModuleType(name)
            vars(module).update(content)
            monkeypatch.setitem(sys.modules, name, module)

    def visit(entity, context):
        for each in entity.visit(context) or []:
            visit(each, context)

    def run(name, **arguments):
        run.started = []
        run.context = (
            library.LaunchContext() if REAL else SimpleNamespace(launch_configurations={}, started=run.started)
        )
        run.context.launch_configurations.update(arguments)
        visit(described(ROOT / 'launch' / f'{name}.launch.py'), run.context)
        return {each.executable: each for each in run.started}

    yield run
    sys.modules.pop(f'{PACKAGE}.launching', None)


def arguments_of(path):
    """The table of a launch file's arguments."""
    (table,) = [s for s in ast.parse(path.read_text()).body if isinstance(s, ast.Assign)]
    return ast.literal_eval(table.value)


def packaged(program):
    return str(ROOT / 'config' / f'{program}.yaml')


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
        ('rig', ['robot_state_publisher', 'bridge', 'recorder', 'exciter']),
        ('virtual', ['robot_state_publisher', 'virtual_board', 'bridge', 'recorder', 'exciter']),
        ('identification', ['identifier']),
        ('replay', ['robot_state_publisher', 'player']),
    ],
)
def test_starts_the_programs_with_parameters_that_they_have(launch, name, programs):
    started = launch(name)
    assert list(started) == programs
    for program, (package, *_) in started.items():
        if package == PACKAGE and program != 'virtual_board':
            assert hasattr(installed, program)
            assert started[program].files in ([], [packaged(program)])
            assert set(started[program].values) <= settings(program)


@pytest.mark.parametrize(
    ('name', 'arguments', 'said'),
    [
        ('rig', {'amplitude': 'abc'}, 'amplitude is abc; a number is expected'),
        ('rig', {'amplitude': 'nan'}, 'amplitude is nan; a number is expected'),
        ('rig', {'duration': 'long'}, 'duration is long; a number is expected'),
        ('rig', {'seed': '1.5'}, 'seed is 1.5; a whole number is expected'),
        ('rig', {'baud': 'fast'}, 'baud is fast; a whole number is expected'),
        ('rig', {'virtual': 'maybe'}, 'virtual is maybe; true or false is expected'),
        ('rig', {'arm': ''}, 'arm is ; true or false is expected'),
        ('rig', {'view': 'no'}, 'view is no; true or false is expected'),
        ('rig', {'rviz': 'yes'}, 'rviz is yes; true or false is expected'),
        ('rig', {'l1': 'abc'}, 'l1 is abc; a number is expected'),
        ('virtual', {'l2': '-1'}, 'the length l2 is -1 m; a number above 0 is expected'),
        ('virtual', {'arm': 'perhaps'}, 'arm is perhaps; true or false is expected'),
        ('virtual', {'amplitude': 'abc'}, 'amplitude is abc; a number is expected'),
        ('view', {'plotjuggler': '2'}, 'plotjuggler is 2; true or false is expected'),
        ('replay', {'rate': 'slow'}, 'rate is slow; a number is expected'),
        ('replay', {'l1': 'abc'}, 'l1 is abc; a number is expected'),
        ('identification', {'force': 'y'}, 'force is y; true or false is expected'),
        ('identification', {'bags': "['a"}, 'bags is [\'a; a text, or a list of texts such as "[\'a\''),
        ('identification', {'validate': '[1]'}, 'validate is [1]; a text, or a list of texts'),
        ('rig', {'discovery': 'MOON'}, 'discovery is MOON; one of LOCALHOST, SUBNET, SYSTEM_DEFAULT is expected'),
    ],
)  # fmt: skip
def test_an_argument_without_sense_is_refused_before_anything_is_started(launch, name, arguments, said):
    """What came before would be running, and nobody would end it: an exciter would arm, and move the rig."""
    with pytest.raises(ParameterError, match='nothing was started: ' + re.escape(said)):
        launch(name, **arguments)
    assert launch.started == []


@pytest.mark.parametrize('name', ['rig', 'virtual', 'replay', 'view'])
@pytest.mark.parametrize(
    ('missing', 'arguments', 'remedy'),
    [
        ('robot_state_publisher', {}, 'sudo apt install ros-$ROS_DISTRO-robot-state-publisher, or give view:=false'),
        ('rviz2', {'rviz': 'true'}, 'sudo apt install ros-$ROS_DISTRO-rviz2, or give rviz:=false'),
        ('plotjuggler', {'plotjuggler': 'true'}, 'sudo apt install ros-$ROS_DISTRO-plotjuggler, or give plotjuggler:='),
    ],
)
def test_a_program_that_is_not_installed_is_named_before_anything_is_started(
    launch, packages, name, missing, arguments, remedy
):
    launch(name, **arguments)
    assert missing in {each.executable for each in launch.started}
    (packages / missing / missing).unlink()
    with pytest.raises(ParameterError, match=re.escape(f'nothing was started: {missing} is not installed; {remedy}')):
        launch(name, **arguments)
    assert launch.started == []
    if name != 'view':
        assert launch(name, **arguments, view='false'), 'it was refused without need'


def test_a_program_of_the_package_that_is_not_there_is_named_before_anything_is_started(launch, packages):
    (packages / PACKAGE / 'exciter').unlink()
    with pytest.raises(ParameterError, match='nothing was started: exciter is not installed; build'):
        launch('rig')
    assert launch.started == []


@pytest.mark.parametrize('name', ['virtual', 'replay', 'identification'])
def test_when_a_program_ends_everything_ends_and_when_one_failed_with_an_error(launch, name):
    """Launch returns another status than 0 only where something raises."""
    for program in launch(name, rviz='true').values():
        if program.package != PACKAGE:
            assert program.on_exit is None, 'who closes a window ends no recording'
            continue
        ended = SimpleNamespace(process_name='it', returncode=0)
        context = SimpleNamespace(is_shutdown=False)
        assert program.on_exit(ended, context).event.reason == 'it has ended'
        for status in (1, -signal.SIGKILL, -signal.SIGINT):
            ended.returncode = status
            with pytest.raises(PendubotError, match=f'it failed, with status {status}: everything ends'):
                program.on_exit(ended, context)
        context.is_shutdown = True
        assert program.on_exit(ended, context), 'a Ctrl-C is no failure'


def test_programs_find_only_those_of_this_machine_unless_told_otherwise(launch, monkeypatch):
    def ranges(**arguments):
        sys.modules.pop(f'{PACKAGE}.launching', None)
        return {program.discovery for program in launch('virtual', **arguments).values()}

    monkeypatch.delenv(RANGE, raising=False)
    assert ranges() == {'LOCALHOST'}
    assert ranges(discovery='SUBNET') == {'SUBNET'}
    monkeypatch.setenv(RANGE, 'SUBNET')
    assert ranges() == {'SUBNET'}
    assert ranges(discovery='LOCALHOST') == {'LOCALHOST'}


def test_a_namespace_is_that_of_every_program(launch):
    assert {program.namespace for program in launch('virtual').values()} == {''}
    assert {program.namespace for program in launch('virtual', namespace='lab1', rviz='true').values()} == {'lab1'}


@pytest.mark.ros
def test_programs_end_disarmed_when_launch_is_killed(launch, tmp_path):
    """The programs of a real launch by a parent that can tell them nothing more."""
    trace, script = tmp_path / 'trace.csv', tmp_path / 'launch.py'
    given = {'port': str(tmp_path / 'rig'), 'output': str(tmp_path / 'bag'), 'arm': 'true', 'view': 'false'}
    commands = []
    for program in launch('rig', **given).values():
        typed = tmp_path / f'{program.executable}.yaml'
        typed.write_text(yaml.safe_dump({'/**': {'ros__parameters': program.values}}))
        files = [word for file in (*program.files, typed) for word in ('--params-file', str(file))]
        start = [sys.executable, '-m', processes.MODULES[program.executable]]
        commands.append([*program.before, *start, *program.arguments, '--ros-args', *files])
    script.write_text(
        'import subprocess, sys\n'
        f'started = [subprocess.Popen(command) for command in {json.dumps(commands)}]\n'
        'print("started", *(each.pid for each in started), flush=True)\n'
        'started[0].wait()\n'
    )
    with Program('virtual_board', '--link', given['port'], '--trace', trace) as board:
        board.wait_for('virtual board on')
        with Program.of_file(script) as parent:
            numbers = [int(number) for number in parent.wait_for('started').split()[1:]]
            ends = [os.pidfd_open(number) for number in numbers]
            try:
                parent.wait_for('exciting for')
                parent.kill()
                gone = [bool(select.select([end], [], [], 10.0)[0]) for end in ends]
            finally:
                for end, number in zip(ends, numbers, strict=True):
                    if not select.select([end], [], [], 0.0)[0]:
                        os.kill(number, signal.SIGKILL)
                    os.close(end)
        assert gone == [True] * 3
    *_, torque, status = trace.read_text().splitlines()[-1].split(',')
    assert int(torque) == 0
    assert int(status) & 1 == 0, 'armed'


@pytest.fixture
def own(tmp_path):
    """Somebody's own parameter files."""
    for name in ('bridge', 'exciter'):
        (tmp_path / f'{name}.yaml').write_text(yaml.safe_dump({name: {'ros__parameters': {}}}))
    return {name: str(tmp_path / f'{name}.yaml') for name in ('bridge', 'exciter')}


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
    bridge = launch('rig', **arguments)['bridge']
    assert (bridge.files, bridge.values) == ([packaged('bridge')], expected)
    started = launch('rig', bridge=own['bridge'], **arguments)
    assert (started['bridge'].files, started['bridge'].values) == ([own['bridge']], expected)
    assert ('virtual_board' in started) == ('virtual' in arguments)
    if 'virtual' in arguments:
        assert started['virtual_board'].arguments == ['--link', expected['port']]


def test_an_excitation_that_is_given_is_the_files_and_else_the_arguments(launch, own):
    """Either way nothing is moved that is not recorded."""
    exciter = launch('rig', amplitude='0.5', duration='10', seed='3', arm='true')['exciter']
    train = {'duration': 10.0, 'amplitude_min': -0.5, 'amplitude_max': 0.5, 'seed': 3}
    assert (exciter.files, exciter.values) == ([packaged('exciter')], {'arm': True, 'recorded': True, **train})
    exciter = launch('rig', amplitude='0.5', excitation=own['exciter'])['exciter']
    assert (exciter.files, exciter.values) == ([own['exciter']], {'arm': False, 'recorded': True})


@pytest.mark.parametrize(
    ('given', 'bags'),
    [
        ({}, ['']),
        ({'bags': 'swing'}, ['swing']),
        ({'bags': 'a@0:9'}, ['a@0:9']),
        ({'bags': '12'}, ['12']),
        ({'bags': "['a','b']"}, ['a', 'b']),
        ({'bags': "['a@0:9', 'b']"}, ['a@0:9', 'b']),
        ({'bags': '[]'}, ['']),
    ],
)
def test_bags_are_one_or_a_list(launch, given, bags):
    values = launch('identification', **given, validate='c')['identifier'].values
    assert (values['bags'], values['validate']) == (bags, ['c'])


@pytest.mark.parametrize(('argument', 'program'), [('bridge', 'bridge'), ('excitation', 'exciter')])
def test_a_file_that_is_not_there_is_refused_before_anything_is_started(launch, tmp_path, argument, program):
    missing = tmp_path / 'mine.yaml'
    for wrong in (missing, tmp_path):
        with pytest.raises(ParameterError) as refused:
            launch('rig', **{argument: str(wrong)})
        assert str(refused.value) == (
            f'nothing was started: {argument} is {wrong}, and there is no such file; name a parameter file of {program}'
        )
        assert launch.started == []


@pytest.mark.parametrize(('argument', 'program'), [('bridge', 'bridge'), ('excitation', 'exciter')])
def test_a_file_at_home_is_found(launch, tmp_path, monkeypatch, argument, program):
    """No shell makes a home of the ~ in ``bridge:=~/mine.yaml``."""
    monkeypatch.setenv('HOME', str(tmp_path))
    (tmp_path / 'mine.yaml').write_text(yaml.safe_dump({program: {'ros__parameters': {}}}))
    assert launch('rig', **{argument: '~/mine.yaml'})[program].files == [str(tmp_path / 'mine.yaml')]


@pytest.mark.ros
@pytest.mark.parametrize(
    ('arguments', 'said'),
    [({}, 'the port /nowhere/own is missing'), ({'port': '/nowhere/given'}, 'the port /nowhere/given is missing')],
)
def test_what_is_made_of_a_file_and_of_arguments_is_what_the_bridge_has(launch, tmp_path, arguments, said):
    """As launch_ros hands it over: one file after the other, the last made of the arguments and for any node."""
    own, typed = tmp_path / 'own.yaml', tmp_path / 'typed.yaml'
    own.write_text('bridge: {ros__parameters: {port: /nowhere/own}}')
    started = launch('rig', bridge=str(own), **arguments)['bridge']
    typed.write_text(yaml.safe_dump({'/**': {'ros__parameters': started.values}}))
    with Program('bridge', '--ros-args', '--params-file', *started.files, '--params-file', typed) as bridge:
        bridge.wait_for(said)


def test_the_view_describes_the_rig_and_shows_it_where_wanted(launch):
    (only,) = launch('view').values()
    assert only.values['robot_description'].startswith('<?xml')
    started = launch('view', rviz='true', plotjuggler='1')
    assert tuple(started) == OTHERS
    assert all(Path(shown.arguments[1]).is_file() for shown in launch.started[1:])


def test_what_is_always_started_is_in_package_xml(launch):
    declared = {e.text for e in ElementTree.parse(ROOT / 'package.xml').iter('exec_depend')} | {PACKAGE}
    for file in FILES:
        assert {program.package for program in launch(file.name.split('.')[0]).values()} <= declared


@pytest.mark.parametrize('file', FILES, ids=lambda file: file.name)
def test_every_argument_is_described_and_used(file):
    source = file.read_text()
    for name, (_, description) in arguments_of(file).items():
        assert description
        rest = source.replace(f"'{name}': (", '')
        assert f"'{name}'" in rest or 'in ARGUMENTS}' in rest, f'{name} is declared and nowhere used'


@pytest.mark.parametrize('file', FILES, ids=lambda file: file.name)
def test_its_examples_and_those_it_includes_name_arguments_that_there_are(file):
    """An argument may also be one of an included file: they are all of one scope."""
    known = set()
    for name in {file.name, *re.findall(r"'(\w+\.launch\.py)'", file.read_text()), 'view.launch.py', 'rig.launch.py'}:
        known |= set(arguments_of(ROOT / 'launch' / name))
    for line in file.read_text().splitlines():
        if line.startswith('ros2 launch'):
            assert f' {PACKAGE} {file.name} ' in line
            assert set(re.findall(r' (\w+):=', line)) <= known
