# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The samples of a recording of any length as they come, good and bad, for who follows a rig."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.errors import BagError
from pendubot_identification.trajectories.conversion import Conversion

from .bag_reader import BagWindow, Reader, Stream
from .table_reader import TableReader

Array = NDArray[np.float64]

#: Rows of a file with columns that are given at once.
PART = 5000


def stream_samples(
    reader: Reader, window: BagWindow, topic: str, joint_names: Sequence[str], conversion: Conversion
) -> Iterator[Array]:
    """Return rows of t [s] from the recording's first sample, q1, q2 [rad], tau1, tau2 [N m], some thousands at a time.

    Of a bag all samples come as they are: not finite, late, or out of order. A file with columns is held.

    Raises:
        BagError: the bag, the topic or a joint is not there; the window cannot be found in it.
        TableError: a file with columns cannot be read, or lacks one.
    """
    if isinstance(reader, TableReader):
        motion = window.of(reader.motion)
        whole = np.column_stack([motion.t, motion.q, motion.tau])
        yield from (whole[k : k + PART] for k in range(0, len(whole), PART))
        return
    efforts = conversion.effort_names(joint_names)
    stream = Stream(reader, topic, joint_names, window.start, window.end, effort_names=efforts)
    Q, c, T, d = conversion.affine
    for elapsed_ns, values in stream:
        yield np.column_stack([elapsed_ns / 1e9, values[:, 0] @ Q.T + c, values[:, 1] @ T.T + d])
    if stream.missed():
        raise BagError(f'{window}: its stamps are of another clock than its log times; follow the whole bag')
