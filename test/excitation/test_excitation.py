# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pendubot_identification.excitation.excitation import PulseTrain

times = st.lists(st.integers(-200, 5000).map(lambda k: k * 0.01), min_size=1, max_size=60)


@given(times, st.floats(0.02, 3.0), st.floats(0.01, 1.0), st.floats(0.001, 2.0), st.integers(0, 5))
def test_many_torques_at_once_are_those_one_by_one(t, period, width, hold, seed):
    train = PulseTrain(period, width, -0.5, 1.0, hold, seed)
    np.testing.assert_array_equal(train.torques(np.array(t)), [train.torque(each) for each in t])
