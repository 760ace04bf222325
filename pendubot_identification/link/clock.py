# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Maps the board's clock to the host's clock by the smallest transport delays.

A sample's delay is its arrival on the host's clock minus its sampling time on the board's clock. It is the sum of a
constant offset, the drift between the clocks, and transport and scheduling delays, which are never negative. So the
true line lies below all points (board time, delay) and is an edge of their lower convex hull.

The mean height of the points above that edge determines the standard deviation of its slope. It is microseconds on a
quiet machine and milliseconds on a busy one. A Kalman filter of one state (Kalman 1960) estimates the skew from the
slopes: it converges within seconds on a quiet machine, and then changes little during a busy minute.
"""

import math
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

#: [ns]
MS = 1_000_000
SECOND = 1_000 * MS

#: The board's microsecond counter wraps at this value.
WRAP = 1 << 32


@dataclass(frozen=True, slots=True)
class ClockSettings:
    """Window, resolution and noise model of the clock estimate."""

    window_us: int = 60_000_000  #: Length of the window of delays [us].
    bucket_us: int = 500_000  #: Longest bucket [us of board time]; only the smallest delay in a bucket is kept.
    finer: int = 4  #: The first buckets are shorter by this factor, so that the first skew comes early.
    growth: int = 16  #: Later buckets have the length of the window so far divided by this number.
    fewest: int = 4  #: Smallest number of buckets for a skew, and for the smallest delay.
    max_slope: float = 100.0  #: A larger slope [ns per us] is clamped: 10 %.
    crystals: float = 1.0  #: Largest difference between two crystals [ns per us]: 0.1 %.
    significant: float = 3.0  #: The skew exceeds ``crystals`` only by more than this many standard deviations.
    usual_skew: float = 0.2  #: Initial standard deviation of the skew [ns per us]: 200 ppm.
    #: Random walk of the skew: standard deviation after t us, divided by sqrt(t): 0.1 ppm in a second.
    wander: float = 1e-4 / 1e3
    #: Standard deviation of an edge's slope, divided by (mean height of the points above it / time span).
    uncertainty: float = 2.0
    finest: float = 5_000.0  #: Lower bound of the mean height of the points above the edge [ns].
    accepted_after: int = 3  #: Number of consecutive implausible times that are replaced; one more is a clock jump.
    tolerance_us: int = 1000  #: Tolerance of a time against the predicted time [us]; at least half a sample period.


SETTINGS = ClockSettings()


class _Point(NamedTuple):
    board_us: int
    delay_ns: int


class BoardClock:
    """Maps a board's microsecond counter (u32, wrapping) to host time.

    For each sample :meth:`observe` returns its board time, :meth:`host_time` maps that time to the host's clock,
    and :meth:`stamp` returns strictly increasing stamps, even if the mapping changes.

    A board that restarted needs a new object; with ``last_stamp`` [ns] of the former its stamps increase, too.

    Attributes:
        irregular: whether the last sample had an implausible time, which was replaced by the predicted time.
        jump_us: size of a jump of the board's clock at the last sample [us]; 0: none.
    """

    def __init__(self, last_stamp: int = 0) -> None:
        self.last_stamp = last_stamp
        self.irregular, self.jump_us = False, 0
        self._minima: deque[_Point] = deque()
        self._span_us = 0  # of the present bucket
        self._origin_us: int | None = None
        self._board_us = 0
        self._jumped_us = 0  # sum of all jumps
        self._step_us = 0  # from one sample to the next; 0: not known yet
        self._in_a_row = 0  # consecutive samples with a replaced time
        self._edge = 0.0  # the newest measured slope
        self._arrival_ns = 0
        self._bucket_end = 0
        self._slope = 0.0  # ns of delay per us of board time; 1e-3 is 1 ppm
        self._variance = SETTINGS.usual_skew**2  # of the slope
        self._intercept = 0.0  # delay [ns] of the line at the board's first sample

    @property
    def skew_ppm(self) -> float:
        """Skew of the host's clock relative to the board's clock [ppm]; positive if the host's clock is faster."""
        return self._slope * 1e3

    @property
    def wrong_rate(self) -> float:
        """Skew of the host's clock as a fraction if it exceeds the tolerance of crystals, else 0."""
        # The filter's prior is a crystal: few or late samples do not contradict it.
        error = SETTINGS.significant * math.sqrt(self._variance)
        return self._edge * 1e-3 if abs(self._slope) - error > SETTINGS.crystals else 0.0

    def observe(self, t_us: int, arrival_ns: int, frames: int = 1) -> int:
        """Update the estimate with a sample; return its board time [us], not wrapped.

        Args:
            t_us: wrapped sampling time on the board's clock [us].
            arrival_ns: arrival on the host's clock [ns].
            frames: number of frames since the previous sample.
        """
        self.irregular, self.jump_us = False, 0
        if self._origin_us is None:
            self._origin_us = board_us = t_us
        else:
            # Unwrap: take the candidate nearest to the time expected from the arrival.
            expected = self._board_us + (arrival_ns - self._arrival_ns) // 1000
            board_us = expected + (t_us - self._jumped_us - expected + WRAP // 2) % WRAP - WRAP // 2
            predicted = self._board_us + self._step_us * frames
            if self._step_us and self._cannot_be(board_us, predicted, arrival_ns):
                self._in_a_row += 1
                if self._in_a_row <= SETTINGS.accepted_after:
                    self.irregular = True
                    self._board_us, self._arrival_ns = predicted, arrival_ns
                    return predicted
                self.jump_us = board_us - predicted
                self._jumped_us += self.jump_us
                board_us = predicted
            self._in_a_row = 0
            self._step_us = (board_us - self._board_us) // frames
        delay_ns = arrival_ns - 1000 * board_us
        self._board_us, self._arrival_ns = board_us, arrival_ns
        if not self._minima or board_us >= self._bucket_end:
            if self._minima and self._minima[-1].board_us * 1000 + self._minima[-1].delay_ns == arrival_ns:
                self._minima.pop()  # read together with this sample, so that its delay was longer
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
        """Return whether a time deviates from the prediction, and precedes the previous time or follows the arrival."""
        tolerance = max(SETTINGS.tolerance_us, self._step_us // 2)
        if abs(board_us - predicted) <= tolerance:
            return False
        # The first delays may all be long, so that a later sample seems to come from the future.
        early = len(self._minima) < SETTINGS.fewest
        return board_us <= self._board_us or (not early and self.host_time(board_us) > arrival_ns + 1000 * tolerance)

    def host_time(self, board_us: int) -> int:
        """Return the present estimate of the host time [ns] of a board time that :meth:`observe` returned."""
        return 1000 * board_us + round(self._intercept + self._slope * (board_us - (self._origin_us or 0)))

    def stamp(self, host_time: int) -> int:
        """Return a sample's stamp [ns]: its host time, or 1 ns after the last stamp if that is later."""
        self.last_stamp = max(host_time, self.last_stamp + 1)
        return self.last_stamp

    def _below(self, board_us: int, delay_ns: int) -> float:
        """Return the intercept of a line of the present slope through this point."""
        return delay_ns - self._slope * (board_us - (self._origin_us or 0))

    def _follow(self) -> None:
        """Update the slope once per bucket with the hull's edge that spans the middle of the window.

        Among all lines below the points, this edge has the smallest mean distance to them. Among all lines through a
        point before and a point after the middle, it is the lowest line at the middle.
        """
        board_us, delay_ns = np.array(self._minima).T - np.array([self._minima[0]]).T
        seen_us = int(board_us[-1])
        before = 2 * board_us < seen_us
        slopes = (delay_ns[~before] - delay_ns[before, None]) / (board_us[~before] - board_us[before, None])
        at_middle = delay_ns[before, None] + slopes * (seen_us / 2 - board_us[before, None])
        slope, height = float(slopes.flat[at_middle.argmin()]), at_middle.min()
        above = float((delay_ns - height - slope * (board_us - seen_us / 2)).sum())
        # Two of the points lie on the line.
        error = SETTINGS.uncertainty * max(above / (len(board_us) - 2), SETTINGS.finest) / seen_us
        self._edge = slope
        # Earlier updates used most of the window: one bucket adds only its fraction of the information.
        noise = error**2 * seen_us / self._span_us
        self._variance += SETTINGS.wander**2 * self._span_us
        gain = self._variance / (self._variance + noise)
        self._variance *= 1 - gain
        self._slope += gain * (max(-SETTINGS.max_slope, min(SETTINGS.max_slope, slope)) - self._slope)
