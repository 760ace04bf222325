# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Converts encoder counts to joint positions and velocities, and rejects samples with implausible speeds."""

import math
from collections import deque

from pendubot_identification.level import Level
from pendubot_identification.model.dynamics import Pair

from .events import HostConfig, Output

#: Window of the velocity's backward difference [us of board time]; at longer sample periods, one period. Its
#: resolution is one count in 10 ms, its lag 5 ms.
VELOCITY_WINDOW_US = 10_000
#: Number of consecutive implausible samples after which the new position is accepted.
ACCEPTED_AFTER = 5


class Joints:
    """Computes the motion of both joints; ``q`` are the last positions [rad], None before the first sample."""

    def __init__(self, config: HostConfig, output: Output) -> None:
        self._config = config
        self._output = output
        self._history: deque[tuple[int, Pair]] = deque()
        self.q: Pair | None = None
        self._flagged = 0

    def update(
        self, board_us: int, counts: tuple[int, int], counts_per_turn: tuple[int, int], now: int
    ) -> tuple[Pair, Pair] | None:
        """Convert a sample at board time ``board_us`` [us] that arrived at ``now`` [ns].

        Returns:
            Positions [rad] and velocities [rad/s], 0 at the first sample; None if the sample is flagged.
        """
        sign, zero = self._config.sign, self._config.zero
        q1 = sign[0] * math.tau / counts_per_turn[0] * counts[0] + zero[0]
        q2 = sign[1] * math.tau / counts_per_turn[1] * counts[1] + zero[1]
        history = self._history
        if history:
            before_us, before = history[-1]
            reach = self._config.max_speed * (board_us - before_us) * 1e-6
            if abs(q1 - before[0]) > reach or abs(q2 - before[1]) > reach:
                self._flag(board_us, (q1, q2), now)
                return None
        self._flagged = 0
        while len(history) > 1 and history[0][0] < board_us - VELOCITY_WINDOW_US:
            history.popleft()
        qd = (0.0, 0.0)
        if history and board_us > history[0][0]:
            then_us, then = history[0]
            elapsed = (board_us - then_us) * 1e-6
            qd = ((q1 - then[0]) / elapsed, (q2 - then[1]) / elapsed)
        self.q = q1, q2
        history.append((board_us, self.q))
        return (q1, q2), qd

    def _flag(self, board_us: int, q: Pair, now: int) -> None:
        self._output.counters.flagged += 1
        self._flagged += 1
        if self._flagged < ACCEPTED_AFTER:
            return
        self._output.counters.jumps += 1
        self._history, self._flagged = deque([(board_us, q)]), 0
        text = f'{ACCEPTED_AFTER} samples in a row imply more than {self._config.max_speed:g} rad/s'
        text += ': the new position is accepted; check the encoders'
        self._output.report_new('jump', now, Level.WARN, text)
