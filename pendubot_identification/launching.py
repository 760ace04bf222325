# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What the launch files share: all is checked before anything starts, and what is started ends together.

Launch starts programs while it goes through a description. What raises later, such as a missing package, ends launch
and leaves them running. So every argument is read, and every program looked for, before the first is started.
"""

from __future__ import annotations

import math
import os
import shutil
import signal
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any, List  # noqa: UP035  (launch_ros of Jazzy knows lists by this name)

import yaml
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, IncludeLaunchDescription, OpaqueFunction
from launch.events import Shutdown
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import ExecutableInPackage

from pendubot_identification.errors import ParameterError, PendubotError
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
#: Has the system end a program, by SIGTERM, when launch is gone: one that is killed, or terminated, ends none itself.
END_WITH_LAUNCH = 'setpriv --pdeathsig TERM '


def described(
    arguments: Mapping[str, tuple[Any, str]],
    start: Callable[[dict[str, Any]], Sequence[Any]],
    *included: IncludeLaunchDescription,
) -> LaunchDescription:
    """Return the description of a launch file.

    Args:
        arguments: by name, the default, whose type the value has to have, and what it means.
        start: makes of the arguments' values what is to be started; whatever is wrong it has to find.
        included: other launch files, gone through in between: what they check, they check before anything starts, too.
    """
    arguments = {**arguments, **COMMON}
    entities: list[Any] = []

    def check(context: LaunchContext) -> None:
        try:
            if shutil.which('setpriv') is None:
                raise ParameterError('setpriv is not installed; install util-linux')
            texts = context.launch_configurations
            given = {name: _value(name, texts[name], default) for name, (default, _) in arguments.items()}
            if given['discovery'] not in RANGES:
                raise ParameterError(f'discovery is {given["discovery"]}; one of {", ".join(RANGES)} is expected')
            entities.extend(start(given))
        except PendubotError as error:
            raise ParameterError(f'nothing was started: {error}') from None

    declared = [
        DeclareLaunchArgument(name, default_value=str(default), description=description)
        for name, (default, description) in arguments.items()
    ]
    started = OpaqueFunction(function=lambda _: entities)
    return LaunchDescription([*declared, OpaqueFunction(function=check), *included, started])


def include(file: str, **given: Any) -> IncludeLaunchDescription:
    """Return another launch file of this package, to be included; it has the including one's arguments, too."""
    return IncludeLaunchDescription(PythonLaunchDescriptionSource(str(resource(f'launch/{file}'))), **given)


def program(name: str, *parameters: Any, arguments: Sequence[str] = ()) -> Node:
    """Return a program of this package. When it ends, everything ends: with status 1, if it failed.

    ``name`` is that of its node, too; ``parameters`` are files, and values by name: what comes later counts.

    Raises:
        ParameterError: it is not there.
    """
    remedy, values = f'build {NAME} with colcon, and source its workspace', [*map(_plain, parameters)]
    return _node(NAME, name, remedy, name=name, parameters=values, arguments=arguments, on_exit=_ended)


def viewer(package: str, remedy: str, **given: Any) -> Node:
    """Return a program of another package that only shows what happens: when it ends, all else goes on.

    Raises:
        ParameterError: the package is not installed; ``remedy`` says what to do then.
    """
    # Absolute names in such programs, which two rigs would share.
    topics = 'tf', 'tf_static', 'joint_states', 'robot_description'
    return _node(package, package, remedy, remappings=[(f'/{topic}', topic) for topic in topics], **given)


def _node(package: str, executable: str, remedy: str, **given: Any) -> Node:
    try:
        ExecutableInPackage(executable, package).perform(LaunchContext())
    except Exception:
        raise ParameterError(f'{executable} is not installed; {remedy}') from None
    return Node(
        package=package,
        executable=executable,
        exec_name=executable,
        namespace=LaunchConfiguration('namespace'),
        output='screen',
        additional_env={RANGE: LaunchConfiguration('discovery')},
        prefix=[END_WITH_LAUNCH, LaunchConfiguration('launch-prefix', default='')],
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
    # At a Ctrl-C the terminal interrupts every program, and some before they can end by themselves.
    if event.returncode and not (context.is_shutdown and event.returncode == -signal.SIGINT):
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
