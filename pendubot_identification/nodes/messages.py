# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The messages of the nodes: joint states, parameters with their quality, and status messages on /diagnostics."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension

from pendubot_identification.arrays import Array
from pendubot_identification.errors import ControlError, ParameterError
from pendubot_identification.level import Level
from pendubot_identification.model.dynamics import Pair
from pendubot_identification.model.parameters import NAMES

#: Quality of service with which a later subscriber still receives the last message.
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def shoulder_effort(m: JointState, shoulder: str) -> float:
    """Return the shoulder's effort [N m] in a joint command.

    ros2_control names all joints, but lists only the efforts of joints with an effort command interface. So a single
    effort belongs to the shoulder; otherwise every name needs an effort.

    Raises:
        ParameterError: the shoulder has no effort, or a joint without a motor has an effort.
    """
    names, efforts = list(m.name), list(m.effort)
    if shoulder not in names or not efforts or len(efforts) not in (1, len(names)):
        raise ParameterError(
            f'it has {len(efforts)} efforts for the joints {", ".join(names) or "none"}; the effort of {shoulder} is '
            'expected: give only that joint an effort command interface'
        )
    by_name = dict(zip([shoulder] if len(efforts) == 1 else names, efforts, strict=True))
    if others := [name for name, effort in by_name.items() if name != shoulder and effort and not math.isnan(effort)]:
        raise ParameterError(
            f'it has an effort for {", ".join(others)}, and only {shoulder} has a motor; remove the effort command '
            'interface of the other joint'
        )
    return by_name[shoulder]


def joint_sample(m: JointState, names: Sequence[str]) -> tuple[float, Pair, float]:
    """Return the stamp of a sample [s], the positions of shoulder and elbow [rad], and the shoulder's effort [N m].

    Raises:
        ControlError: a position or the effort is missing.
    """
    try:
        shoulder, elbow = (list(m.name).index(name) for name in names)
        q, effort = (m.position[shoulder], m.position[elbow]), m.effort[shoulder]
    except (ValueError, IndexError):
        raise ControlError(
            f'joint_states has {list(m.name)}; positions of {list(names)} and the effort of the first are expected: '
            'check joint_names'
        ) from None
    return m.header.stamp.sec + m.header.stamp.nanosec * 1e-9, q, effort


def parameters_message(theta: Array) -> Float64MultiArray:
    """Return a parameter vector, shape (D,), as a message; ``layout.dim[0].label`` names its entries, ``P1,P2,...``."""
    names = ','.join(NAMES[: len(theta)])
    message = Float64MultiArray(data=theta.tolist())
    message.layout.dim = [MultiArrayDimension(label=names, size=len(theta), stride=len(theta))]
    return message


def status_message(
    node: Node, name: str, level: Level, summary: str, values: Mapping[str, Any], rig: str = ''
) -> DiagnosticArray:
    """Return a status message with values by name, in full precision, stamped with ROS time.

    The stamp is the system time while use_sim_time is set and /clock has no message yet.
    """
    pairs = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
    status = DiagnosticStatus(level=bytes([level]), name=name, message=summary, hardware_id=rig, values=pairs)
    message = DiagnosticArray(status=[status])
    now = node.get_clock().now()
    message.header.stamp = (now if now.nanoseconds else Clock().now()).to_msg()
    return message


class Status:
    """Publishes the present ``diagnosis`` of a node, or of a ``part`` of it, on /diagnostics once a second.

    The status name is ``bridge`` for /bridge and ``lab1/bridge`` for /lab1/bridge, because all rigs share the topic.
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
        summary = summary if getattr(self._node, 'active', True) else f'inactive; {summary}'
        self.publisher.publish(status_message(self._node, self._name, level, summary, values, self._rig))


class Identification:
    """Publishes parameters on pendubot/params and their quality on pendubot/identification, both latched."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._params = node.create_publisher(Float64MultiArray, 'pendubot/params', LATCHED)
        self._quality = node.create_publisher(DiagnosticArray, 'pendubot/identification', LATCHED)

    def publish(self, level: Level, summary: str, values: Mapping[str, Any], theta: Array | None = None) -> None:
        """Publish the quality, and then the parameters, if any, so that their receiver already has the quality."""
        self._quality.publish(status_message(self._node, 'pendubot identification', level, summary, values))
        if theta is not None:
            self._params.publish(parameters_message(theta))


def parameter_values(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Return the parameters of a result under the names ``P1``, ``P1.std_error``, ``P1.unit`` and so on."""
    return {name.removesuffix('.value'): value for name, value in flat('', parameters).items()}


def flat(name: str, entry: Any) -> dict[str, Any]:
    """Return the entries of nested mappings and lists under flat names, such as ``J.training`` or ``bags.0.bag``.

    Values of single runs are left out; lists of numbers stay lists.
    """
    if isinstance(entry, Mapping):
        inner = [(key, value) for key, value in entry.items() if not key.endswith('_runs')]
    elif isinstance(entry, (list, tuple)) and any(isinstance(each, (Mapping, str)) for each in entry):
        inner = list(enumerate(entry))
    else:
        return {name: entry}
    return {k: v for key, value in inner for k, v in flat(f'{name}.{key}'.lstrip('.'), value).items()}
