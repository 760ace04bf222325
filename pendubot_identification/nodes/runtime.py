# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What every node shares: parameters with descriptors, ``--help``, signals, one-line errors, exit status."""

from __future__ import annotations

import difflib
import math
import re
import sys
import textwrap
import threading
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

import rclpy
import yaml
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import ParameterException, ParameterUninitializedException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from rclpy.timer import Timer
from rclpy.utilities import remove_ros_args

from pendubot_identification.errors import ParameterError, PendubotError
from pendubot_identification.parameter_files import parameter_files, refuse_untaken
from pendubot_identification.resources import resource
from pendubot_identification.setting import Setting

from .shutdown import Shutdown, ended


def descriptor(setting: Setting) -> ParameterDescriptor:
    """Return the ROS descriptor of a setting: description with unit, range, and whether it can change."""
    made = ParameterDescriptor(name=setting.name, description=setting.help(), read_only=not setting.dynamic)
    low, high = setting.minimum, setting.maximum
    if setting.choices:
        made.additional_constraints = setting.expected()
    if isinstance(setting.default, bool) or (math.isinf(low) and math.isinf(high)):
        return made
    if setting.optional:
        low = min(low, setting.default)
    if isinstance(setting.default, int):
        low, high = max(low, -(2**63)), min(high, 2**63 - 1)
        made.integer_range = [IntegerRange(from_value=int(low), to_value=int(high), step=0)]
    elif isinstance(setting.default, float):
        made.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
    elif not isinstance(setting.default, str):
        made.additional_constraints = setting.expected()
    return made


class SettingsNode(Node):
    """A node whose parameters are a table of :class:`Setting` and which ends cleanly.

    A subclass opens what it needs in ``__init__`` and gives it back in :meth:`close`, which runs while ROS still works:
    commands sent there arrive. ``ended`` is set when the program is to end.
    """

    PROGRAM: str
    SUMMARY: str
    SETTINGS: tuple[Setting, ...]

    def __init__(self, ended: Shutdown) -> None:
        super().__init__(self.PROGRAM)
        for path in parameter_files(sys.argv):
            refuse_untaken(path, self.get_fully_qualified_name())
        self.exit_status = 0
        self.ended = ended
        for setting in self.SETTINGS:
            try:
                self.declare_parameter(setting.name, setting.default, descriptor(setting))
            except ParameterException as error:
                # rclpy names the value only in its sentence.
                given = re.search(r"to '(.*)' of type|\((.*)\) for parameter", str(error), re.DOTALL)
                value = 'of another type' if given is None else given.group(given.lastindex or 0)
                raise setting.refusal(value) from error
        self._refuse_unknown()
        self._check(self.settings())
        self.add_pre_set_parameters_callback(lambda changed: [self._meant(p) for p in changed])
        self.add_on_set_parameters_callback(self._on_set)

    def settings(self, changed: Sequence[Parameter] = ()) -> dict[str, Any]:
        """Return the value of every setting, or what it is changed to: arrays as lists, what is left open as None."""
        given, values = {p.name: p.value for p in changed}, {}
        for setting in self.SETTINGS:
            try:
                value = given[setting.name] if setting.name in given else self.get_parameter(setting.name).value
            except ParameterUninitializedException as error:
                # What ROS makes of an empty list: it has no type.
                raise setting.refusal('empty') from error
            values[setting.name] = setting.of_ros(value)
        return values

    def check(self, values: dict[str, Any]) -> None:
        """Refuse settings that make no sense together, by ParameterError; a subclass overrides this."""

    def create_timer(self, period: float, callback: Callable[[], object]) -> Timer:
        """Call something every ``period`` [s] of real time, even where use_sim_time is set and /clock stands still."""
        return super().create_timer(period, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def end(self, status: int = 0) -> None:
        """End the program with this exit status, from any thread."""
        self.exit_status = status
        self.ended.set()

    def close(self) -> None:
        """Give back what the node holds; ROS still works. A subclass overrides this."""

    def _refuse_unknown(self) -> None:
        """Refuse parameters that there are not: a limit that is misspelt would not limit anything."""
        for name in self._parameter_overrides:
            # The latter are declared with their topics.
            if not self.has_parameter(name) and not name.startswith('qos_overrides.'):
                near = difflib.get_close_matches(name, [setting.name for setting in self.SETTINGS], 1)
                meant = f'is {near[0]} meant' if near else 'which is meant'
                raise ParameterError(f'{self.PROGRAM} has no parameter {name}; {meant}? --help lists them all')

    def _check(self, values: dict[str, Any]) -> None:
        for setting in self.SETTINGS:
            setting.check(values[setting.name])
        self.check(values)

    def _meant(self, given: Parameter) -> Parameter:
        """Return a parameter as a number where it is one as text: that is how ``ros2 param`` hands on 1e-09."""
        # Without a dot that is no number in YAML 1.1; and a list with one in it comes as one text.
        wanted = self.get_parameter_or(given.name).type_
        if given.type_ is Parameter.Type.STRING and wanted in (Parameter.Type.DOUBLE, Parameter.Type.DOUBLE_ARRAY):
            with suppress(ValueError, TypeError, yaml.YAMLError):
                read = yaml.safe_load(given.value)
                number = float(read) if wanted is Parameter.Type.DOUBLE else [float(each) for each in read]
                return Parameter(given.name, value=number)
        return given

    def _on_set(self, changed: Sequence[Parameter]) -> SetParametersResult:
        try:
            self._check(self.settings(changed))
        except PendubotError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)


