"""What every node shares: parameters with descriptors, ``--help``, signals, one-line errors, exit status."""

from __future__ import annotations

import math
import signal
import sys
import textwrap
import threading
import traceback
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import rclpy
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from pendubot_identification.core.errors import ParameterError, PendubotError


@dataclass(frozen=True)
class Setting:
    """One ROS parameter of a node: name, default (which gives the type), meaning, unit and range.

    A setting that is not ``dynamic`` is read once at the start and refuses to be set later.
    """

    name: str
    default: Any
    description: str
    unit: str = ''
    minimum: float = -math.inf
    maximum: float = math.inf
    choices: tuple[str, ...] = ()
    dynamic: bool = False

    def check(self, value: Any) -> None:
        """Refuse, with a reason, a value outside the range or the choices.

        Raises:
            ParameterError: the value makes no sense.
        """
        if self.choices and value not in self.choices:
            raise ParameterError(f'{self.name} is {value!r}; it must be one of {", ".join(self.choices)}')
        if not isinstance(self.default, str):
            for number in value if isinstance(self.default, list) else [value]:
                if isinstance(number, str):
                    continue
                if not (math.isfinite(number) and self.minimum <= number <= self.maximum):
                    raise ParameterError(f'{self.name} is {number:g}{self._unit()}; {self.range()} is expected')

    def range(self) -> str:
        """Say the range in words."""
        low, high = self.minimum, self.maximum
        if math.isinf(low) and math.isinf(high):
            return 'any finite number'
        if math.isinf(high):
            return f'a number of at least {low:g}'
        return f'at most {high:g}' if math.isinf(low) else f'a number from {low:g} to {high:g}'

    def _unit(self) -> str:
        return f' {self.unit}' if self.unit else ''

    def descriptor(self) -> ParameterDescriptor:
        """Make the ROS descriptor: description with unit, range, and whether it can change."""
        descriptor = ParameterDescriptor(
            name=self.name,
            description=self.description + (f' [{self.unit}]' if self.unit else ''),
            read_only=not self.dynamic,
        )
        if self.choices:
            descriptor.additional_constraints = 'one of ' + ', '.join(self.choices)
        if isinstance(self.default, bool):
            return descriptor
        if isinstance(self.default, int) and not math.isinf(self.minimum + self.maximum):
            descriptor.integer_range = [IntegerRange(from_value=int(self.minimum), to_value=int(self.maximum), step=0)]
        elif isinstance(self.default, float) and not math.isinf(self.minimum + self.maximum):
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=self.minimum, to_value=self.maximum, step=0.0)
            ]
        elif not isinstance(self.default, str):
            descriptor.additional_constraints = self.range()
        return descriptor


class SettingsNode(Node):
    """A node whose parameters are a table of :class:`Setting` and which ends cleanly.

    A subclass states ``PROGRAM``, ``SUMMARY`` and ``SETTINGS``, opens what it needs in ``__init__`` and gives it
    back in :meth:`close`, which runs while ROS still works: commands sent there arrive.
    """

    PROGRAM: str
    SUMMARY: str
    SETTINGS: tuple[Setting, ...]

    def __init__(self) -> None:
        super().__init__(self.PROGRAM)
        self.exit_status = 0
        self.ended = threading.Event()
        for setting in self.SETTINGS:
            try:
                self.declare_parameter(setting.name, setting.default, setting.descriptor())
            except ParameterException as error:
                raise ParameterError(f'{setting.name}: {error}; {setting.range()} is expected') from error
        self._check(self.settings())
        self.add_on_set_parameters_callback(self._on_set)

    def settings(self) -> dict[str, Any]:
        """Return the present value of every setting, arrays as lists."""
        values = {s.name: self.get_parameter(s.name).value for s in self.SETTINGS}
        return {k: list(v) if not isinstance(v, str) and isinstance(v, Iterable) else v for k, v in values.items()}

    def check(self, values: dict[str, Any]) -> None:
        """Refuse settings that make no sense together; a subclass overrides this.

        Raises:
            ParameterError: with the reason.
        """

    def end(self, status: int = 0) -> None:
        """End the program with this exit status, from any thread."""
        self.exit_status = status
        self.ended.set()

    def close(self) -> None:
        """Give back what the node holds; ROS still works. A subclass overrides this."""

    def _check(self, values: dict[str, Any]) -> None:
        for setting in self.SETTINGS:
            setting.check(values[setting.name])
        self.check(values)

    def _on_set(self, changed: Sequence[Parameter]) -> SetParametersResult:
        values = self.settings() | {p.name: p.value for p in changed}
        try:
            self._check(values)
        except PendubotError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)


