# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Windows of a recording: each that is not what the user asked for is named in one sentence."""

import numpy as np
import pytest

from pendubot_identification import api
from pendubot_identification.errors import PendubotError
from pendubot_identification.recordings.datasets import load_datasets
from pendubot_identification.recordings.joint_states import write_trajectory
from pendubot_identification.trajectories.trajectory import Trajectory


@pytest.fixture(scope='module')
def recordings(tmp_path_factory):
    """The same 12 s as a bag and as a file with columns."""
    folder = tmp_path_factory.mktemp('recordings')
    t = np.arange(1200) * 0.01
    motion = Trajectory(t, np.column_stack([np.sin(t), np.cos(t)]), np.column_stack([np.sin(3 * t), 0 * t]))
    write_trajectory(folder / 'bag', motion)
    rows = np.column_stack([motion.t, motion.q, motion.tau[:, 0]])
    np.savetxt(folder / 'file.csv', rows, delimiter=',', header='t,q1,q2,tau1', comments='')
    return folder


@pytest.mark.parametrize('name', ['bag', 'file.csv'])
def test_a_window_beyond_the_end_is_named_with_both_times(recordings, name):
    path = recordings / name
    data = load_datasets([f'{path}@0:50'])
    (note,) = data.notes
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


@pytest.mark.parametrize('window', ['', '@:', '@0:', '@2:', '@0:6', '@6:12', '@0:12'])
def test_a_window_within_the_recording_has_no_note(recordings, window):
    assert load_datasets([f'{recordings / "bag"}{window}']).notes == ()
