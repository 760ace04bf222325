# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The launch files by the rules of the launch library: by that itself where it is, as in a ROS workspace.

No registry of Python packages has it; elsewhere stand-ins go by the same rules: one entity is visited after the other,
what is a program starts at once, and what raises after that leaves it running.
"""

import importlib.util
import os
import re
import select
import signal
import sys
import tempfile
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import List, NamedTuple  # noqa: UP035

import pytest
import yaml

from pendubot_identification.errors import ParameterError, PendubotError
from pendubot_identification.formats.export import export
from pendubot_identification.model.parameters import BALANCE
from pendubot_identification.nodes.shutdown import LAUNCH
from pendubot_identification.results.result_file import read_result
from test import processes
from test.conftest import ROOT
from test.processes import Program

REAL = importlib.util.find_spec('launch_ros') is not None
PACKAGE = 'pendubot_identification'
PROGRAMS = 'bridge', 'recorder', 'exciter', 'player', 'identifier', 'virtual_board'
#: Programs of others, which are packages of the same name.
OTHERS = 'robot_state_publisher', 'rviz2', 'plotjuggler'
RANGE = 'ROS_AUTOMATIC_DISCOVERY_RANGE'
PROFILES = 'FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE'


class Started(NamedTuple):
    """A program as it was started: what stands before it, its parameters, and what is done with its exit status."""

    package: str
    executable: str
    before: list
    arguments: list
    files: list
    values: dict
    namespace: str
    environment: dict
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


class Description:
    """Entities, and the arguments that they declare, those of files that are included among them."""

    def __init__(self, entities):
        self.entities = entities

    def visit(self, context):
        return self.entities

    def get_launch_arguments(self):
        inner = [each.inner() if hasattr(each, 'inner') else each for each in self.entities]
        files = [
            argument for each in inner if isinstance(each, Description) for argument in each.get_launch_arguments()
        ]
        return [*files, *(each for each in inner if hasattr(each, 'name'))]


def declare_launch_argument(name, *, default_value, description='an argument'):
    assert isinstance(default_value, str)
    assert description
    declared = Action(lambda context: context.launch_configurations.setdefault(name, default_value) and None)
    declared.name = name
    return declared


def include_launch_description(path, *, launch_arguments=(), condition=None):
    def execute(context):
        for name, value in launch_arguments:
            context.launch_configurations[name] = performed(value, context)
        return [described(path)]

    included = Action(execute, condition)
    included.inner = lambda: described(path)
    return included


def node(
    *, package, executable, exec_name, namespace, output, additional_env, sigterm_timeout, sigkill_timeout, prefix='',
    parameters=(), arguments=(), remappings=(), name=None, on_exit=None,
):  # fmt: skip
    def execute(context):
        ExecutableInPackage(executable, package).perform(context)
        assert (exec_name, output) == (executable, 'screen')
        assert float(performed(sigterm_timeout, context)) < float(performed(sigkill_timeout, context))
        files = [each for each in parameters if isinstance(each, str)]
        typed = [each for each in parameters if isinstance(each, dict)]
        values = {key: evaluated(value) for each in typed for key, value in each.items()}
        assert list(parameters) == [*files, *typed], 'what is given as an argument has to come last, to count'
        assert name == (executable if package == PACKAGE else None), 'a parameter file is addressed to this node'
        assert all(re.fullmatch(r'/(\w+)', topic)[1] == relative for topic, relative in remappings)
        where = performed(namespace, context)
        before = performed(prefix, context).split()
        context.started.append(
            Started(package, executable, before, list(arguments), files, values, where, additional_env, on_exit)
        )

    return Action(execute)


#: Of each module of the library, what the launch files take from it.
STAND_INS = {
    'launch': {
        'LaunchContext': SimpleNamespace,
        'LaunchDescription': Description,
    },
    'launch.actions': {
        'DeclareLaunchArgument': declare_launch_argument,
        'EmitEvent': lambda *, event: SimpleNamespace(event=event),
        'IncludeLaunchDescription': include_launch_description,
        'LogInfo': lambda *, msg: Action(lambda context: context.logged.append(msg)),
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
    own = {name: value for name, value in program.final_env.items() if os.environ.get(name) != value or name == RANGE}
    return Started(
        action.node_package, action.node_executable, before, arguments, files, values, namespace, own, on_exit
    )


@pytest.fixture
def packages(tmp_path, monkeypatch):
    """The packages that are installed; their programs may be taken away."""
    folder, index = tmp_path / 'prefix' / 'lib', tmp_path / 'prefix/share/ament_index/resource_index/packages'
    index.mkdir(parents=True)
    for package, program in [*((PACKAGE, program) for program in PROGRAMS), *((other, other) for other in OTHERS)]:
        (folder / package).mkdir(parents=True, exist_ok=True)
        (folder / package / program).touch(0o755)
        (index / package).touch()
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path / 'prefix'))
    return folder


@pytest.fixture
def launch(monkeypatch, packages, tmp_path):
    """Launch a file by name, with arguments or their defaults; returns what was started, also in ``launch.started``."""
    monkeypatch.setattr(tempfile, 'tempdir', str(tmp_path))
    monkeypatch.delitem(sys.modules, f'{PACKAGE}.launching', raising=False)
    if REAL:
        import launch as library
        from launch.actions import ExecuteLocal, LogInfo

        def execute(action, context):
            action.prepare(context)
            run.started.append(read_back(action))

        def log(action, context):
            run.logged.append(performed(action.msg, context))

        monkeypatch.setattr(ExecuteLocal, 'execute', execute)
        monkeypatch.setattr(LogInfo, 'execute', log)
    else:
        for name, content in STAND_INS.items():
            module = ModuleType(name)
            vars(module).update(content)
            monkeypatch.setitem(sys.modules, name, module)

    def visit(entity, context):
        for each in entity.visit(context) or []:
            visit(each, context)

    def run(name, **arguments):
        run.started, run.logged, words = [], [], [f'{name}:={value}' for name, value in arguments.items()]
        description = described(name if isinstance(name, Path) else ROOT / 'launch' / f'{name}.launch.py')
        event = SimpleNamespace(launch_description=description)
        if REAL:
            run.context = library.LaunchContext(argv=words)
            run.context.extend_locals({'event': event})
        else:
            run.context = SimpleNamespace(
                launch_configurations={}, started=run.started, logged=run.logged, argv=words,
                locals=SimpleNamespace(event=event),
            )  # fmt: skip
        run.context.launch_configurations.update(arguments)
        visit(description, run.context)
        return {each.executable: each for each in run.started}

    before = signal.getsignal(signal.SIGTERM)
    yield run
    signal.signal(signal.SIGTERM, before)
    sys.modules.pop(f'{PACKAGE}.launching', None)


#: Where somebody's own parameter file is named.
MINE = '~/mine.yaml'


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
def test_starts_the_programs_with_parameters_that_they_have_on_this_machine_in_one_namespace(
    launch, monkeypatch, name, programs
):
    monkeypatch.delenv(RANGE, raising=False)
    started = launch(name)
    assert list(started) == programs
    for program in {*programs} & {*PROGRAMS} - {'virtual_board'}:
        module = importlib.import_module(f'{PACKAGE}.nodes.{program}')
        assert set(started[program].values) <= {setting.name for setting in getattr(module, program.title()).SETTINGS}
        assert started[program].files in ([], [str(ROOT / 'config' / f'{program}.yaml')])
    assert {(each.namespace, each.environment[RANGE]) for each in started.values()} == {('', 'LOCALHOST')}
    told = launch(name, namespace='lab1', discovery='SUBNET').values()
    assert {(each.namespace, each.environment[RANGE]) for each in told} == {('lab1', 'SUBNET')}


@pytest.mark.parametrize('name', ['rig', 'virtual', 'view', 'identification', 'replay'])
def test_programs_of_other_machines_are_kept_out_unless_they_are_wanted_or_a_profile_is_there(
    launch, monkeypatch, name
):
    """By a profile of Fast DDS; test_network.py shows what it does."""

    def profiles(**arguments):
        (set_,) = {
            tuple(each.environment.get(name) for name in PROFILES) for each in launch(name, **arguments).values()
        }
        return set_

    monkeypatch.delenv(RANGE, raising=False)
    for variable in PROFILES:
        monkeypatch.delenv(variable, raising=False)
    assert profiles() == (str(ROOT / 'config' / 'this_machine.xml'),) * 2
    assert launch.logged == []
    assert profiles(discovery='SUBNET') == (None, None)
    for variable in PROFILES:
        monkeypatch.setenv(variable, '/mine.xml')
        assert profiles() == (None, None)
        assert launch.logged
        assert all('is kept: it decides whether programs on other machines can arm' in line for line in launch.logged)
        assert profiles(discovery='SUBNET') == (None, None)
        assert launch.logged == []
        monkeypatch.delenv(variable)


@pytest.mark.parametrize(
    ('name', 'arguments', 'missing', 'said'),
    [
        ('rig', {'amplitude': 'nan'}, None, 'amplitude is nan; a number is expected'),
        ('rig', {'seed': '1.5'}, None, 'seed is 1.5; a whole number is expected'),
        ('rig', {'arm': ''}, None, 'arm is ; true or false is expected'),
        ('rig', {'rviz': 'yes'}, None, 'rviz is yes; true or false is expected'),
        ('rig', {'l1': 'abc'}, None, 'l1 is abc; a number is expected'),
        ('rig', {'discovery': 'MOON'}, None, 'discovery is MOON; one of LOCALHOST, SUBNET, SYSTEM_DEFAULT is expected'),
        ('rig', {'bridge': '/no.yaml'}, None, 'bridge is /no.yaml, and there is no such file; name a'),
        ('rig', {'excitation': '/'}, None, 'there is no such file; name a parameter file of exciter'),
        ('rig', {'amplitud': '0.05'}, None, 'this launch has no argument amplitud; is amplitude meant? --show-args'),
        ('virtual', {'plot_juggler': '1'}, None, 'this launch has no argument plot_juggler; is plotjuggler meant?'),
        ('replay', {'xyz': '1'}, None, 'this launch has no argument xyz; which is meant?'),
        ('virtual', {'l2': '-1'}, None, 'the length l2 is -1 m; a number above 0 is expected'),
        ('virtual', {'amplitude': 'abc'}, None, 'amplitude is abc; a number is expected'),
        ('view', {'plotjuggler': '2'}, None, 'plotjuggler is 2; true or false is expected'),
        ('replay', {'rate': 'slow'}, None, 'rate is slow; a number is expected'),
        ('identification', {'bags': "['a"}, None, 'bags is [\'a; a text, or a list of texts such as "[\'a\''),
        ('identification', {'validate': '[1]'}, None, 'validate is [1]; a text, or a list of texts'),
        ('rig', {}, 'exciter', 'exciter is not installed; build'),
        ('virtual', {}, OTHERS[0], 'robot-state-publisher, or give view:=false'),
        ('replay', {'rviz': 'true'}, OTHERS[1], 'sudo apt install ros-$ROS_DISTRO-rviz2, or give rviz:=false'),
        ('rig', {'plotjuggler': 'true'}, OTHERS[2], 'ros-$ROS_DISTRO-plotjuggler, or give plotjuggler:=false'),
    ],
)  # fmt: skip
def test_what_cannot_work_is_refused_before_anything_is_started(launch, packages, name, arguments, missing, said):
    """What came before would be running, and nobody would end it: an exciter would arm, and move the rig."""
    if missing:
        (packages / (missing if missing in OTHERS else PACKAGE) / missing).unlink()
    with pytest.raises(ParameterError, match='nothing was started: .*' + re.escape(said)):
        launch(name, **arguments)
    assert launch.started == []
    if missing in OTHERS:
        assert launch(name, **arguments, view='false'), 'what nobody wants is not missing'


#: A launch file of a user, with an argument of its own.
USERS = f"""
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

