# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Prints the state of a running rig for the studio, as 20 JSON lines a second on stdout. It only subscribes.

Each line has the newest sample (``t`` [s], ``q`` [rad], ``effort`` [N m], ``rate`` [Hz]; absent if it is too old),
the ``parameters`` with 95 % half-widths, and ``level`` and ``message`` of the identification.
"""

import json
import math
import time
from collections import deque
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_sensor_data
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from pendubot_identification.errors import ControlError, sentence
from pendubot_identification.level import Level, number
from pendubot_identification.trajectories.conventions import JOINT_NAMES

from .messages import LATCHED, joint_sample
from .shutdown import Shutdown, at_signal

#: Rate of the lines [Hz], and largest age of the newest sample of a running rig [s].
RATE, STALE = 20.0, 1.0


class Watcher(Node):
    """Subscribes to the topics of a rig; it has no publisher, no service and no client."""

    def __init__(self) -> None:
        no_service = [Parameter('start_type_description_service', value=False)]
        super().__init__('watcher', enable_rosout=False, start_parameter_services=False, parameter_overrides=no_service)
        # Its parameters never change.
        self.destroy_publisher(self._parameter_event_publisher)
        self._sample: tuple[float, tuple[float, float], float] | None = None
        self._arrivals = deque[float](maxlen=50)
        self._problem = ''
        self._theta: dict[str, float] = {}
        self._status: Any = None
        self.create_subscription(JointState, 'joint_states', self._on_sample, qos_profile_sensor_data)
        self.create_subscription(Float64MultiArray, 'pendubot/params', self._on_parameters, LATCHED)
        self.create_subscription(DiagnosticArray, 'pendubot/identification', self._on_quality, LATCHED)

    def _on_sample(self, message: JointState) -> None:
        names = JOINT_NAMES if set(JOINT_NAMES) <= set(message.name) else list(message.name)[:2]
        try:
            self._sample, self._problem = joint_sample(message, names), ''
        except (ControlError, ValueError) as error:
            self._problem = str(error)
        self._arrivals.append(time.monotonic())

    def _on_parameters(self, message: Float64MultiArray) -> None:
        label = message.layout.dim[0].label if message.layout.dim else ''
        self._theta = dict(zip(label.split(','), message.data, strict=False))

    def _on_quality(self, message: DiagnosticArray) -> None:
        self._status = message.status[0] if message.status else None

    def line(self) -> dict[str, Any]:
        """Return the present state of the rig."""
        state: dict[str, Any] = {'parameters': self._named(), 'level': '', 'message': self._problem}
        if self._status is not None:
            level = Level(min(2, self._status.level[0])).name
            state |= {'level': level, 'message': self._problem or self._status.message}
        if self._sample is not None and time.monotonic() - self._arrivals[-1] < STALE:
            t, q, effort = self._sample
            duration = self._arrivals[-1] - self._arrivals[0]
            rate = (len(self._arrivals) - 1) / duration if duration else 0.0
            if all(map(math.isfinite, (*q, effort))):
                state |= {'t': t, 'q': q, 'effort': effort, 'rate': rate}
        return state

    def _named(self) -> list[dict[str, Any]]:
        values = {pair.key: pair.value for pair in self._status.values} if self._status is not None else {}
        entries = []
        for name, value in self._theta.items():
            high = values.get(f'{name}.interval', '').strip('()').split(',')[-1]  # of '(None, None)' if it is unknown
            reach = number(high) - value
            half = reach if math.isfinite(reach) else None
            if math.isfinite(value):
                entries.append({'name': name, 'value': value, 'half': half, 'unit': values.get(f'{name}.unit')})
        return entries


def main() -> int:
    """Print the state until a signal, or until the reader closes the pipe; return the exit status."""
    ended = Shutdown()
    rclpy.init(args=['--ros-args', '--enclave', '/pendubot/watcher'], signal_handler_options=SignalHandlerOptions.NO)
    try:
        at_signal(ended.set)
        node = Watcher()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        due = time.monotonic()
        while not ended.is_set():
            executor.spin_once(max(0.0, due - time.monotonic()))
            if time.monotonic() >= due:
                due = max(due + 1 / RATE, time.monotonic())
                print(json.dumps(node.line()), flush=True)
    except BrokenPipeError:
        pass
    except Exception as error:
        print(json.dumps({'problem': {'sentence': sentence(error)}}), flush=True)
        return 1
    finally:
        rclpy.try_shutdown()
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
