# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Real recordings in a folder beside the project; tests that need them are marked `recordings`."""

import csv

import numpy as np

from pendubot_identification.recordings.table_reader import TableReader
from pendubot_identification.tracking.events import Start
from pendubot_identification.trajectories.conversion import Conversion
from test.conftest import RECORDINGS

RIGS = 'dfki_C1_sysid', 'dfki_A0_sysid'


def recorded(group, role):
    """Return the recorded motions of a rig, in the order of the manifest."""
    rows = csv.DictReader((RECORDINGS / 'manifest.csv').open())
    files = [row['file'] for row in rows if (row['group'], row['role']) == (group, role)]
    return [TableReader(RECORDINGS / file, Conversion()).motion for file in files]


def concatenated(motions):
    """Return the samples of motions one after the other, with gaps of 1 s, as rows for the tracker."""
    parts, now = [], 0.0
    for motion in motions:
        parts.append(np.column_stack([now + motion.t - motion.t[0], motion.q, motion.tau]))
        now = parts[-1][-1, 0] + 1.0
    return np.concatenate(parts)


def known(estimate):
    """Return the start of tracking from an estimate, as from its result file."""
    return Start(estimate.model, estimate.theta, estimate.std_error, 2 * (estimate.effort.delay,))
