# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The messages of the nodes: parameters, joint states, and diagnostics with their way to /diagnostics."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from numpy.typing import NDArray
from rclpy.clock import Clock
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension

from pendubot_identification.errors import ControlError
from pendubot_identification.level import Level
from pendubot_identification.model.parameters import NAMES

#: A subscriber that joins later still receives the last message.
LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def parameters_message(theta: NDArray[np.float64]) -> Float64MultiArray:
    """Return a parameter vector, shape (D,), as a message; ``layout.dim[0].label`` names its entries, ``P1,P2,...``."""
    names = ','.join(NAMES[: len(theta)])
    message = Float64MultiArray(data=theta.tolist())
    message.layout.dim = [MultiArrayDimension(label=names, size=len(theta), stride=len(theta))]
    return message


def joint_sample(m: JointState, names: Sequence[str]) -> tuple[float, tuple[float, float], float]:
    """Return when a sample was taken [s], shoulder's and elbow's position [rad], and the shoulder's effort [N m].

    Raises:
        ControlError: it lacks one of these.
    """
    try:
        shoulder, elbow = (list(m.name).index(name) for name in names)
        q, effort = (m.position[shoulder], m.position[elbow]), m.effort[shoulder]
    except (ValueError, IndexError):
        raise ControlError(
            f'joint_states has {list(m.name)}; positions of {list(names)} and the effort of the first are expected: '
            'look at joint_names'
        ) from None
    return m.header.stamp.sec + m.header.stamp.nanosec * 1e-9, q, effort


def diagnostics_message(
    stamp: Time, name: str, level: Level, summary: str, values: Mapping[str, Any], hardware_id: str = ''
) -> DiagnosticArray:
    """Return one status with its values by name; numbers keep their full precision."""
    pairs = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
    status = DiagnosticStatus(level=bytes([level]), name=name, message=summary, hardware_id=hardware_id, values=pairs)
    message = DiagnosticArray(status=[status])
    message.header.stamp = stamp
    return message


def stamp_now(node: Node) -> Time:
    """Return ROS time; the system's where use_sim_time is set and nobody has published on /clock yet."""
    now = node.get_clock().now()
    return (now if now.nanoseconds else Clock().now()).to_msg()


class Status:
    """The status of a node, or of a part of it, on /diagnostics: once a second the ``diagnosis`` at the moment.

    Its name is ``bridge`` for /bridge and ``lab1/bridge`` for /lab1/bridge, because all rigs share the topic.
    """

    def __init__(
        self, node: Node, diagnosis: Callable[[], tuple[Level, str, Mapping[str, Any]]], part: str = '', rig: str = ''
    ) -> None:
        self._node, self._rig = node, rig
        self._name = node.get_fully_qualified_name().lstrip('/') + part
        self.publisher = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
        node.create_timer(1.0, lambda: self.publish(*diagnosis()))

    def publish(self, level: Level, summary: str, values: Mapping[str, Any]) -> None:
        """Publish a diagnosis."""
        stamp = stamp_now(self._node)
        self.publisher.publish(diagnostics_message(stamp, self._name, level, summary, values, self._rig))


class Identification:
    """Publishes parameters, latched, on pendubot/params and their quality on pendubot/identification."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._params = node.create_publisher(Float64MultiArray, 'pendubot/params', LATCHED)
        self._quality = node.create_publisher(DiagnosticArray, 'pendubot/identification', LATCHED)

    def publish(
        self, level: Level, summary: str, values: Mapping[str, Any], theta: NDArray[np.float64] | None = None
    ) -> None:
        """Publish the quality first, so that whoever receives the parameters, if any, can already know it."""
        stamp = stamp_now(self._node)
        self._quality.publish(diagnostics_message(stamp, 'pendubot identification', level, summary, values))
        if theta is not None:
            self._params.publish(parameters_message(theta))


def parameter_values(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Return parameters of a result under the names ``P1``, ``P1.std_error``, ``P1.unit`` and so on."""
    return {name.removesuffix('.value'): value for name, value in flat('', parameters).items()}


def flat(name: str, entry: Any) -> dict[str, Any]:
    """Return the entries of nested mappings and lists under flat names, such as ``J.training`` or ``bags.0.bag``.

    Values of single runs are left out; lists of numbers stay lists.
    """
    if isinstance(entry, Mapping):
        inner = [(key, value) for key, value in entry.items() if not key.endswith('_runs')]
    elif isinstance(entry, list) and any(isinstance(each, (Mapping, str)) for each in entry):
        inner = list(enumerate(entry))
    else:
        return {name: entry}
    return {k: v for key, value in inner for k, v in flat(f'{name}.{key}'.lstrip('.'), value).items()}
