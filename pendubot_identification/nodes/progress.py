# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""How far long work in a node has come: log lines at a decent rate, and a status on /diagnostics once a second."""

from __future__ import annotations

import math
import time
from typing import NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from pendubot_identification.level import Level

from .diagnostics import diagnostics_message, stamp_now, status_name

#: Between two log lines of one step [s]; the beginning of a step is said at once.
LOG_PERIOD = 5.0
#: Between two messages on /diagnostics [s].
PERIOD = 1.0


class _State(NamedTuple):
    """Replaced as a whole, so that the timer's thread never sees half of it."""

    level: Level
    summary: str
    values: dict[str, object]


class NodeProgress:
    """What a node is doing: called from the thread that works, published by the node's own.

    Args:
        node: that works.
        idle: what it says before there is anything to do.
    """

    def __init__(self, node: Node, idle: str) -> None:
        self._node = node
        self._name = f'{status_name(node.get_fully_qualified_name())}: progress'
        self._state = _State(Level.OK, idle, {})
        self._step, self._step_began, self._logged = '', 0.0, 0.0
        self._publisher = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
        node.create_timer(PERIOD, self._publish)

    def __call__(self, what: str, done: int, of: int, best: float) -> None:
        """Take what is being done, how much of it is done, of how much (0: not known), and the best J or NaN."""
        now = time.monotonic()
        begins = what != self._step
        if begins:
            self._step, self._step_began = what, now
        values: dict[str, object] = {'step': what, 'done': done, 'of': of or 'not known'}
        if not math.isnan(best):
            values['J'] = best
        if of and done:
            values['seconds_left'] = round((now - self._step_began) * (of - done) / done, 1)
        summary = what + (f', {done} of {of}' if of else '') + ('' if math.isnan(best) else f', J = {best:.4e}')
        self._state = _State(Level.OK, summary, values)
        if begins or now - self._logged >= LOG_PERIOD:
            self._logged = now
            self._node.get_logger().info(summary)

    def ended(self, level: Level, summary: str) -> None:
        """Say how the work ended; the next call begins anew."""
        self._step = ''
        self._state = _State(level, summary, {})

    def _publish(self) -> None:
        self._publisher.publish(diagnostics_message(stamp_now(self._node), self._name, *self._state))
