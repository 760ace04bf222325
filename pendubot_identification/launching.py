# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The common part of the launch files: all checks precede the first program, and all programs end together.

Launch starts programs while it visits a description. So each launch file is a single action, which checks all arguments
and all programs before it returns the nodes to start.
"""

import os
import re
import runpy
import signal
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, List  # noqa: UP035  (launch_ros of Jazzy requires this name for lists)

import yaml
from ament_index_python.packages import PackageNotFoundError, get_package_prefix

from pendubot_identification.errors import ParameterError, PendubotError
from pendubot_identification.nodes.shutdown import LAUNCH
from pendubot_identification.resources import NAME, resource
from pendubot_identification.setting import Setting, meant

#: The environment variable for the discovery range of ROS programs, and its accepted values.
RANGE, RANGES = 'ROS_AUTOMATIC_DISCOVERY_RANGE', ('LOCALHOST', 'SUBNET', 'SYSTEM_DEFAULT')
#: The environment variables for a profile of Fast DDS: in the version of Jazzy, and in later versions.
PROFILES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')
#: The arguments of every launch file.
COMMON = {
    # Every discovered program may arm the motor.
    'discovery': (
        os.environ.get(RANGE) or 'LOCALHOST',
        f'LOCALHOST: only programs on this machine; SUBNET: also programs on its network; default: {RANGE}',
    ),
    'namespace': ('', 'namespace of the rig, such as /lab1; several rigs need different namespaces'),
}
#: Arguments of the launch library itself, which no launch file declares.
LIBRARY = ('launch-prefix', 'launch-prefix-filter', 'emulate_tty', 'sigterm_timeout', 'sigkill_timeout')
#: Programs that only show the rig; they share one enclave of config/sros2_policy.xml.
VIEWERS = ('robot_state_publisher', 'rviz2', 'plotjuggler')
#: Absolute topic names in programs of other packages, which are remapped into the namespace of the rig.
SHARED = ('tf', 'tf_static', 'joint_states', *(f'{rig}robot_description' for rig in ('', 'pendubot/', 'ghost/')))
#: The started nodes of this package.
_nodes: list[Any] = []


@dataclass(frozen=True)
class Program:
    """A program that a launch file starts.

    At the end of a program of this package, all programs end, with status 1 if it failed. A program of another package
    only shows the rig: at its end, all others continue.
    """

    name: str  #: Name of the executable, and of its node unless ``node`` is set.
    parameters: tuple[str | dict[str, Any], ...] = ()  #: Parameter files, and values by name; later ones override.
    arguments: tuple[str, ...] = ()
    package: str = NAME
    remedy: str = f'build {NAME} with colcon, and source its workspace'  #: Correction if the program is not installed.
    node: str = ''
    remappings: tuple[tuple[str, str], ...] = ()


def launch_file(name: str) -> dict[str, Any]:
    """Return the definitions of another launch file of this package, such as ``ARGUMENTS`` and ``start``."""
    return runpy.run_path(str(resource(f'launch/{name}')))


def is_installed(package: str, file: str = '') -> bool:
    """Return whether a package is installed and has a file below its prefix."""
    try:
        return Path(get_package_prefix(package), file).exists()
    except PackageNotFoundError:
        return False


def described(arguments: Mapping[str, tuple[Any, str]], start: Callable[[dict[str, Any]], Sequence[Program]]) -> Any:
    """Return the launch description of a launch file.

    Args:
        arguments: the default, which defines the type, and the description by name.
        start: returns the programs for the values of the arguments, with ``namespace`` resolved; it raises
            PendubotError for an invalid argument.
    """
    from launch import LaunchDescription
    from launch.actions import DeclareLaunchArgument, LogInfo, OpaqueFunction
    from launch_ros.actions import Node
    from launch_ros.parameter_descriptions import ParameterValue

    def typed(values: str | dict[str, Any]) -> Any:
        # launch_ros would write lists as Python tuples, which no other YAML reader supports.
        texts = List[str]  # noqa: UP006
        if isinstance(values, str):
            return values
        return {k: ParameterValue(v, value_type=texts) if isinstance(v, list) else v for k, v in values.items()}

    def make(context: Any) -> list[Any]:
        # The complete description: another launch file, with its own arguments, may include this one.
        complete = getattr(context.locals.event, 'launch_description', None)
        known = [] if complete is None else [each.name for each in complete.get_launch_arguments()]
        try:
            planned = plan(arguments, start, context.launch_configurations, context.argv if known else [], known)
        except PendubotError as error:
            raise ParameterError(f'nothing was started: {error}') from None
        # At SIGTERM launch itself would end without its programs and, as the first process of a container, ignore it.
        if signal.getsignal(signal.SIGTERM) == signal.SIG_DFL:
            signal.signal(signal.SIGTERM, _terminate)
        nodes = [Node(**each | {'parameters': [typed(values) for values in each['parameters']]}) for each in planned]
        _nodes.extend(node for node, each in zip(nodes, planned, strict=True) if 'on_exit' in each)
        environment = planned[0]['additional_env']
        if environment[RANGE] == 'LOCALHOST' and PROFILES[0] not in environment:
            text = f'your {" or ".join(PROFILES)} decides whether programs on other machines can arm the motor'
            return [LogInfo(msg=text), *nodes]
        return nodes

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
    are the NAME:=VALUE of the command line, and ``known`` the names of all declared arguments.

    Raises:
        PendubotError: an argument is invalid, or a program is missing.
    """
    for name in (word.partition(':=')[0] for word in words):
        if name not in (*known, *LIBRARY):
            raise ParameterError(
                f'this launch has no argument {name}; {meant(name, known)}? --show-args lists them all'
            )
    values = {name: _value(name, texts[name], default) for name, (default, _) in {**arguments, **COMMON}.items()}
    if values['discovery'] not in RANGES:
        raise ParameterError(f'discovery is {values["discovery"]}; one of {", ".join(RANGES)} is expected')
    # Like in launch_ros, a namespace without / is relative to the namespace of the including file.
    above = '' if values['namespace'].startswith('/') else texts.get('ros_namespace', '')
    parts = [part for part in f'{above}/{values["namespace"]}'.split('/') if part]
    values['namespace'] = ''.join(f'/{part}' for part in parts)
    if not re.fullmatch(r'(/[A-Za-z_]\w*)*', values['namespace'], re.ASCII):
        raise ParameterError(
            f'namespace is {values["namespace"]}; names of letters, digits and _, without a digit first, are expected, '
            'such as /lab1'
        )
    environment = {RANGE: values['discovery']}
    if values['discovery'] == 'LOCALHOST' and not any(os.environ.get(name) for name in PROFILES):
        environment |= dict.fromkeys(PROFILES, str(resource('config/this_machine.xml')))
    return [_node(program, values['namespace'], texts, environment) for program in start(values)]


