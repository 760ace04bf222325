"""Encoder counts to joint positions and velocities, and the refusal of places that no motor can reach."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

Pair = tuple[float, float]

#: Velocity is the difference to the oldest sample of this last stretch of board time [us], or to the one before
#: where samples are further apart: a noise of one count in 10 ms, a lag of 5 ms.
VELOCITY_WINDOW_US = 10_000

#: So many implausible samples in a row are no glitch: the joint is there.
BELIEVED_AFTER = 5


class Motion(NamedTuple):
    """Positions [rad] and velocities [rad/s] of both joints; velocity is 0 where no sample came before."""

    q: Pair
    qd: Pair


class Joints:
    """Follows both joints, sample by sample.

    Args:
        sign: +1 or -1 for each joint.
        zero: position [rad] of each joint at count 0.
        max_speed: what moves faster than this [rad/s] is flagged.

    Attributes:
        flagged: samples that were not believed.
        jumps: how often a new place was believed after :data:`BELIEVED_AFTER` such samples in a row.
    """

    def __init__(self, sign: Pair, zero: Pair, max_speed: float) -> None:
        self._sign = sign
        self._zero = zero
        self._max_speed = max_speed
        self.flagged = 0
        self.jumps = 0
        self.restart()

    def restart(self) -> None:
        """Begin anew: the next sample is believed wherever it is."""
        self._history: deque[tuple[int, Pair]] = deque()
        self._in_doubt = 0

    def update(self, board_us: int, counts: tuple[int, int], cpr: tuple[int, int]) -> Motion | None:
        """Take a sample at a board time [us]; return the motion, or None where it is flagged."""
        q1 = self._sign[0] * math.tau / cpr[0] * counts[0] + self._zero[0]
        q2 = self._sign[1] * math.tau / cpr[1] * counts[1] + self._zero[1]
        history = self._history
        if history:
            before_us, before = history[-1]
            reach = self._max_speed * (board_us - before_us) * 1e-6
            if abs(q1 - before[0]) > reach or abs(q2 - before[1]) > reach:
                self._doubt(board_us, (q1, q2))
                return None
        self._in_doubt = 0
        while len(history) > 1 and history[0][0] < board_us - VELOCITY_WINDOW_US:
            history.popleft()
        qd = (0.0, 0.0)
        if history and board_us > history[0][0]:
            then_us, then = history[0]
            elapsed = (board_us - then_us) * 1e-6
            qd = ((q1 - then[0]) / elapsed, (q2 - then[1]) / elapsed)
        history.append((board_us, (q1, q2)))
        return Motion((q1, q2), qd)

    def _doubt(self, board_us: int, q: Pair) -> None:
        self.flagged += 1
        self._in_doubt += 1
        if self._in_doubt >= BELIEVED_AFTER:
            self.jumps += 1
            self.restart()
            self._history.append((board_us, q))
