# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The common part of the launch files: everything is checked before the first program starts, and all end together.

Launch starts programs while it visits a description. So each launch file is a single action, which reads all arguments
and looks for all programs before it returns the nodes to start.
"""

import os
import runpy
import signal
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, List  # noqa: UP035  (launch_ros of Jazzy knows lists by this name)

import yaml
from ament_index_python.packages import PackageNotFoundError, get_package_prefix

from pendubot_identification.errors import ParameterError, PendubotError
from pendubot_identification.nodes.shutdown import LAUNCH
from pendubot_identification.resources import NAME, resource
from pendubot_identification.setting import Setting, meant

#: The variable for the machines among which ROS programs find each other, and its values here.
RANGE, RANGES = 'ROS_AUTOMATIC_DISCOVERY_RANGE', ('LOCALHOST', 'SUBNET', 'SYSTEM_DEFAULT')
#: The variables that name a profile of Fast DDS: of Jazzy's version, and of later ones.
PROFILES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')
#: The arguments that every launch file has.
COMMON = {
    # Every program that is found may arm the motor.
    'discovery': (
        os.environ.get(RANGE) or 'LOCALHOST',
        f'LOCALHOST: only programs on this machine take part; SUBNET: also those on its network; by default as {RANGE}',
    ),
    'namespace': ('', 'names begin with it, such as /lab1: one for each of several rigs'),
}
#: Arguments of the launch library itself, which no file declares.
LIBRARY = ('launch-prefix', 'launch-prefix-filter', 'emulate_tty', 'sigterm_timeout', 'sigkill_timeout')
#: The programs that only show the rig share one enclave of config/sros2_policy.xml; each other one of ours has its own.
VIEWERS = ('robot_state_publisher', 'rviz2', 'plotjuggler')
#: Absolute names of topics in programs of other packages, which two rigs would share.
SHARED = ('tf', 'tf_static', 'joint_states', *(f'{rig}robot_description' for rig in ('', 'pendubot/', 'ghost/')))
#: The nodes of this package that were started.
_nodes: list[Any] = []


@dataclass(frozen=True)
class Program:
    """A program that a launch file starts.

    When a program of this package ends, everything ends: with status 1, if it failed. A program of another package only
    shows the rig: when it ends, all others go on.
    """

    name: str  #: Of the executable, and of its node unless ``node`` is given.
    parameters: tuple[str | dict[str, Any], ...] = ()  #: Files, and values by name; later ones count.
    arguments: tuple[str, ...] = ()
    package: str = NAME
    remedy: str = f'build {NAME} with colcon, and source its workspace'  #: What to do if it is not installed.
    node: str = ''
    remappings: tuple[tuple[str, str], ...] = ()


def launch_file(name: str) -> dict[str, Any]:
    """Return the names that another launch file of this package defines, such as ``ARGUMENTS`` and ``start``."""
    return runpy.run_path(str(resource(f'launch/{name}')))


def is_installed(package: str, file: str = '') -> bool:
    """Return whether a package is installed, with a file below its prefix."""
    try:
        return Path(get_package_prefix(package), file).exists()
    except PackageNotFoundError:
        return False


def described(arguments: Mapping[str, tuple[Any, str]], start: Callable[[dict[str, Any]], Sequence[Program]]) -> Any:
    """Return the launch description of a launch file.

    Args:
        arguments: by name, the default, whose type the value has to have, and the meaning.
        start: returns the programs by the values of the arguments, ``namespace`` resolved; it raises PendubotError
            for anything wrong.
    """
    from launch import LaunchDescription
    from launch.actions import DeclareLaunchArgument, LogInfo, OpaqueFunction
    from launch_ros.actions import Node
    from launch_ros.parameter_descriptions import ParameterValue

    def typed(values: str | dict[str, Any]) -> Any:
        # launch_ros would write lists as tuples of Python, which no other reader of YAML knows.
        texts = List[str]  # noqa: UP006
        if isinstance(values, str):
            return values
        return {k: ParameterValue(v, value_type=texts) if isinstance(v, list) else v for k, v in values.items()}

    def make(context: Any) -> list[Any]:
        # All that is launched: this file may be included by another one, with arguments of its own.
        whole = getattr(context.locals.event, 'launch_description', None)
        known = [] if whole is None else [each.name for each in whole.get_launch_arguments()]
        try:
            planned = plan(arguments, start, context.launch_configurations, context.argv if known else [], known)
        except PendubotError as error:
            raise ParameterError(f'nothing was started: {error}') from None
        # Launch itself would leave its programs at SIGTERM, and as the first process of a container ignore it.
        if signal.getsignal(signal.SIGTERM) == signal.SIG_DFL:
            signal.signal(signal.SIGTERM, _terminate)
        made = [Node(**each | {'parameters': [typed(values) for values in each['parameters']]}) for each in planned]
        _nodes.extend(node for node, each in zip(made, planned, strict=True) if 'on_exit' in each)
        environment = planned[0]['additional_env']
        if environment[RANGE] == 'LOCALHOST' and PROFILES[0] not in environment:
            text = f'your {" or ".join(PROFILES)} decides whether programs on other machines can arm the motor'
            return [LogInfo(msg=text), *made]
        return made

    declared = [
        DeclareLaunchArgument(name, default_value=str(default), description=description)
        for name, (default, description) in {**arguments, **COMMON}.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=make)])


def plan(
    arguments: Mapping[str, tuple[Any, str]],
    start: Callable[[dict[str, Any]], Sequence[Program]],
    texts: Mapping[str, str],
    words: Sequence[str] = (),
    known: Sequence[str] = (),
) -> list[dict[str, Any]]:
    """Return the arguments of ``launch_ros.actions.Node`` for each program of a launch file, see :func:`described`.

    ``texts`` are the launch configurations: arguments, ``ros_namespace`` of an including file, and others. ``words``
    are those of the command line, NAME:=VALUE, and ``known`` the names of all arguments that exist.

    Raises:
        PendubotError: an argument or a program is missing or makes no sense.
    """
    for name in (word.partition(':=')[0] for word in words):
        if name not in (*known, *LIBRARY):
            raise ParameterError(
                f'this launch has no argument {name}; {meant(name, known)}? --show-args lists them all'
            )
    given = {name: _value(name, texts[name], default) for name, (default, _) in {**arguments, **COMMON}.items()}
    if given['discovery'] not in RANGES:
        raise ParameterError(f'discovery is {given["discovery"]}; one of {", ".join(RANGES)} is expected')
    # As launch_ros does it: a namespace without / is below that of the including file.
    above = '' if given['namespace'].startswith('/') else texts.get('ros_namespace', '')
    given['namespace'] = ''.join(f'/{part}' for part in f'{above}/{given["namespace"]}'.split('/') if part)
    environment = {RANGE: given['discovery']}
    if given['discovery'] == 'LOCALHOST' and not any(os.environ.get(name) for name in PROFILES):
        environment |= dict.fromkeys(PROFILES, str(resource('config/this_machine.xml')))
    return [_node(program, texts, environment) for program in start(given)]


def _node(program: Program, texts: Mapping[str, str], environment: dict[str, str]) -> dict[str, Any]:
    """Return the arguments of ``launch_ros.actions.Node`` for a program; refuse one that is not installed."""
    if not is_installed(program.package, f'lib/{program.package}/{program.name}'):
        raise ParameterError(f'{program.name} is not installed; {program.remedy}')
    node = {
        'package': program.package,
        'executable': program.name,
        'exec_name': program.name,
        'namespace': texts['namespace'],
        'output': 'screen',
        'parameters': program.parameters,
        'arguments': program.arguments,
        # At a SIGINT launch signals nobody at first: at Ctrl-C the terminal has signalled all programs. A supervisor
        # has not. And a recorder needs time to close its bag on a slow disk. [s]
        'sigterm_timeout': texts.get('sigterm_timeout', '0.2'),
        'sigkill_timeout': texts.get('sigkill_timeout', '10'),
        'additional_env': environment,
    }
    if os.environ.get('ROS_SECURITY_KEYSTORE') and (program.package == NAME or program.name in VIEWERS):
        enclave = 'viewer' if program.name in VIEWERS else program.name
        node['ros_arguments'] = ['--enclave', f'/pendubot/{enclave}']
    if program.package == NAME:
        # It ends with launch, whatever ends that.
        ending = {**environment, LAUNCH: str(os.getpid())}
        return node | {'name': program.name, 'on_exit': _ended, 'additional_env': ending}
    # It knows nothing of launch: the system terminates it when launch has ended.
    prefix = f'setpriv --pdeathsig TERM {texts.get("launch-prefix", "")}'
    remappings = [*program.remappings, *((f'/{topic}', topic) for topic in SHARED)]
    return node | {'name': program.node or None, 'remappings': remappings, 'prefix': prefix}


def _ended(event: Any, context: Any) -> Any:
    """End everything; launch has a status other than 0 only where something raises."""
    from launch.actions import EmitEvent
    from launch.events import Shutdown

    # Some are asked to end before they can do so by themselves.
    signalled = context.is_shutdown and event.returncode in (-signal.SIGINT, -signal.SIGTERM)
    if event.returncode and not signalled:
        failed = f'{event.process_name} failed, with status {event.returncode}'
        raise PendubotError(f'{failed}: everything ends; look at its last lines above')
    return EmitEvent(event=Shutdown(reason=f'{event.process_name} has ended'))


def _terminate(*_: Any) -> None:
    """Terminate the programs and wait until they have ended; then launch ends."""
    pids = [node.process_details['pid'] for node in _nodes if node.process_details]
    for wait in (os.WNOHANG, 0):
        for pid in pids:
            # Raises where it has been reaped: the number may be another process's by now.
            with suppress(ChildProcessError):
                if os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT | wait) is None:
                    os.kill(pid, signal.SIGTERM)


def _value(name: str, text: str, default: Any) -> Any:
    """Return the value of an argument, of the type of its default."""
    if not isinstance(default, list):
        setting = Setting(name, default, '')
        value = setting.parse(text)
        setting.check(value)
        return value
    with suppress(yaml.YAMLError):
        listed = yaml.safe_load(text) if text.startswith('[') else [text]
        if all(isinstance(each, str) for each in listed):
            return listed or ['']  # ROS has no list without elements
    raise ParameterError(f"{name} is {text}; a text, or a list of texts such as \"['a', 'b']\", is expected")
