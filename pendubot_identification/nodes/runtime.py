# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The base classes of the nodes: parameters with descriptors, ``--help``, signals, one-line errors, exit status."""

import math
import os
import sys
import textwrap
import threading
import traceback
import warnings
from collections.abc import Awaitable, Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import pairwise
from typing import Any

import rclpy
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.action import ActionServer
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from rclpy.timer import Timer
from rclpy.utilities import remove_ros_args
from std_srvs.srv import Trigger

from pendubot_identification.errors import ParameterError, PendubotError, sentence
from pendubot_identification.files import parameter_names, refuse_untaken
from pendubot_identification.level import Level
from pendubot_identification.resources import resource
from pendubot_identification.setting import Setting, meant
from pendubot_identification.trajectories.conventions import JOINT_NAMES

from .shutdown import Shutdown, at_signal, ignore_signals

#: Setting for the joints that a node reads or publishes.
JOINTS = Setting('joint_names', list(JOINT_NAMES), 'the two joints in joint_states', length=2, distinct=True)
#: Setting of nodes with a lifecycle.
AUTOSTART = Setting('autostart', True, 'whether the node activates itself; otherwise call ros2 lifecycle set')
#: Name of the threads of :meth:`SettingsNode.compute`.
COMPUTATION = 'computation'


def descriptor(setting: Setting) -> ParameterDescriptor:
    """Return the ROS descriptor of a setting: description with unit, and range."""
    result = ParameterDescriptor(name=setting.name, description=setting.help())
    default, low, high = setting.default, setting.minimum, setting.maximum
    if setting.choices or isinstance(default, list):
        result.additional_constraints = setting.expected()
    elif math.isfinite(low) or math.isfinite(high):
        low = min(low, default) if setting.optional else low
        if isinstance(default, int):
            low, high = max(low, -(2**63)), min(high, 2**63 - 1)
            result.integer_range = [IntegerRange(from_value=int(low), to_value=int(high), step=0)]
        else:
            result.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
    return result


@contextmanager
def _refusing(remedy: str) -> Iterator[None]:
    """Convert an error of ROS within the context to a ParameterError that ends with a remedy."""
    try:
        yield
    except (rclpy_implementation.RCLError, rclpy_implementation.UnknownROSArgsError) as error:
        raise ParameterError(f'ROS refused: {str(error).split(", at ")[0]}; {remedy}') from error


def _as_number(parameter: Parameter, setting: Setting | None) -> Parameter:
    """Return a parameter converted to float, if its setting is a float and the value is an integer or a text.

    ``1e-09`` without a dot is no number in YAML 1.1; ``ros2 param`` sets it, and a list with it, as a text.
    """
    value, kind = parameter.value, type(setting.default) if setting else None
    with suppress(ValueError, TypeError):
        if kind is float and type(value) in (int, str):
            return Parameter(parameter.name, value=float(value))
        if kind is list and setting is not None and isinstance(setting.default[0], float):
            parts = value.strip('[]').split(',') if isinstance(value, str) else value
            return Parameter(parameter.name, value=[float(part) for part in parts])
    return parameter


