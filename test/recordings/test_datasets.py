# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Windows of recordings, and messages about windows without data."""

import numpy as np
import pytest

from pendubot_identification import api
from pendubot_identification.errors import PendubotError
from pendubot_identification.recordings.datasets import load_datasets
from pendubot_identification.recordings.joint_states import write_trajectory
from pendubot_identification.trajectories.trajectory import Trajectory
from test.virtual import recording


def write(path, motion):
    """Write a bag, or a table if the path has a suffix."""
    if path.suffix:
        rows = np.column_stack([motion.t, motion.q, motion.tau[:, 0]])
        np.savetxt(path, rows, delimiter=',', header='t,q1,q2,tau1', comments='')
    else:
        write_trajectory(path, motion)


@pytest.fixture(scope='module')
def recordings(tmp_path_factory):
    """Return a folder with the same 12 s as a bag and as a table."""
    folder = tmp_path_factory.mktemp('recordings')
    t = np.arange(1200) * 0.01
    motion = Trajectory(t, np.column_stack([np.sin(t), np.cos(t)]), np.column_stack([np.sin(3 * t), 0 * t]))
    for name in ('bag', 'file.csv'):
        write(folder / name, motion)
    return folder


@pytest.mark.parametrize('name', ['bag', 'file.csv'])
def test_a_window_beyond_the_end_is_reported_with_both_times(recordings, name):
    path = recordings / name
    data = load_datasets([f'{path}@0:50'])
    (note,) = data.notes
    assert not any(load_datasets([f'{path}{window}']).notes for window in ('', '@:', '@2:', '@0:12'))
    assert note.startswith(f'{path}@0:50 ends at 50 s, but its last sample is at 11.990 s')
    assert [len(motion) for motion in data.training] == [1200]
    with pytest.warns(match='@0:50 ends at 50 s, but its last sample is at 11'):
        assert len(api.read(f'{path}@0:50')) == 1200
    for window, refused in (
        ('13:50', r'holds no sample; choose a time within the 11\.99. s'),
        ('1:1.3', '30 samples .* too few'),
    ):
        with pytest.raises(PendubotError, match=f'@{window}:? {refused}'):
            load_datasets([f'{path}@{window}'])


@pytest.mark.parametrize('name', ['bag', 'file.csv'])
def test_times_in_messages_count_from_the_first_sample_of_the_file(tmp_path, name):
    """The gap is in the validation part or in a window."""
    motion = recording(1200)
    write(tmp_path / name, motion[(motion.t < 9.0) | (motion.t > 9.9)])
    for window in ('', '@2:'):
        with pytest.raises(PendubotError, match=r'0\.920 s without a sample begin at 8\.990 s'):
            api.identify(f'{tmp_path / name}{window}', criterion='weak')