def _node(program: Program, namespace: str, texts: Mapping[str, str], environment: dict[str, str]) -> dict[str, Any]:
    """Return the arguments of ``launch_ros.actions.Node`` for a program; refuse a program that is not installed."""
    if not is_installed(program.package, f'lib/{program.package}/{program.name}'):
        raise ParameterError(f'{program.name} is not installed; {program.remedy}')
    node = {
        'package': program.package,
        'executable': program.name,
        'exec_name': program.name,
        'namespace': namespace,
        'output': 'screen',
        'parameters': program.parameters,
        'arguments': program.arguments,
        # After SIGINT launch does not signal its programs at first, because at Ctrl-C the terminal does; a supervisor
        # does not. A recorder needs time to close its bag on a slow disk. [s]
        'sigterm_timeout': texts.get('sigterm_timeout', '0.2'),
        'sigkill_timeout': texts.get('sigkill_timeout', '10'),
        'additional_env': environment,
    }
    if os.environ.get('ROS_SECURITY_KEYSTORE') and (program.package == NAME or program.name in VIEWERS):
        enclave = 'viewer' if program.name in VIEWERS else program.name
        node['ros_arguments'] = ['--enclave', f'/pendubot/{enclave}']
    if program.package == NAME:
        # The program ends with launch, for any cause.
        ending = {**environment, LAUNCH: str(os.getpid())}
        return node | {'name': program.name, 'on_exit': _ended, 'additional_env': ending}
    # A program of another package does not monitor launch: the system terminates it when launch has ended.
    prefix = f'setpriv --pdeathsig TERM {texts.get("launch-prefix", "")}'
    remappings = [*program.remappings, *((f'/{topic}', topic) for topic in SHARED)]
    return node | {'name': program.node or None, 'remappings': remappings, 'prefix': prefix}


def _ended(event: Any, context: Any) -> Any:
    """End all programs; raise PendubotError after a failure, because only an exception gives launch a status not 0."""
    from launch.actions import EmitEvent
    from launch.events import Shutdown

    # During the shutdown, a signal may end a program before its own handler is set.
    signalled = context.is_shutdown and event.returncode in (-signal.SIGINT, -signal.SIGTERM)
    if event.returncode and not signalled:
        failed = f'{event.process_name} failed, with status {event.returncode}'
        raise PendubotError(f'{failed}: all programs end; see its last lines above')
    return EmitEvent(event=Shutdown(reason=f'{event.process_name} has ended'))


def _terminate(*_: Any) -> None:
    """Terminate the programs and wait until they have ended; then launch ends."""
    pids = [node.process_details['pid'] for node in _nodes if node.process_details]
    for wait in (os.WNOHANG, 0):
        for pid in pids:
            # Raises if the process has been reaped, because its number may belong to another process now.
            with suppress(ChildProcessError):
                if os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT | wait) is None:
                    os.kill(pid, signal.SIGTERM)


def _value(name: str, text: str, default: Any) -> Any:
    """Return the value of an argument, converted to the type of its default."""
    if not isinstance(default, list):
        setting = Setting(name, default, '')
        value = setting.parse(os.path.expanduser(text))
        setting.check(value)
        return value
    with suppress(yaml.YAMLError):
        listed = yaml.safe_load(text) if text.startswith('[') else [text]
        if all(isinstance(each, str) for each in listed):
            return [*map(os.path.expanduser, listed)] or ['']  # ROS has no list without elements
    raise ParameterError(f"{name} is {text}; a text, or a list of texts such as \"['a', 'b']\", is expected")