def generate_launch_description():
    rig = PythonLaunchDescriptionSource({str(ROOT / 'launch' / 'rig.launch.py')!r})
    return LaunchDescription([DeclareLaunchArgument('speed', default_value='1'), IncludeLaunchDescription(rig)])
"""


def test_a_launch_file_that_includes_ours_may_have_arguments_of_its_own(launch, tmp_path):
    file = tmp_path / 'users.launch.py'
    file.write_text(USERS)
    started = launch(file, speed='3', amplitude='0.05', l1='0.3', **{'launch-prefix': ''})
    assert started['exciter'].values['amplitude_max'] == 0.05
    with pytest.raises(ParameterError, match='this launch has no argument sped; is speed meant'):
        launch(file, sped='3')
    assert launch.started == []


@pytest.mark.parametrize('namespace', ['', 'lab1', '/lab1'])
@pytest.mark.parametrize(('argument', 'program'), [('bridge', 'bridge'), ('excitation', 'exciter')])
def test_a_parameter_file_of_which_nothing_is_taken_is_refused(launch, tmp_path, namespace, argument, program):
    """A rig would move by the defaults instead, within limits far from those of the file."""
    file = tmp_path / 'mine.yaml'
    given = {argument: str(file), **({'namespace': namespace} if namespace else {})}
    node = f'/lab1/{program}' if namespace else f'/{program}'
    for name in (f'/**/{program}', node, *([] if namespace else [program])):
        file.write_text(yaml.safe_dump({name: {'ros__parameters': {'seed': 1}}}))
        assert str(file) in launch('rig', **given)[program].files
    for name in ('recorder', f'/lab2/{program}', *([program] if namespace else [])):
        file.write_text(yaml.safe_dump({name: {'ros__parameters': {'seed': 1}}}))
        said = f'nothing was started: nothing is taken from {file}: it holds parameters of /{name.strip("/")}, and none'
        with pytest.raises(
            ParameterError, match=re.escape(f'{said} of {node}; name {node} in it, or /**/{program} for')
        ):
            launch('rig', **given)
        assert launch.started == []


def test_when_a_program_ends_everything_ends_and_when_one_failed_with_an_error(launch):
    """Launch returns another status than 0 only where something raises."""
    for program in launch('virtual', rviz='true').values():
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
        for number in (signal.SIGINT, signal.SIGTERM):
            ended.returncode = -number
            assert program.on_exit(ended, context), 'who is told to end has not failed'


@pytest.mark.ros
def test_programs_end_disarmed_when_launch_is_killed(launch, tmp_path):
    """The programs of a real launch by a parent that can tell them nothing more."""
    trace, script = tmp_path / 'trace.csv', tmp_path / 'launch.py'
    own = tmp_path / 'own.yaml'
    own.write_text('/**/bridge: {ros__parameters: {confirm_zeros: false}}')
    given = {
        'port': str(tmp_path / 'rig'),
        'output': str(tmp_path / 'bag'),
        'arm': 'true',
        'view': 'false',
        'bridge': str(own),
    }
    commands = []
    for program in launch('rig', **given).values():
        typed = tmp_path / f'{program.executable}.yaml'
        typed.write_text(yaml.safe_dump({'/**': {'ros__parameters': program.values}}))
        files = [word for file in (*program.files, typed) for word in ('--params-file', str(file))]
        start = [sys.executable, '-m', processes.MODULES[program.executable]]
        assert program.environment[LAUNCH] == str(os.getpid())
        commands.append([*program.before, *start, *program.arguments, '--ros-args', *files])
    script.write_text(
        'import os, subprocess\n'
        f'environment = {{**os.environ, {LAUNCH!r}: str(os.getpid())}}\n'
        f'started = [subprocess.Popen(command, env=environment) for command in {commands}]\n'
        'print("started", *(each.pid for each in started), flush=True)\n'
        'started[0].wait()\n'
    )
    with Program('virtual_board', '--link', given['port'], '--trace', trace) as board:
        board.wait_for('virtual board on')
        with Program.of_file(script) as parent:
            ends = [os.pidfd_open(int(number)) for number in parent.wait_for('started').split()[1:]]
            try:
                parent.wait_for('exciting for')
            finally:
                parent.kill()
                left = [end for end in ends if not select.select([end], [], [], 10.0)[0]]
                for end in left:
                    signal.pidfd_send_signal(end, signal.SIGKILL)
            assert (len(ends), left) == (3, [])
    *_, torque, status = trace.read_text().splitlines()[-1].split(',')
    assert int(torque) == 0
    assert int(status) & 1 == 0, 'armed'


TRAIN = {'duration': 10.0, 'amplitude_min': -0.5, 'amplitude_max': 0.5, 'seed': 3}


@pytest.mark.parametrize(
    ('name', 'arguments', 'program', 'file', 'values'),
    [
        ('rig', {}, 'bridge', None, {}),
        ('rig', {'port': '7', 'baud': '115200'}, 'bridge', None, {'port': '7', 'baud': 115200}),
        # A limit on the torque above all is the file's; with a virtual board never its port, where a rig may be.
        ('rig', {'bridge': MINE}, 'bridge', MINE, {}),
        ('rig', {'bridge': MINE, 'virtual': 'true'}, 'bridge', MINE,
         {'port': '/tmp/pendubot', 'confirm_zeros': False}),
        ('virtual', {'port': '/tmp/x'}, 'bridge', None, {'port': '/tmp/x', 'confirm_zeros': False}),
        # Nothing is moved that is not recorded.
        ('rig', {'amplitude': '0.5', 'duration': '10', 'seed': '3', 'arm': 'true'}, 'exciter', None,
         {'arm': True, 'recorded': True, **TRAIN}),
        ('rig', {'amplitude': '0.5', 'excitation': MINE}, 'exciter', MINE, {'arm': False, 'recorded': True}),
    ],
)  # fmt: skip
def test_parameters_are_those_of_the_file_but_for_what_is_an_argument(
    launch, tmp_path, monkeypatch, name, arguments, program, file, values
):
    monkeypatch.setenv('HOME', str(tmp_path))
    (tmp_path / 'mine.yaml').write_text(yaml.safe_dump({program: {'ros__parameters': {'seed': 1}}}))
    started = launch(name, **arguments)
    expected = str(tmp_path / 'mine.yaml' if file else ROOT / 'config' / f'{program}.yaml')
    assert (started[program].files, started[program].values) == ([expected], values)
    if 'virtual_board' in started:
        assert started['virtual_board'].arguments == ['--link', values['port']]


@pytest.mark.parametrize(
    ('given', 'bags'),
    [({}, ['']), ({'bags': '12'}, ['12']), ({'bags': "['a@0:9', 'b']"}, ['a@0:9', 'b']), ({'bags': '[]'}, [''])],
)
def test_bags_are_one_or_a_list(launch, given, bags):
    values = launch('identification', **given, validate='c')['identifier'].values
    assert (values['bags'], values['validate']) == (bags, ['c'])


def test_the_view_describes_the_rig_and_shows_it_where_wanted(launch, tmp_path):
    (only,) = launch('view').values()
    assert '<mass' not in only.values['robot_description']
    given = {name: {'value': value} for name, value in asdict(BALANCE).items()}
    (tmp_path / 'rig.yaml').write_text(yaml.safe_dump({'schema': 1, 'parameters': given}))
    (only,) = launch('view', parameters=str(tmp_path / 'rig.yaml')).values()
    assert only.values['robot_description'] == export(read_result(tmp_path / 'rig.yaml'), 'urdf')[0]
    started = launch('view', rviz='true', plotjuggler='1')
    assert tuple(started) == OTHERS
    assert all(Path(shown.arguments[1]).is_file() for shown in launch.started[1:])