def help_text(node_class: type[SettingsNode]) -> str:
    """Return what ``--help`` prints: summary, usage, and every parameter with default, unit and range."""
    lines = [
        f'usage: {node_class.PROGRAM} [--help] [--debug] [--ros-args -p NAME:=VALUE ... --params-file FILE]',
        '',
        textwrap.fill(node_class.SUMMARY, 100),
        '',
        'parameters:',
    ]
    for s in node_class.SETTINGS:
        unit = f' [{s.unit}]' if s.unit else ''
        constraint = f'one of {", ".join(s.choices)}' if s.choices else ''
        if not isinstance(s.default, (str, bool, list)) and not math.isinf(max(s.minimum, -s.maximum)):
            constraint = s.range()
        lines.append(f'  {s.name}{unit}, default {s.default!r}' + (f', {constraint}' if constraint else ''))
        lines.append(textwrap.indent(textwrap.fill(s.description, 94), '      '))
    lines += [
        '',
        'exit status: 0 success or ended by a signal, 1 a failure explained in one line, 2 wrong usage',
    ]
    return '\n'.join(lines)


def run(node_class: type[SettingsNode], args: Sequence[str] | None = None) -> int:
    """Run a node until SIGINT, SIGTERM or :meth:`SettingsNode.end`; return the exit status.

    The executor spins in a thread of its own, so that a signal reaches the main thread at once and
    :meth:`SettingsNode.close` can still use services and publishers.
    """
    argv = list(sys.argv if args is None else [node_class.PROGRAM, *args])
    own = remove_ros_args(argv)[1:]
    if '--help' in own or '-h' in own:
        print(help_text(node_class))
        return 0
    if unknown := [a for a in own if a != '--debug']:
        print(f'{node_class.PROGRAM}: unknown argument {unknown[0]!r}; see --help', file=sys.stderr)
        return 2
    node: SettingsNode | None = None
    failure: list[BaseException] = []
    stopped = threading.Event()
    executor: SingleThreadedExecutor | None = None

    def spin() -> None:
        try:
            executor.spin()  # type: ignore[union-attr]
        except ExternalShutdownException:
            pass
        except BaseException as error:
            failure.append(error)
        finally:
            stopped.set()
            if node is not None:
                node.ended.set()

    interrupted = threading.Event()

    def on_signal(*_: object) -> None:
        interrupted.set()
        if node is not None:
            node.ended.set()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, on_signal)
    try:
        try:
            rclpy.init(args=argv, signal_handler_options=SignalHandlerOptions.NO)
        except Exception as error:
            raise ParameterError(f'ROS refused the arguments: {str(error).splitlines()[0]}') from error
        node = node_class()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        threading.Thread(target=spin, daemon=True).start()
        if not interrupted.is_set():
            node.ended.wait()
        if failure:
            raise failure[0]
        return node.exit_status
    except PendubotError as error:
        return _explain(node_class.PROGRAM, str(error), '--debug' in own)
    except Exception as error:
        return _explain(
            node_class.PROGRAM,
            f'{type(error).__name__}: {error}; run again with --debug to see where',
            '--debug' in own,
        )
    finally:
        if node is not None:
            try:
                node.close()
            finally:
                if executor is not None:
                    executor.shutdown(timeout_sec=2.0)
                    stopped.wait(2.0)
                node.destroy_node()
        rclpy.try_shutdown()


def _explain(program: str, sentence: str, debug: bool) -> int:
    if debug:
        traceback.print_exc()
    print(f'{program}: {sentence}', file=sys.stderr)
    return 1
