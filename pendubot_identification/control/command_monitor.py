# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What becomes of commanded torques: how late they are applied, and whether they are at all."""

from __future__ import annotations

from collections import deque

#: Torques [N m] that the board tells as one: it counts in micro-N m.
SAME = 2e-6
#: The longest transport that is looked for [samples].
LONGEST = 10
#: Of so many unambiguous samples, nearly all must say so, before another transport is believed.
EVIDENCE, AGREEMENT = 40, 0.8
#: Without any torque of its own for so long [s] the controller is not obeyed.
DISOBEDIENCE = 0.1


class CommandMonitor:
    """Compares the efforts that come with samples with the torques that were commanded.

    Args:
        transport: what to believe at first [samples].
        period: between samples [s].

    Attributes:
        transport: so many samples after the one from which it was computed a torque is applied.
    """

    def __init__(self, transport: int, period: float) -> None:
        self.transport = transport
        self._patience = max(LONGEST + 1, round(DISOBEDIENCE / period))
        self._commands: deque[float] = deque(maxlen=self._patience)
        self._seen: deque[int] = deque(maxlen=EVIDENCE)
        self._strange = 0

    def command(self, torque: float) -> None:
        """Note a torque [N m] that was computed from the last sample."""
        self._commands.append(torque)

    def obeyed(self, effort: float) -> bool:
        """Take the effort of a sample [N m]; return whether the commands arrive at all."""
        matches = [j for j, torque in enumerate(reversed(self._commands), 1) if abs(torque - effort) <= SAME]
        self._strange = 0 if matches or not self._commands else self._strange + 1
        if len(matches) == 1 and matches[0] <= LONGEST:
            self._seen.append(matches[0])
            most = max(set(self._seen), key=self._seen.count)
            if len(self._seen) == EVIDENCE and self._seen.count(most) >= AGREEMENT * EVIDENCE:
                self.transport = most
        return self._strange < self._patience
