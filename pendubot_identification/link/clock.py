# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The board's clock mapped to the host's by the smallest delays seen.

A sample's delay (arrival on the host's clock minus sampling on the board's) is a constant offset, plus the drift
between the two clocks, plus transport and scheduling, which are never negative. So the true line lies under all
points (board time, delay), and touches those that were not held up: it is an edge of their lower convex hull.

How uncertain the slope of that edge is shows in how far the points lie above it: microseconds on a quiet machine,
milliseconds on a busy one. The skew is that slope, filtered by a Kalman filter of one state (Kalman 1960): it is found
within seconds on a quiet machine, and once known well it hardly changes during a busy minute.
"""

import math
from collections import deque
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

#: [ns]
MS = 1_000_000
SECOND = 1_000 * MS

#: The board's counter of microseconds begins again here.
WRAP = 1 << 32


@dataclass(frozen=True, slots=True)
class ClockSettings:
    """How far back and how finely delays are compared, and what a crystal can do."""

    window_us: int = 60_000_000  #: How far back delays are remembered [us].
    bucket_us: int = 500_000  #: Only the smallest delay of each stretch of so much board time [us] is remembered.
    finer: int = 4  #: At first, stretches are shorter by this factor, to find the skew soon ...
    growth: int = 16  #: ... and then as long as all before them, over this number.
    fewest: int = 4  #: From fewer stretches, no skew is computed.
    max_slope: float = 100.0  #: A larger slope [ns per us] is clamped: 10 %.
    crystals: float = 1.0  #: Largest difference of two crystals [ns per us]: 0.1 %. A slope is larger ...
    significant: float = 3.0  #: ... only if it is so by this many of its standard deviations.
    usual_skew: float = 0.2  #: Standard deviation of the skew before anything is known [ns per us]: 200 ppm.
    #: Standard deviation of the change of the skew in t us, over sqrt(t): 0.1 ppm in a second.
    wander: float = 1e-4 / 1e3
    #: Standard deviation of the slope of an edge, over (mean height of the points above it / their time).
    uncertainty: float = 2.0
    finest: float = 5_000.0  #: Least mean height of the points above the line [ns].
    accepted_after: int = 3  #: After so many impossible times in a row, the clock has jumped.
    tolerance_us: int = 1000  #: A time may differ from its neighbours by this [us], and by half a sample period.


SETTINGS = ClockSettings()


class _Point(NamedTuple):
    board_us: int
    delay_ns: int


class BoardClock:
    """Maps a board's microsecond counter (u32, wrapping) to host time.

    For each sample :meth:`observe` returns its board time, :meth:`host_time` maps that to the host's clock,
    and :meth:`stamp` makes stamps strictly increase, whatever happens to the mapping.

    Attributes:
        irregular: how many samples carried a time that cannot be true and was replaced.
        jumps: how often the board's clock jumped and went on from there.
        jump_us: by how much the last of these times was off.
    """

    def __init__(self) -> None:
        self._minima: deque[_Point] = deque()
        self._last_stamp: int | None = None
        self.irregular = self.jumps = self.jump_us = 0
        self.restart()

    def restart(self) -> None:
        """Begin anew with the clock of a board that restarted; stamps go on increasing."""
        self._minima.clear()
        self._span_us = 0  # of the present bucket
        self._origin_us: int | None = None
        self._board_us = 0
        self._jumped_us = 0  # by all jumps together
        self._step_us = 0  # from one sample to the next; 0: not known yet
        self._in_a_row = 0  # samples whose time was replaced
        self._rate_error = (0.0, math.inf)  # the slope as measured and its standard deviation
        self._arrival_ns = 0
        self._bucket_end = 0
        self._slope = 0.0  # ns of delay per us of board time; 1e-3 is 1 ppm
        self._variance = SETTINGS.usual_skew**2  # of the slope
        self._intercept = 0.0  # delay [ns] at the board's first sample, where the line is at its lowest

    @property
    def skew_ppm(self) -> float:
        """How much faster the host's clock runs than the board's [ppm]."""
        return self._slope * 1e3

    @property
    def wrong_rate(self) -> float:
        """How much faster the host's clock runs, as a fraction, if that is more than crystals can differ; else 0."""
        slope, error = self._rate_error
        return slope * 1e-3 if abs(slope) - SETTINGS.significant * error > SETTINGS.crystals else 0.0

    def observe(self, t_us: int, arrival_ns: int, frames: int = 1) -> int:
        """Take the arrival [ns, host] of a sample taken at ``t_us``; return its board time [us], not wrapped.

        ``frames`` is how many frames later than the sample before it was sent.
        """
        if self._origin_us is None:
            self._origin_us = board_us = t_us
        else:
            # Of all times that ``t_us`` may stand for, the nearest to what the arrival suggests.
            expected = self._board_us + (arrival_ns - self._arrival_ns) // 1000
            board_us = expected + (t_us - self._jumped_us - expected + WRAP // 2) % WRAP - WRAP // 2
            predicted = self._board_us + self._step_us * frames
            if self._step_us and self._cannot_be(board_us, predicted, arrival_ns):
                self._in_a_row += 1
                if self._in_a_row <= SETTINGS.accepted_after:
                    self.irregular += 1
                    self._board_us, self._arrival_ns = predicted, arrival_ns
                    return predicted
                self.jumps += 1
                self.jump_us = board_us - predicted
                self._jumped_us += self.jump_us
                board_us = predicted
            self._in_a_row = 0
            self._step_us = (board_us - self._board_us) // frames
        delay_ns = arrival_ns - 1000 * board_us
        self._board_us, self._arrival_ns = board_us, arrival_ns
        if not self._minima or board_us >= self._bucket_end:
            while self._minima and self._minima[0].board_us < board_us - SETTINGS.window_us:
                self._minima.popleft()
            seen_us = board_us - self._minima[0].board_us if self._minima else 0
            finest, coarsest = SETTINGS.bucket_us // SETTINGS.finer, SETTINGS.bucket_us
            self._span_us = min(coarsest, max(finest, seen_us // SETTINGS.growth))
            self._bucket_end = board_us + self._span_us
            if len(self._minima) >= SETTINGS.fewest:
                self._follow()
            self._minima.append(_Point(board_us, delay_ns))
            self._intercept = min(self._below(*point) for point in self._minima)
        elif delay_ns < self._minima[-1].delay_ns:
            self._minima[-1] = _Point(board_us, delay_ns)
        self._intercept = min(self._intercept, self._below(board_us, delay_ns))
        return board_us

    def _cannot_be(self, board_us: int, predicted: int, arrival_ns: int) -> bool:
        """Return whether a time is off its neighbours', and before the one before or after the sample's own arrival."""
        tolerance = max(SETTINGS.tolerance_us, self._step_us // 2)
        if abs(board_us - predicted) <= tolerance:
            return False
        return board_us <= self._board_us or self.host_time(board_us) > arrival_ns + 1000 * tolerance

    def host_time(self, board_us: int) -> int:
        """Return the host time [ns] of a board time that :meth:`observe` returned, as far as is known now."""
        return 1000 * board_us + round(self._intercept + self._slope * (board_us - (self._origin_us or 0)))

    def stamp(self, host_time: int) -> int:
        """Return a sample's stamp [ns]: its host time, but above every earlier stamp."""
        if self._last_stamp is not None:
            host_time = max(host_time, self._last_stamp + 1)
        self._last_stamp = host_time
        return host_time

    def _below(self, board_us: int, delay_ns: int) -> float:
        """Return the intercept of a line of the present slope through this point."""
        return delay_ns - self._slope * (board_us - (self._origin_us or 0))

    def _follow(self) -> None:
        """Move the slope, once a bucket, towards that of the hull's edge that spans the middle of the window.

        Of all lines under the points that edge is nearest to them on average.
        """
        minima = self._minima
        seen_us, count = minima[-1].board_us - minima[0].board_us, len(minima)
        middle = (minima[0].board_us + minima[-1].board_us) / 2
        left, right = next(edge for edge in pairwise(_lower_hull(minima)) if edge[1].board_us >= middle)
        slope = (right.delay_ns - left.delay_ns) / (right.board_us - left.board_us)
        above = sum(p.delay_ns - left.delay_ns - slope * (p.board_us - left.board_us) for p in minima)
        # The line goes through two of them.
        error = SETTINGS.uncertainty * max(above / (count - 2), SETTINGS.finest) / seen_us
        self._rate_error = slope, error
        # Most of the window was used in earlier updates: a bucket brings only its share of the information.
        noise = error**2 * seen_us / self._span_us
        self._variance += SETTINGS.wander**2 * self._span_us
        gain = self._variance / (self._variance + noise)
        self._variance *= 1 - gain
        self._slope += gain * (max(-SETTINGS.max_slope, min(SETTINGS.max_slope, slope)) - self._slope)


def _lower_hull(points: deque[_Point]) -> list[_Point]:
    """Return the lower convex hull of points in increasing board time (Andrew's monotone chain)."""
    hull: list[_Point] = []
    for p in points:
        while len(hull) >= 2:
            a, b = hull[-2], hull[-1]
            cross = (b.board_us - a.board_us) * (p.delay_ns - a.delay_ns)
            if cross - (b.delay_ns - a.delay_ns) * (p.board_us - a.board_us) > 0:
                break
            hull.pop()
        hull.append(p)
    return hull
