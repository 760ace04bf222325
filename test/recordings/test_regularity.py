# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pendubot_identification.recordings.regularity import regularity

MS = 1_000_000


@given(st.integers(1, 50), st.sets(st.integers(1, 198), max_size=60), st.integers(0, 2**62))
def test_removed_samples_are_counted_as_missing(period, taken, start):
    times = start + period * MS * np.array([k for k in range(200) if k not in taken], dtype=np.int64)
    found = regularity(times)
    # Only as long as most intervals are whole is it known what is usual.
    assert found.period == period / 1e3
    assert found.missing == len(taken)
    assert (found.gaps > 0) == bool(taken)
    assert (found.repeated, found.backwards) == (0, 0)
    if taken:
        assert found.first_gap == (min(taken) - 1) * period / 1e3


def test_jitter_is_the_99_percent_quantile():
    intervals = np.full(1000, 10 * MS)
    intervals[::10] += MS
    intervals[500] += 2 * MS
    found = regularity(np.cumsum(intervals))
    assert (found.period, found.jitter, found.longest, found.gaps) == (0.01, 0.001, 0.013, 0)


def test_few_messages_have_no_median_interval():
    for n in range(5):
        found = regularity(np.arange(n, dtype=np.int64))
        assert np.isnan(found.period)
        assert (found.gaps, found.missing) == (0, 0)
