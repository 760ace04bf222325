# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The age of a command by its publisher's timestamp, whatever the publisher's clock says."""

from __future__ import annotations

import math

#: The least delay is taken over this period and the one before it [ns]: a clock that was set counts for no longer.
PERIOD = 5_000_000_000


class CommandAge:
    """Estimates the age of commands from when they were sent and when they were taken.

    The difference of these two times is the offset between two clocks plus a latency, which is never negative. Its
    minimum over the last commands is therefore the offset plus the least latency, and the age is what exceeds it.
    """

    def __init__(self) -> None:
        self._least = self._least_before = math.inf
        self._since = 0

    def measure(self, sent_ns: int, taken_ns: int) -> float:
        """Return the age [s] of a command; each time [ns] is that of its own program's clock."""
        delay = taken_ns - sent_ns
        if not 0 <= taken_ns - self._since < PERIOD:
            self._least_before, self._least, self._since = self._least, delay, taken_ns
        self._least = min(self._least, delay)
        return (delay - min(self._least, self._least_before)) * 1e-9
