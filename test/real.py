# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The real recordings that lie beside the project, if they do; a test that needs them is marked `recordings`."""

import csv

from pendubot_identification.recordings.table_reader import TableReader
from pendubot_identification.trajectories.reading import Reading
from test.conftest import RECORDINGS


def recorded(group, role):
    """Return the motions of a rig's recordings, in the manifest's order."""
    rows = csv.DictReader((RECORDINGS / 'manifest.csv').open())
    files = [row['file'] for row in rows if (row['group'], row['role']) == (group, role)]
    return [TableReader(RECORDINGS / file, Reading()).motion for file in files]
