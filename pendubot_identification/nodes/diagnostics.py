# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A status as diagnostic_msgs has it, and its way to /diagnostics."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock
from rclpy.node import Node

from pendubot_identification.level import Level


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


def status_name(node: str) -> str:
    """Return the name of a node's status on /diagnostics, where all rigs are heard, from its fully qualified name.

    It is ``bridge`` where there is no namespace, and ``lab1/bridge`` in ``/lab1``.
    """
    return node.lstrip('/')


class StatusPublisher:
    """Publishes a node's status, or that of a part of it, on /diagnostics."""

    def __init__(self, node: Node, part: str = '', hardware_id: str = '') -> None:
        self._node, self._hardware_id = node, hardware_id
        self._name = status_name(node.get_fully_qualified_name()) + part
        self.publisher = node.create_publisher(DiagnosticArray, '/diagnostics', 10)

    def __call__(self, level: Level, summary: str, values: Mapping[str, Any]) -> None:
        """Publish."""
        stamp = stamp_now(self._node)
        message = diagnostics_message(stamp, self._name, level, summary, values, self._hardware_id)
        self.publisher.publish(message)
