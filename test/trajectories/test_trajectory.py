# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

import numpy as np
import pytest

from pendubot_identification.errors import TrajectoryError
from pendubot_identification.trajectories.trajectory import Trajectory


def motion(t=None, n=100, **changes):
    t = np.arange(n) * 0.01 if t is None else np.asarray(t, dtype=float)
    values = {'q': np.zeros((len(t), 2)), 'tau': np.zeros((len(t), 2)), 'name': 'swing'} | changes
    return Trajectory(t, **values)


def test_a_window_is_half_open_and_in_seconds_from_the_first_sample():
    part = motion(t=5 + np.arange(100) * 0.01).window(0.1, 0.2)
    np.testing.assert_allclose(part.t, 5.1 + np.arange(10) * 0.01)


UNKNOWN = np.where(np.arange(200).reshape(100, 2) == 61, np.nan, 0.0)


@pytest.mark.parametrize(
    ('changes', 'sentence'),
    [
        ({'t': 4 + np.arange(100) * 0.01, 'q': UNKNOWN}, 'the first at 4.300 s'),
        ({'t': [0, 1, 1, 2]}, 'sample 2 repeats'),
        ({'t': [0, 1, 0.5, 2]}, r'sample 2 runs backwards by 0.5 s'),
        ({'q': np.zeros((99, 2))}, r'q has shape \(99, 2\)'),
        ({'t': [0, np.inf]}, 'a stamp is not a finite number'),
        *(
            ({name: UNKNOWN}, f'a {name} that is not a finite number, the first at 0.300 s')
            for name in ('q', 'tau', 'qd')
        ),
    ],
)
def test_invalid_samples_are_refused(changes, sentence):
    with pytest.raises(TrajectoryError, match=sentence):
        motion(**changes)
