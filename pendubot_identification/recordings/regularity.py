# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The regularity of times: rate, jitter, gaps, and stamps that repeat or run back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

#: A gap is longer than this many median intervals.
GAP = 1.5

#: Fewest intervals for a median.
MINIMUM_INTERVALS = 10


@dataclass(frozen=True, slots=True)
class Regularity:
    """The regularity of a series of times; of too few times, period, jitter and first gap are NaN."""

    period: float  #: the median interval [s]
    jitter: float  #: the 99 % quantile of the deviation of intervals from it [s]
    longest: float  #: interval [s]; 0 where there is none
    gaps: int  #: intervals longer than 1.5 periods
    missing: int  #: samples that would fill the gaps
    first_gap: float  #: start of the first gap, from the first time on [s]; NaN without a gap
    repeated: int  #: times equal to the one before
    backwards: int  #: times earlier than the one before


def regularity(times_ns: NDArray[np.int64]) -> Regularity:
    """Return the regularity of times in the order of arrival [ns], shape (N,)."""
    steps = np.diff(times_ns)
    repeated, backwards = int((steps == 0).sum()), int((steps < 0).sum())
    # A time that runs back does not shorten the next gap.
    ahead = np.maximum.accumulate(times_ns)
    ahead = ahead[np.diff(ahead, prepend=ahead[:1] - 1) > 0]
    intervals = np.diff(ahead)
    longest = float(intervals.max(initial=0)) / 1e9
    if len(intervals) < MINIMUM_INTERVALS:
        return Regularity(np.nan, np.nan, longest, 0, 0, np.nan, repeated, backwards)
    period = float(np.median(intervals))
    late = np.flatnonzero(intervals > GAP * period)
    return Regularity(
        period=period / 1e9,
        jitter=float(np.quantile(np.abs(intervals - period), 0.99)) / 1e9,
        longest=longest,
        gaps=len(late),
        missing=int(np.rint(intervals[late] / period - 1).sum()),
        first_gap=float(ahead[late[0]] - ahead[0]) / 1e9 if len(late) else np.nan,
        repeated=repeated,
        backwards=backwards,
    )
