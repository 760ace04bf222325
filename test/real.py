# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The real recordings beside the project; tests that need them have the mark `recordings`."""

import csv

import numpy as np

from pendubot_identification.recordings.table_reader import TableReader
from pendubot_identification.tracking.events import Start
from pendubot_identification.trajectories.conversion import Conversion
from test.conftest import RECORDINGS

RIGS = 'dfki_C1_sysid', 'dfki_A0_sysid'


def recorded(group, role):
    """Return the motions of a rig's recordings, in the manifest's order."""
    rows = csv.DictReader((RECORDINGS / 'manifest.csv').open())
    files = [row['file'] for row in rows if (row['group'], row['role']) == (group, role)]
    return [TableReader(RECORDINGS / file, Conversion()).motion for file in files]


def strung(motions):
    """Return the samples of consecutive motions, with gaps of a second, as rows for the tracker."""
    joined, now = [], 0.0
    for motion in motions:
        joined.append(np.column_stack([now + motion.t - motion.t[0], motion.q, motion.tau]))
        now = joined[-1][-1, 0] + 1.0
    return np.concatenate(joined)


def known(estimate):
    """Return a start from an estimate, as from its file."""
    return Start(estimate.model, estimate.theta, estimate.std_error, 2 * (estimate.effort.delay,))
