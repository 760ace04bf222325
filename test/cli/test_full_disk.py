# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Bags written by the command line to a file system that is full: whole or not at all, and one sentence."""

import os
import subprocess
import sys

import numpy as np
import pytest

from pendubot_identification.recordings.bag_reader import read_trajectory
from pendubot_identification.recordings.joint_states import write_trajectory
from pendubot_identification.trajectories.trajectory import Trajectory

from ..processes import MODULES

SAMPLES = 5000
#: What shows a disk of its own to a program, and to nobody else, as long as that runs.
ALONE = ('unshare', '--user', '--map-root-user', '--mount')


@pytest.fixture
def on_full_disk(tmp_path):
    """Run ``pendubot`` where a disk of some size is mounted; return the ended process and what was left there."""
    if subprocess.run([*ALONE, 'mount', '-t', 'tmpfs', 'tmpfs', str(tmp_path)], capture_output=True).returncode:
        pytest.skip('no disk of its own can be mounted here')
    disk, left = tmp_path / 'disk', tmp_path / 'left'
    disk.mkdir()

    def run(size, *arguments, before=':'):
        mount = f'mount -t tmpfs -o size={size} tmpfs {disk}'
        script = f'{mount} && {before} && "$@"; status=$?; cp -r {disk} {left}; exit $status'
        command = [*ALONE, 'sh', '-c', script, 'sh', sys.executable, '-m', MODULES['pendubot'], *map(str, arguments)]
        return subprocess.run(command, capture_output=True, text=True, timeout=120), left

    run.disk = disk
    return run


@pytest.fixture
def recorded(tmp_path):
    """A motion, as CSV and as a bag."""
    t = np.arange(SAMPLES) * 0.01
    q = np.column_stack([np.sin(t), np.cos(t)])
    np.savetxt(
        tmp_path / 'run.csv', np.column_stack([t, q, q[:, :1]]), delimiter=',', header='t,q1,q2,tau1', comments=''
    )
    write_trajectory(tmp_path / 'bag', Trajectory(t, q, q))
    return tmp_path


def commands(folder, output):
    return {
        'import-csv': ['import-csv', folder / 'run.csv', '--output', output],
        'simulate': ['simulate', '--samples', SAMPLES, '--output', output],
        'repair': ['repair', folder / 'bag', '--output', output],
    }


@pytest.mark.parametrize(('command', 'size'), [('import-csv', '16k'), ('simulate', '200k'), ('repair', '800k')])
def test_nothing_partial_is_left_where_a_disk_is_full(recorded, on_full_disk, command, size):
    """Of nearly a megabyte that it takes."""
    ended, left = on_full_disk(size, *commands(recorded, on_full_disk.disk / 'new')[command])
    assert (ended.returncode, ended.stdout) == (1, '')
    assert f'{on_full_disk.disk}/new is not written: ' in ended.stderr
    assert len(ended.stderr.splitlines()) == 1
    assert list(left.iterdir()) == []


@pytest.mark.parametrize(('size', 'status', 'samples'), [('1500k', 1, SAMPLES), ('4M', 0, 1800)])
def test_what_would_have_been_replaced_is_still_there_unless_there_is_room(
    recorded, on_full_disk, size, status, samples
):
    arguments = ('simulate', '--samples', SAMPLES if status else 1800, '--output', on_full_disk.disk / 'bag', '--force')
    ended, left = on_full_disk(size, *arguments, before=f'cp -r {recorded}/bag {on_full_disk.disk}')
    assert ended.returncode == status, ended.stderr
    assert os.listdir(left) == ['bag']
    recording = read_trajectory(left / 'bag')
    assert (recording.closed, len(recording.trajectory)) == (True, samples)
