# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pendubot_identification.level import Level
from pendubot_identification.recordings.flow import Flow, diagnose


def flow_of(numbers, lag_ns=0, publishers=1):
    flow = Flow()
    for number in numbers:
        flow.add(number, lag_ns, publishers)
    return flow


@given(st.sets(st.integers(2, 300)), st.integers(1, 10_000))
def test_missing_sequence_numbers_of_one_publisher_are_counted_as_lost(dropped, first):
    # The last message arrives; losses after it are not detectable.
    flow = flow_of(first + k for k in range(1, 302) if k not in dropped)
    assert (flow.count, flow.lost) == (301 - len(dropped), len(dropped))


@pytest.mark.parametrize(
    ('numbers', 'publishers', 'lost'),
    [((1, 2, 3, 1, 2, 4), 1, 1), ((None, None), 1, 0), ((1, 40, 2, 41, 7), 2, 0)],
    ids=['restarted', 'without numbers', 'several publishers'],
)
def test_losses_of_restarted_unnumbered_and_several_publishers_are_not_overestimated(numbers, publishers, lost):
    assert flow_of(numbers, publishers=publishers).lost == lost


@pytest.mark.parametrize(
    ('flow', 'free', 'sentence'),
    [
        (flow_of([1]), 10**12, 'recording'),
        (flow_of([1, 5], lag_ns=2_500_000_000), 10**12, '/x: 3 messages lost; /x: written 2.5 s late'),
        (Flow(), 150_000_000, '/x: nothing yet; 150 MB left on the disk; the bag is closed at 100'),
    ],
)
def test_losses_delays_and_a_full_disk_are_warnings(flow, free, sentence):
    diagnosis = diagnose({'/x': flow}, 1.0, troubles=(), free=free, reserve=10**8)
    assert (diagnosis.level, diagnosis.message) == (Level.WARN if ';' in sentence else Level.OK, sentence)
    assert {'/x messages', '/x rate [Hz]', '/x lag [s]', '/x lost', 'free [MB]'} <= diagnosis.values.keys()
