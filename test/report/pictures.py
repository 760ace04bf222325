# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Pictures of results by name, and recordings for them."""

import functools

import numpy as np

from pendubot_identification.recordings.bag_reader import read_trajectory
from pendubot_identification.report import plots
from pendubot_identification.trajectories.trajectory import Trajectory
from test.identified import SAMPLE, made


def motion(samples=300, interval=0.01, name='swing', start=0.0):
    t = start + np.arange(samples) * interval
    q = np.column_stack([np.sin(t), np.cos(3 * t)])
    return Trajectory(t, q, np.column_stack([np.sign(np.sin(9 * t)), 0 * t]), name=name)


def pictures(result, training, validation=()):
    groups = plots.Prepared.of(result, training, validation).pictures()
    return {picture.name: picture for _, draw in groups for picture in draw()}


@functools.cache
def swing():
    return read_trajectory(SAMPLE).trajectory


@functools.cache
def every_picture():
    """Return the pictures of a result by MDE with its recordings."""
    result = made(optimizer='mde', criteria=('energy',))
    return list(pictures(result, [swing()[:400]], [swing()[400:800]]).values())
