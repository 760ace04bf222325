# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What the launch files share: everything is checked before the first program starts, and all programs end together.

Launch starts programs while it visits a description. So every argument is read, and every program is looked for, before
the first program starts.
"""

from __future__ import annotations

import difflib
import math
import os
import signal
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import Any, List  # noqa: UP035  (launch_ros of Jazzy knows lists by this name)

import yaml
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, IncludeLaunchDescription, LogInfo, OpaqueFunction
from launch.events import Shutdown
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import ExecutableInPackage

from pendubot_identification.errors import ParameterError, PendubotError
from pendubot_identification.nodes.shutdown import LAUNCH
from pendubot_identification.resources import NAME, resource

#: The variable that says among which machines ROS programs find each other, and what it may say here.
RANGE, RANGES = 'ROS_AUTOMATIC_DISCOVERY_RANGE', ('LOCALHOST', 'SUBNET', 'SYSTEM_DEFAULT')
#: The arguments that every launch file has.
COMMON = {
    # Whoever is found may arm the motor.
    'discovery': (
        os.environ.get(RANGE) or 'LOCALHOST',
        f'LOCALHOST: only programs on this machine take part; SUBNET: also those on its network; by default as {RANGE}',
    ),
    'namespace': ('', 'names begin with it, such as /lab1: one for each of several rigs'),
}
#: Arguments of the launch library itself, which no file declares.
LIBRARY = ('launch-prefix', 'launch-prefix-filter', 'emulate_tty', 'sigterm_timeout', 'sigkill_timeout')
#: The variables that name a profile of Fast DDS: of Jazzy's version, and of later ones.
PROFILES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')
#: The programs of this package that were started.
_programs: list[Node] = []


def described(
    arguments: Mapping[str, tuple[Any, str]],
    start: Callable[[dict[str, Any]], Sequence[Any]],
    *included: IncludeLaunchDescription,
) -> LaunchDescription:
    """Return the description of a launch file.

    Args:
        arguments: by name, the default, whose type the value has to have, and what it means.
        start: makes a list of :func:`program` and :func:`viewer` from the values of the arguments, ``namespace``
            resolved; it raises PendubotError for whatever is wrong.
        included: other launch files, gone through in between: what they check, they check before anything starts, too.
    """
    arguments = {**arguments, **COMMON}
    entities: list[Any] = []

    def check(context: LaunchContext) -> None:
        try:
            _refuse_unknown(context)
            texts = context.launch_configurations
            given = {name: _value(name, texts[name], default) for name, (default, _) in arguments.items()}
            if given['discovery'] not in RANGES:
                raise ParameterError(f'discovery is {given["discovery"]}; one of {", ".join(RANGES)} is expected')
            # As launch_ros does it: a namespace without / is below that of the including file.
            names = ('' if given['namespace'].startswith('/') else texts.get('ros_namespace', '')), given['namespace']
            given['namespace'] = ''.join(f'/{part}' for name in names for part in name.split('/') if part)
            environment = _environment(given['discovery'])
            entities.extend(made(additional_env=environment) for made in start(given))
            if entities and given['discovery'] == 'LOCALHOST' and PROFILES[0] not in environment:
                entities.insert(0, LogInfo(msg=_OWN_PROFILE))
        except PendubotError as error:
            raise ParameterError(f'nothing was started: {error}') from None
        # Launch itself would leave its programs at SIGTERM, and as the first process of a container ignore it.
        if signal.getsignal(signal.SIGTERM) == signal.SIG_DFL:
            signal.signal(signal.SIGTERM, _terminate)

    declared = [
        DeclareLaunchArgument(name, default_value=str(default), description=description)
        for name, (default, description) in arguments.items()
    ]
    started = OpaqueFunction(function=lambda _: entities)
    return LaunchDescription([*declared, OpaqueFunction(function=check), *included, started])


#: What is logged where the user's profile of Fast DDS is kept.
_OWN_PROFILE = (
    f'the Fast DDS profile that {" or ".join(PROFILES)} names is kept: it decides whether programs on other machines '
    'can arm the motor'
)


def _environment(discovery: str) -> dict[str, str]:
    """Return the environment variables of every program for a range of discovery."""
    environment = {RANGE: discovery}
    if discovery == 'LOCALHOST' and not any(os.environ.get(name) for name in PROFILES):
        environment |= dict.fromkeys(PROFILES, str(resource('config/this_machine.xml')))
    return environment


def _refuse_unknown(context: LaunchContext) -> None:
    """Refuse arguments of the command line that neither the launched file nor a file that it includes declares.

    Raises:
        ParameterError: there is one.
    """
    # The whole that is launched: this file may be included by another one, with arguments of its own.
    whole = getattr(context.locals.event, 'launch_description', None)
    if whole is None:  # included later, when something else happened
        return
    known = [declared.name for declared in whole.get_launch_arguments()]
    for name in (word.partition(':=')[0] for word in context.argv):
        if name not in (*known, *LIBRARY):
            near = difflib.get_close_matches(name, known, 1)
            meant = f'is {near[0]} meant' if near else 'which is meant'
            raise ParameterError(f'this launch has no argument {name}; {meant}? --show-args lists them all')


def _terminate(*_: Any) -> None:
    """Terminate the programs and wait until they have ended; then launch ends."""
    pids = [node.process_details['pid'] for node in _programs if node.process_details]
    for wait in (os.WNOHANG, 0):
        for pid in pids:
            # Raises where it has been reaped: the number may be another process's by now.
            with suppress(ChildProcessError):
                if os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT | wait) is None:
                    os.kill(pid, signal.SIGTERM)


def include(file: str, **given: Any) -> IncludeLaunchDescription:
    """Return another launch file of this package, to be included; it has the including one's arguments, too."""
    return IncludeLaunchDescription(PythonLaunchDescriptionSource(str(resource(f'launch/{file}'))), **given)


