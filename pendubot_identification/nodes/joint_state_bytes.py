# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A serialised JointState of two joints in which only the numbers change.

A message object is turned into bytes anew at every publishing, which costs more than all the rest of a sample's way.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

_STAMP = struct.Struct('=iI')
_PAIR = struct.Struct('=dd')
_SECOND = 1_000_000_000


class JointStateBytes:
    """What is published as joint_states, for two joints of these names."""

    def __init__(self, names: Sequence[str]) -> None:
        stamp, q, qd, effort = (0x1234567, 0x2345678), (1.25e-300, 2.25e-300), (3.25e-300, 4.25e-300), (5.25e-300, 0.0)
        message = JointState(name=list(names), position=q, velocity=qd, effort=effort)
        message.header.stamp.sec, message.header.stamp.nanosec = stamp
        self._data = bytearray(serialize_message(message))
        # Where the numbers are, the middleware itself says.
        self._stamp = self._data.index(_STAMP.pack(*stamp))
        self._q, self._qd, self._effort = (self._data.index(_PAIR.pack(*pair)) for pair in (q, qd, effort))

    def fill(self, stamp_ns: int, q: tuple[float, float], qd: tuple[float, float], effort: float) -> bytes:
        """Return the message with this stamp [ns], positions [rad], velocities [rad/s], shoulder effort [N m]."""
        data = self._data
        _STAMP.pack_into(data, self._stamp, *divmod(stamp_ns, _SECOND))
        _PAIR.pack_into(data, self._q, *q)
        _PAIR.pack_into(data, self._qd, *qd)
        _PAIR.pack_into(data, self._effort, effort, 0.0)
        return bytes(data)
