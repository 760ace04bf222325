# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Effort commands, each with its publisher: of several publishers one at a time is obeyed."""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rclpy.waitable import NumberOfEntities, Waitable
from std_msgs.msg import Float64

from .driving import UNKNOWN, full_name
from .topics import Fetched

#: How often it is looked, while a publisher is refused, whether the one that drives is still there [ns].
LOOK_PERIOD = 50_000_000


class _MessageInfo(ctypes.Structure):
    """``rmw_message_info_t`` of Jazzy, with room to spare. A publisher's gid is as in ``TopicEndpointInfo``."""

    _fields_ = (
        ('source_timestamp', ctypes.c_int64),
        ('received_timestamp', ctypes.c_int64),
        ('publication_sequence_number', ctypes.c_uint64),
        ('reception_sequence_number', ctypes.c_uint64),
        ('implementation_identifier', ctypes.c_char_p),
        ('publisher_gid', ctypes.c_uint8 * 16),
        ('rest', ctypes.c_uint8 * 64),
    )


class EffortCommands(Waitable):
    """A subscription that obeys one publisher at a time.

    Who commands first drives, until it is silent for ``timeout`` [s] or gone; what others command meanwhile is refused,
    and counted in ``refused``. ``obey`` is called with each torque [N m] that is not refused. rclpy says from which
    publisher a message is only from Kilted on. So messages are taken by rcl itself, which knows.
    """

    def __init__(self, node: Node, timeout: float, obey: Callable[[float], None]) -> None:
        super().__init__(node.default_callback_group)
        self.refused = 0
        self._node, self._timeout, self._obey = node, round(timeout * 1e9), obey
        # Waited for here, not by the executor.
        self._subscription = node.create_subscription(
            Float64, 'pendubot/effort_command', lambda _: None, 1, callback_group=Fetched()
        )
        self._take = ctypes.CDLL('librcl.so').rcl_take
        self._take.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p]
        self._torque, self._info = ctypes.c_double(), _MessageInfo()
        self._index = 0
        self._driver, self._driven = b'', -self._timeout
        self._conflict, self._refused_at, self._looked = (b'', b''), 0, 0
        self._names: dict[bytes, str] = {}
        node.add_waitable(self)

    def conflict(self) -> str:
        """Return in a sentence who was refused last, and who drives."""
        driver, other = (self._names.get(gid, '') for gid in self._conflict)
        if other and other == driver:
            other = f'another {other}'
        unknown = 'a node of unknown name'
        return f'effort commands of {other or unknown} are refused, for {driver or unknown} drives; end one'

    def contested(self) -> bool:
        """Tell whether more than one publisher commands at present."""
        return bool(self.refused) and time.monotonic_ns() - self._refused_at < self._timeout

    def _is_driver(self, publisher: bytes, now: int) -> bool:
        """Tell whether a publisher drives, or does so from now on; else it is refused."""
        if publisher != self._driver and now - self._driven < self._timeout and not self._has_left(now):
            self.refused += 1
            self._conflict, self._refused_at = (self._driver, publisher), now
            return False
        self._driver, self._driven = publisher, now
        return True

    def _has_left(self, now: int) -> bool:
        """Tell whether the publisher that drives is gone, as one that was killed is only after a while."""
        if now - self._looked < LOOK_PERIOD:
            return False
        self._looked = now
        there = self._node.get_publishers_info_by_topic(self._subscription.topic_name)
        self._names |= {bytes(each.endpoint_gid): full_name(each) for each in there if each.node_name != UNKNOWN}
        return all(bytes(each.endpoint_gid) != self._driver for each in there)

    # What the executor calls

    def __enter__(self) -> None:
        self._subscription.handle.__enter__()

    def __exit__(self, *error: object) -> None:
        self._subscription.handle.__exit__(*error)

    def get_num_entities(self) -> NumberOfEntities:
        """Return that it is one subscription."""
        return NumberOfEntities(num_subs=1)

    def add_to_wait_set(self, wait_set: Any) -> None:
        """Have the executor wait for a message."""
        self._index = wait_set.add_subscription(self._subscription.handle)

    def is_ready(self, wait_set: Any) -> bool:
        """Tell whether one has come."""
        return wait_set.is_ready('subscription', self._index)

    def take_data(self) -> tuple[float, bytes] | None:
        """Return a message's torque [N m] and its publisher's gid; None where none has come after all."""
        torque, info = ctypes.byref(self._torque), ctypes.byref(self._info)
        if self._take(self._subscription.handle.pointer, torque, info, None):
            return None
        return self._torque.value, bytes(self._info.publisher_gid)

    async def execute(self, taken: tuple[float, bytes] | None) -> None:
        """Obey, or refuse."""
        if taken is not None and self._is_driver(taken[1], time.monotonic_ns()):
            self._obey(taken[0])
