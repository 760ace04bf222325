# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Encoder counts to joint positions and velocities; samples that no motor can reach are refused."""

from __future__ import annotations

import math
from collections import deque

from pendubot_identification.level import Level
from pendubot_identification.model.dynamics import Pair

from .events import Counters, Events, Recurring

#: Velocity is the difference to the oldest sample of this last stretch of board time [us], or to the one before
#: where samples are further apart: a noise of one count in 10 ms, a lag of 5 ms.
VELOCITY_WINDOW_US = 10_000

#: After so many implausible samples in a row the new position is believed.
BELIEVED_AFTER = 5


class Joints:
    """Follows both joints, sample by sample.

    Args:
        sign: +1 or -1 for each joint.
        zero: position [rad] of each joint at count 0.
        max_speed: a sample that would need a higher speed [rad/s] is flagged.
        events: where a position that is believed after flagged samples is reported.
        counters: where flagged samples and such positions are counted.
    """

    def __init__(self, sign: Pair, zero: Pair, max_speed: float, events: Events, counters: Counters) -> None:
        self._sign = sign
        self._zero = zero
        self._max_speed = max_speed
        self._events = events
        self._counters = counters
        self._jump = Recurring()
        self.restart()

    def restart(self) -> None:
        """Begin anew: the next sample is believed wherever it is."""
        self._history: deque[tuple[int, Pair]] = deque()
        self._in_doubt = 0

    def update(
        self, board_us: int, counts: tuple[int, int], counts_per_turn: tuple[int, int], now: int
    ) -> tuple[Pair, Pair] | None:
        """Take a sample of board time [us] at ``now`` [ns].

        Returns:
            Positions [rad] and velocities [rad/s], 0 where no sample came before; None where the sample is flagged.
        """
        q1 = self._sign[0] * math.tau / counts_per_turn[0] * counts[0] + self._zero[0]
        q2 = self._sign[1] * math.tau / counts_per_turn[1] * counts[1] + self._zero[1]
        history = self._history
        if history:
            before_us, before = history[-1]
            reach = self._max_speed * (board_us - before_us) * 1e-6
            if abs(q1 - before[0]) > reach or abs(q2 - before[1]) > reach:
                self._doubt(board_us, (q1, q2), now)
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
        return (q1, q2), qd

    def _doubt(self, board_us: int, q: Pair, now: int) -> None:
        self._counters.flagged += 1
        self._in_doubt += 1
        if self._in_doubt < BELIEVED_AFTER:
            return
        self._counters.jumps += 1
        self.restart()
        self._history.append((board_us, q))
        if self._jump.is_new(now):
            self._events.report(
                Level.WARN,
                f'{BELIEVED_AFTER} samples in a row would have needed more than {self._max_speed:g} rad/s: the new '
                'place is believed; check the encoders',
            )
