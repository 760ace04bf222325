# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A serialised JointState of two joints and the motor current in which only the numbers change.

To serialise a message object at every publishing costs more than all other work on a sample.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from pendubot_identification.model.dynamics import Pair
from pendubot_identification.trajectories.conventions import current_name

_STAMP = struct.Struct('=iI')
_PAIR = struct.Struct('=dd')
_EFFORTS = struct.Struct('=ddd')
_SECOND = 1_000_000_000


class JointStateBytes:
    """The message that is published as joint_states.

    Its entries are the shoulder and the elbow, of the given names, and ``<shoulder>_current``. The last one has the
    measured motor current [A] as its effort; its position and velocity are 0.
    """

    def __init__(self, joint_names: Sequence[str]) -> None:
        stamp, q, qd, effort = (0x1234567, 0x2345678), (1.25e-300, 2.25e-300), (3.25e-300, 4.25e-300), (5.25e-300, 0.0)
        names = [*joint_names, current_name(joint_names[0])]
        message = JointState(name=names, position=[*q, 0.0], velocity=[*qd, 0.0], effort=[*effort, 0.0])
        message.header.stamp.sec, message.header.stamp.nanosec = stamp
        self._data = bytearray(serialize_message(message))
        # The middleware itself shows where the numbers are.
        self._stamp = self._data.index(_STAMP.pack(*stamp))
        self._q, self._qd, self._effort = (self._data.index(_PAIR.pack(*pair)) for pair in (q, qd, effort))

    def fill(self, stamp_ns: int, q: Pair, qd: Pair, effort: float, current: float) -> bytes:
        """Return the message of a sample: time since the epoch [ns], positions [rad], velocities [rad/s], shoulder's
        commanded torque as the board reports it [N m], and motor current [A].
        """
        data = self._data
        _STAMP.pack_into(data, self._stamp, *divmod(stamp_ns, _SECOND))
        _PAIR.pack_into(data, self._q, *q)
        _PAIR.pack_into(data, self._qd, *qd)
        _EFFORTS.pack_into(data, self._effort, effort, 0.0, current)
        return bytes(data)