class SettingsNode(Node):
    """A node with a table of :class:`Setting` as parameters and a clean shutdown.

    A subclass overrides :meth:`_check`, :meth:`_open` and :meth:`_close`. ``ended`` requests the end of the program.
    """

    PROGRAM: str
    SUMMARY: str
    SETTINGS: tuple[Setting, ...]

    def __init__(self, ended: Shutdown) -> None:
        try:
            with warnings.catch_warnings(), _refusing('a namespace such as /lab1, without / at its end, is expected'):
                warnings.simplefilter('ignore')  # rclpy also warns of its incomplete node
                super().__init__(self.PROGRAM)
        except ParameterException as error:  # of ROS's own parameters, such as use_sim_time
            raise ParameterError(str(error)) from error
        self.exit_status = 0
        self.ended = ended

    def declare(self) -> None:
        """Declare the parameters.

        Raises:
            ParameterError: a parameter is invalid or unknown, or a parameter file is for other nodes.
        """
        files = [path for option, path in pairwise(sys.argv) if option == '--params-file']
        for path in files:
            refuse_untaken(path, self.get_fully_qualified_name())
        overrides, known = self._parameter_overrides, {setting.name: setting for setting in self.SETTINGS}
        overrides |= {name: _as_number(overrides[name], known[name]) for name in known.keys() & overrides.keys()}
        for name, setting in known.items():
            described = descriptor(setting)
            described.read_only = self._is_read_only(setting)
            try:
                self.declare_parameter(name, setting.default, described)
            except ParameterException as error:
                raise setting.refusal(overrides[name].value) from error
        self._refuse_unknown(files)
        self._refuse_invalid(self.settings())
        self.add_pre_set_parameters_callback(lambda changed: [_as_number(p, known.get(p.name)) for p in changed])
        self.add_on_set_parameters_callback(self._on_set)
        self.add_post_set_parameters_callback(lambda _: self._change(self.settings()))

    def start(self) -> None:
        """Open the node."""
        self._open(self.settings())

    def stop(self) -> None:
        """Close the node, at the end of the program."""
        self._close()

    def settings(self, changed: Sequence[Parameter] = ()) -> dict[str, Any]:
        """Return the value of every setting, with these changes: None if it is left open.

        ROS has no list without elements: empty texts in a list are left out.
        """
        changes = {p.name: p for p in changed}
        values = {}
        for setting in self.SETTINGS:
            value = changes.get(setting.name, self.get_parameter_or(setting.name)).value
            if value is None:  # an empty list, which has no type in ROS
                raise setting.refusal('empty')
            value = setting.of_ros(value)
            if isinstance(value, list):
                value = [entry for entry in value if entry != '']
            if setting.path and value is not None:
                value = [*map(os.path.expanduser, value)] if isinstance(value, list) else os.path.expanduser(value)
            values[setting.name] = value
        return values

    def _is_read_only(self, setting: Setting) -> bool:
        """Return whether a setting takes effect only at the start of the program."""
        return not setting.dynamic

    def _check(self, s: dict[str, Any]) -> None:
        """Raise ParameterError if settings are inconsistent, or not permitted in the present state."""

    def _change(self, s: dict[str, Any]) -> None:
        """Apply changed settings."""

    def _open(self, s: dict[str, Any]) -> None:
        """Open ports, files, topics and services according to the settings."""

    def _close(self) -> None:
        """Close ports, files, topics and services; ROS still works, so that a last command arrives."""

    def create_timer(self, period: float, callback: Callable[[], object]) -> Timer:
        """Call a function every ``period`` [s] of real time, even if use_sim_time is set and /clock stands still."""
        return super().create_timer(period, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def end(self, status: int = 0) -> None:
        """End the program with this exit status, from any thread."""
        self.exit_status = status
        self.ended.set()

    def compute(self, work: Callable[..., None], *args: object) -> threading.Thread:
        """Start a computation in a separate thread, for which the end of the program does not wait."""
        thread = threading.Thread(target=work, args=args, name=COMPUTATION, daemon=True)
        thread.start()
        return thread

    def log(self, level: Level, text: str) -> None:
        """Log a text; rclpy requires that each logging line of code uses one severity."""
        if level is Level.ERROR:
            self.get_logger().error(text)
        elif level is Level.WARN:
            self.get_logger().warning(text)
        else:
            self.get_logger().info(text)

    def _refuse_unknown(self, files: Sequence[str]) -> None:
        """Refuse unknown parameters, and known ones without -p, because a limit would have no effect.

        A section for all nodes may have parameters of the package's other nodes.
        """
        for option, word in pairwise(sys.argv):
            name, assigned, _ = word.partition(':=')
            if assigned and self.has_parameter(name) and option not in ('-p', '--param'):  # to ROS a remapped topic
                raise ParameterError(f'{word} sets no parameter; write --ros-args -p {word}')
        # Topics declare their qos_overrides later.
        names = self._parameter_overrides
        unknown = {name for name in names if not (self.has_parameter(name) or name.startswith('qos_overrides.'))}
        if unknown:
            unknown -= parameter_names(files, '*') & parameter_names(resource('config').glob('*.yaml'))
        for name in sorted(unknown):
            near = meant(name, [setting.name for setting in self.SETTINGS])
            raise ParameterError(f'{self.PROGRAM} has no parameter {name}; {near}? --help lists them all')

    def serve(self, name: str, answer: Callable[[], Awaitable[tuple[bool, str]]]) -> None:
        """Serve a std_srvs/Trigger concurrently, by a coroutine that returns success and message."""

        async def respond(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            response.success, response.message = await answer()
            return response

        self.create_service(Trigger, name, respond, callback_group=ReentrantCallbackGroup())

    def answer(self, future: Future, outcome: object) -> None:
        """Set the result of a future that a coroutine awaits, from any thread."""
        future.set_result(outcome)
        if self.executor is not None:
            self.executor.wake()

    def resolved(self, topics: Sequence[str], *, only_expand: bool = False) -> list[str]:
        """Return full names of topics, remapped unless ``only_expand``; refuse invalid names."""
        with _refusing('name topics such as joint_states'):
            return [self.resolve_topic_name(topic, only_expand=only_expand) for topic in topics]

    def _refuse_invalid(self, values: dict[str, Any]) -> None:
        for setting in self.SETTINGS:
            setting.check(values[setting.name])
        self._check(values)

    def _on_set(self, changed: Sequence[Parameter]) -> SetParametersResult:
        try:
            s = self.settings(changed)
            self._refuse_invalid(s)
        except PendubotError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)


class ManagedNode(LifecycleNodeMixin, SettingsNode):
    """A node with the lifecycle of ROS 2: it is open in the state inactive, and also works in the state active.

    A subclass overrides :meth:`_activate` and :meth:`_deactivate`, too. The parameter ``autostart`` activates it at the
    start.
    """

    def __init__(self, ended: Shutdown) -> None:
        SettingsNode.__init__(self, ended)
        LifecycleNodeMixin.__init__(self)
        self.active = self.opened = False
        self._failure: Exception | None = None
        self._change_state = self._service_change_state.callback
        self._service_change_state.callback = self._on_change_state
        self._permanent = self._entities()

    def _activate(self) -> None:
        """Start working."""

    def _deactivate(self) -> None:
        """Stop working safely, and answer pending requests."""

    def start(self) -> None:
        """Activate the node if ``autostart`` is set; raise the error that prevents it."""
        if not self.settings()[AUTOSTART.name]:
            name = self.get_fully_qualified_name()
            self.get_logger().info(f'waiting: ros2 lifecycle set {name} configure, then activate')
            return
        for transition in (self.trigger_configure, self.trigger_activate):
            if transition() is not TransitionCallbackReturn.SUCCESS and self._failure is not None:
                raise self._failure

    def destroy_node(self) -> None:
        """Destroy the node with its state machine, which rclpy would keep, and with it the node's name in the graph."""
        self._state_machine.destroy_when_not_in_use()
        super().destroy_node()

    def stop(self) -> None:
        """Close the node if it is open."""
        if self.opened:
            self.opened = False
            self._close()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Open the node."""
        answer = self._attempt(lambda: self._open(self.settings()))
        self.opened = answer is TransitionCallbackReturn.SUCCESS
        if not self.opened:
            self._destroy_entities()
        return answer

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start working."""
        answer = self._attempt(self._activate)
        self.active = answer is TransitionCallbackReturn.SUCCESS
        return answer

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop working."""
        try:
            self._deactivate()
        finally:
            self.active = False
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Close the node."""
        self.stop()
        self._destroy_entities()
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End the program."""
        if self.active:
            self.on_deactivate(state)
        self.end()
        return TransitionCallbackReturn.SUCCESS

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End the program with status 1, because a transition failed."""
        self.get_logger().fatal('a transition failed; ending')
        self.end(1)
        return TransitionCallbackReturn.FAILURE

    def _is_read_only(self, setting: Setting) -> bool:
        return setting == AUTOSTART

    def _on_set(self, changed: Sequence[Parameter]) -> SetParametersResult:
        """Refuse changes of settings that are read during configuration, while the node is configured."""
        fixed = {setting.name for setting in self.SETTINGS if not setting.dynamic}
        if self.opened and (names := [each.name for each in changed if each.name in fixed]):
            how = f'ros2 lifecycle set {self.get_fully_qualified_name()} deactivate, then cleanup'
            reason = f'{names[0]} is read when the node is configured; before you set it call {how}'
            return SetParametersResult(successful=False, reason=reason)
        return super()._on_set(changed)

    def _attempt(self, action: Callable[[], None]) -> TransitionCallbackReturn:
        """Execute an action; after a failure the state is unchanged."""
        try:
            action()
        except Exception as error:
            self._failure = error
            if self.executor is not None:  # otherwise it ends the program, which prints the error
                self.get_logger().error(explained(error))
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS

    def _on_change_state(self, request: ChangeState.Request, response: ChangeState.Response) -> ChangeState.Response:
        """Refuse an invalid transition, at which rclpy would end the program, and so disarm a rig."""
        try:
            return self._change_state(request, response)
        except rclpy_implementation.RCLError:
            name = self.get_fully_qualified_name()
            self.get_logger().warning(f'this transition is not possible now; ros2 lifecycle list {name} lists others')
            response.success = False
            return response

    def _entities(self) -> set[tuple[str, Any]]:
        kinds = 'publisher', 'subscription', 'service', 'client', 'timer'
        return {(kind, entity) for kind in kinds for entity in getattr(self, f'{kind}s')}

    def _destroy_entities(self) -> None:
        """Destroy the entities that were created since the construction."""
        for waitable in list(self.waitables):
            if isinstance(waitable, ActionServer):
                waitable.destroy()
        for kind, entity in self._entities() - self._permanent:
            getattr(self, f'destroy_{kind}')(entity)


def help_text(node_class: type[SettingsNode]) -> str:
    """Return the text of ``--help``: summary, usage, and every parameter with default, unit and range."""
    name, parameters = node_class.PROGRAM, ''
    for s in node_class.SETTINGS:
        parameters += f'  {s.name}, default {s.default!r}{" (left open)" if s.optional else ""}, {s.expected()}\n'
        parameters += textwrap.indent(textwrap.fill(s.description, 94), '      ') + '\n'
    return f"""\
usage: {name} [--help] [--debug] [--ros-args -p NAME:=VALUE ... --params-file FILE]

{textwrap.fill(node_class.SUMMARY, 100)}

parameters:
{parameters}
a VALUE is YAML: quote a text that contains a colon, -p "bags:=['swing@0:9']"
names of topics and services are relative: -r __ns:=/lab1 puts them and the node under /lab1
commented parameter file: {resource(f'config/{name}.yaml')}

exit status: 0 success or ended by a signal, 1 a failure explained in one line, 2 wrong usage"""


def explained(error: Exception) -> str:
    """Return the message of an error for the user; with ``--debug`` also print the traceback."""
    if '--debug' in sys.argv:
        traceback.print_exception(error)
    return sentence(error)


def run(node_class: type[SettingsNode]) -> int:
    """Run a node until a signal or :meth:`SettingsNode.end`; return the exit status."""
    if '--help' in sys.argv or '-h' in sys.argv:
        print(help_text(node_class))
        return 0
    try:
        arguments = remove_ros_args(sys.argv)[1:]
        wrong = next((f'unknown argument {a!r}' for a in arguments if a != '--debug'), '')
    except Exception as error:
        wrong = f'ROS refused the arguments ({str(error).split(", at ")[0]})'
    if wrong:
        print(f'{node_class.PROGRAM}: {wrong}; see --help', file=sys.stderr)
        return 2
    ended = Shutdown()
    at_signal(ended.set)
    try:
        with running(node_class, ended) as node:
            ended.wait()
            node.stop()
        status = node.exit_status
    except Exception as error:
        print(f'{node_class.PROGRAM}: {explained(error)}', file=sys.stderr)
        status = 1
    finally:
        ignore_signals()
    if any(thread.name == COMPUTATION for thread in threading.enumerate()):
        # The interpreter's exit would end that thread within C++ code of scipy, which aborts the program.
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)
    return status


@contextmanager
def running(node_class: type[SettingsNode], ended: Shutdown) -> Iterator[SettingsNode]:
    """Start ROS without its signal handlers, and open a node.

    It spins in a separate thread, so that the caller's thread handles signals at once. A failure in a callback ends the
    program and is raised at the end.
    """
    failures: list[BaseException] = []

    def spin() -> None:
        try:
            executor.spin()
        except ExternalShutdownException:
            pass
        except BaseException as error:
            if not ended.is_set():  # not a callback that the shutdown interrupts
                failures.append(error)
        finally:
            ended.set()

    thread = threading.Thread(target=spin, daemon=True)
    try:
        with _refusing('correct the arguments or the environment variables of ROS'):
            rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)
        node, executor = node_class(ended), SingleThreadedExecutor()
        try:
            node.declare()
            node.start()
            executor.add_node(node)
            thread.start()
            yield node
        finally:
            executor.shutdown(timeout_sec=2.0)
            if thread.is_alive():
                thread.join(2.0)
            # Also after invalid parameters, because other programs would otherwise still discover its services.
            node.destroy_node()
    finally:
        rclpy.try_shutdown()
    if failures:
        raise failures[0]
