# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Reads all of a bag: times, stamps and numbers of its messages, and damaged parts."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .mcap_file import FIELDS, Damage, McapFile

#: Encapsulation, and the stamp with which a header begins.
STAMP = np.dtype([('', 'V4'), ('sec', '<i4'), ('nanosec', '<u4')])
#: A definition whose first field is a header; comments and constants hold no bytes.
HEADER = re.compile(rb'(?:[^\S\n]*(?:#.*|[^#\n]*=.*)?\n)*[^\S\n]*(?:std_msgs/(?:msg/)?)?Header\s')


class TopicTimes(NamedTuple):
    """The intact messages of a topic, in the order of writing.

    Attributes:
        logged: log times [ns since the epoch], shape (N,).
        stamps: their ``header.stamp`` [ns], shape (N,), or (0,) where not every message has one.
        lost: number of missing messages, by the recorder's numbers.
    """

    logged: NDArray[np.int64]
    stamps: NDArray[np.int64]
    lost: int


def survey(files: Sequence[McapFile]) -> tuple[dict[str, TopicTimes], dict[str, list[Damage]]]:
    """Return the intact messages by topic, and the damages by name of the file.

    Raises:
        OSError: a file cannot be read.
    """
    damages: dict[str, list[Damage]] = {file.path.name: [] for file in files}
    nothing = np.empty(0, np.int64)
    columns = {name: ([nothing], [nothing], [nothing]) for file in files for name in file.topics}
    for file in files:
        for part in file.intact_parts(damages[file.path.name]):
            channels = part.messages.heads['channel']
            for number in file.channels.keys() & set(channels.tolist()):
                messages, channel = part.messages.part(channels == number), file.channels[number]
                logged, stamps, numbers = columns[channel.topic]
                logged.append(messages.heads['logged'])
                numbers.append(messages.heads['sequence'])
                schema = file.schemas.get(channel.schema_id)
                stamped = schema is not None and schema.encoding == 'ros2msg' and HEADER.match(schema.data)
                if stamped and (messages.heads['length'] >= FIELDS + STAMP.itemsize).all():
                    stamp = messages.contents(STAMP)
                    stamps.append(stamp['sec'].astype(np.int64) * 1_000_000_000 + stamp['nanosec'])
    return {name: _times(*map(np.concatenate, parts)) for name, parts in columns.items()}, damages


def _times(logged: NDArray[np.int64], stamps: NDArray[np.int64], numbers: NDArray[np.int64]) -> TopicTimes:
    # Recorders that do not number leave zeros.
    known = np.sort(numbers[numbers > 0])
    lost = int(np.clip(np.diff(known) - 1, 0, None).sum())
    return TopicTimes(logged, stamps if len(stamps) == len(logged) else stamps[:0], lost)