def program(name: str, *parameters: Any, arguments: Sequence[str] = ()) -> Callable[..., Node]:
    """Return what makes a program of this package, given its ``additional_env``.

    When the program ends, everything ends: with status 1, if it failed. It ends with launch, whatever ends that.

    ``name`` is that of its node, too; ``parameters`` are files, and values by name: what comes later counts.

    Raises:
        ParameterError: it is not there.
    """
    remedy, values = f'build {NAME} with colcon, and source its workspace', [*map(_plain, parameters)]
    given = {'name': name, 'parameters': values, 'arguments': arguments, 'on_exit': _ended}

    def make(additional_env: dict[str, str]) -> Node:
        _programs.append(made(additional_env={**additional_env, LAUNCH: str(os.getpid())}))
        return _programs[-1]

    made = _node(NAME, name, remedy, **given)
    return make


def viewer(package: str, remedy: str, **given: Any) -> Callable[..., Node]:
    """Return what makes a program of another package that only shows what happens: when it ends, all else goes on.

    Raises:
        ParameterError: the package is not installed; ``remedy`` says what to do then.
    """
    # Absolute names in such programs, which two rigs would share.
    topics = 'tf', 'tf_static', 'joint_states', 'robot_description'
    remappings = [(f'/{topic}', topic) for topic in topics]
    # It knows nothing of launch: the system terminates it when launch has ended.
    prefix = ['setpriv --pdeathsig TERM ', LaunchConfiguration('launch-prefix', default='')]
    return _node(package, package, remedy, remappings=remappings, prefix=prefix, **given)


def _node(package: str, executable: str, remedy: str, **given: Any) -> Callable[..., Node]:
    try:
        ExecutableInPackage(executable, package).perform(LaunchContext())
    except Exception:
        raise ParameterError(f'{executable} is not installed; {remedy}') from None
    return partial(
        Node,
        package=package,
        executable=executable,
        exec_name=executable,
        namespace=LaunchConfiguration('namespace'),
        output='screen',
        # At a SIGINT launch tells its programs nothing at first: at Ctrl-C the terminal has told them. A supervisor has
        # not. And a recorder needs time to close its bag on a slow disk. [s]
        sigterm_timeout=LaunchConfiguration('sigterm_timeout', default='0.2'),
        sigkill_timeout=LaunchConfiguration('sigkill_timeout', default='10'),
        **given,
    )


def _plain(parameters: Any) -> Any:
    """Keep launch_ros from writing lists as tuples of Python, which no other reader of YAML knows."""
    if not isinstance(parameters, dict):
        return parameters
    texts = List[str]  # noqa: UP006
    return {k: ParameterValue(v, value_type=texts) if isinstance(v, list) else v for k, v in parameters.items()}


def _ended(event: Any, context: LaunchContext) -> EmitEvent:
    """End everything; launch has a status other than 0 only where something raises."""
    # Some are told to end before they can do so by themselves.
    told = context.is_shutdown and event.returncode in (-signal.SIGINT, -signal.SIGTERM)
    if event.returncode and not told:
        raise PendubotError(f'{event.process_name} failed, with status {event.returncode}: everything ends')
    return EmitEvent(event=Shutdown(reason=f'{event.process_name} has ended'))


#: By the type of an argument: what is expected.
EXPECTED = {
    bool: 'true or false',
    int: 'a whole number',
    float: 'a number',
    list: "a text, or a list of texts such as \"['a', 'b']\",",
}


def _value(name: str, text: str, default: Any) -> Any:
    """Return what an argument says, as a value of the type of its default."""
    kind = type(default)
    with suppress(KeyError, ValueError, yaml.YAMLError):
        if kind is bool:
            return {'true': True, '1': True, 'false': False, '0': False}[text.lower()]
        if kind is list:
            listed = yaml.safe_load(text) if text.startswith('[') else [text]
            if all(isinstance(each, str) for each in listed):
                return listed or ['']  # ROS has no list without elements
        elif kind is not float or math.isfinite(float(text)):
            return kind(text)
    raise ParameterError(f'{name} is {text}; {EXPECTED[kind]} is expected')
