# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""ROS time that nobody sets: the system's as it was at the start, carried on by the monotonic clock."""

from __future__ import annotations

import time

#: The system's clock was set if it is off by more than this [s].
TOLERANCE = 0.05


class SteadyTime:
    """Turns times of the monotonic clock into ROS time; no time server makes what is stamped with it jump."""

    def __init__(self) -> None:
        self._epoch_ns = time.time_ns() - time.monotonic_ns()

    def ros_time(self, monotonic_ns: int) -> int:
        """Return the ROS time [ns] of a time of the monotonic clock [ns]."""
        return monotonic_ns + self._epoch_ns

    def set_by(self) -> float:
        """Return by how much [s] the system's clock was set since; 0 where it was not."""
        seconds = (time.time_ns() - time.monotonic_ns() - self._epoch_ns) / 1e9
        return seconds if abs(seconds) > TOLERANCE else 0.0