def help_text(node_class: type[SettingsNode]) -> str:
    """Return what ``--help`` prints: summary, usage, and every parameter with default, unit and range."""
    name, parameters = node_class.PROGRAM, ''
    for s in node_class.SETTINGS:
        parameters += f'  {s.name}, default {s.default!r}{" (left open)" if s.optional else ""}, {s.expected()}\n'
        parameters += textwrap.indent(textwrap.fill(s.description, 94), '      ') + '\n'
    return f"""\
usage: {name} [--help] [--debug] [--ros-args -p NAME:=VALUE ... --params-file FILE]

{textwrap.fill(node_class.SUMMARY, 100)}

parameters:
{parameters}
names of topics and services are relative: -r __ns:=/lab1 puts them and the node under /lab1
commented parameter file: {resource(f'config/{name}.yaml')}

exit status: 0 success or ended by a signal, 1 a failure explained in one line, 2 wrong usage"""


def run(node_class: type[SettingsNode]) -> int:
    """Run a node until a signal or :meth:`SettingsNode.end`; return the exit status.

    The executor spins in a thread of its own, so that a signal reaches the main thread at once and
    :meth:`SettingsNode.close` can still use services and publishers.
    """
    argv = sys.argv
    if '--help' in argv or '-h' in argv:
        print(help_text(node_class))
        return 0
    try:
        own = remove_ros_args(argv)[1:]
        wrong = next((f'unknown argument {a!r}' for a in own if a != '--debug'), '')
    except Exception as error:
        wrong = f'ROS refused the arguments ({str(error).split(", at ")[0]})'
    if wrong:
        print(f'{node_class.PROGRAM}: {wrong}; see --help', file=sys.stderr)
        return 2
    try:
        rclpy.init(args=argv, signal_handler_options=SignalHandlerOptions.NO)
        return _run_until_ended(node_class)
    except Exception as error:
        if '--debug' in own:
            traceback.print_exc()
        known = isinstance(error, PendubotError)
        sentence = str(error) if known else f'{type(error).__name__}: {error}; run again with --debug to see where'
        print(f'{node_class.PROGRAM}: {sentence}', file=sys.stderr)
        return 1
    finally:
        rclpy.try_shutdown()
        ended()


def _run_until_ended(node_class: type[SettingsNode]) -> int:
    ending = Shutdown()
    ending.set_at_signal()
    # In two steps, so that a node that refuses its parameters takes leave: else others go on seeing its services.
    node = node_class.__new__(node_class)
    try:
        node.__init__(ending)  # type: ignore[misc]
    except BaseException:
        with suppress(Exception):
            node.destroy_node()
        raise
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    failures: list[BaseException] = []

    def spin() -> None:
        try:
            executor.spin()
        except ExternalShutdownException:
            pass
        except BaseException as error:
            failures.append(error)
        finally:
            ending.set()

    thread = threading.Thread(target=spin, daemon=True)
    thread.start()
    try:
        ending.wait()
    finally:
        try:
            node.close()
        finally:
            executor.shutdown(timeout_sec=2.0)
            thread.join(2.0)
            node.destroy_node()
    if failures:
        raise failures[0]
    return node.exit_status
