# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What a bag holds, read from its beginning to its end: every time, stamp and number, and what is damaged."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from mcap.records import Schema
from numpy.typing import NDArray

from .mcap_file import Damage, McapFile
from .mcap_records import FIELDS

#: Encapsulation, and the stamp with which a header begins.
STAMP = np.dtype([('', 'V4'), ('sec', '<i4'), ('nanosec', '<u4')])


class TopicTimes(NamedTuple):
    """A topic's messages that are whole, in the order of writing.

    Attributes:
        logged: when each was received [ns since the epoch], shape (N,).
        stamps: their ``header.stamp`` [ns], shape (N,), or (0,) where not every message has one.
        lost: how many are missing between the first and the last, as the recorder numbered them.
    """

    logged: NDArray[np.int64]
    stamps: NDArray[np.int64]
    lost: int


def survey(files: Sequence[McapFile]) -> tuple[dict[str, TopicTimes], dict[str, list[Damage]]]:
    """Return what is whole by topic, and what is damaged by the file's name.

    Raises:
        OSError: a file cannot be read.
    """
    columns = {name: (array('q'), array('q'), array('q')) for file in files for name in file.topics}
    damages: dict[str, list[Damage]] = {file.path.name: [] for file in files}
    for file in files:
        stamped = {number: begins_with_header(file.schemas.get(c.schema_id)) for number, c in file.channels.items()}
        for part in file.whole_parts(damages[file.path.name]):
            for number in file.channels.keys() & set(part.messages.heads['channel'].tolist()):
                messages = part.messages.part(part.messages.heads['channel'] == number)
                logged, stamps, numbers = columns[file.channels[number].topic]
                logged.frombytes(messages.heads['logged'].tobytes())
                numbers.frombytes(messages.heads['sequence'].astype(np.int64).tobytes())
                if stamped[number] and (messages.heads['length'] >= FIELDS + STAMP.itemsize).all():
                    stamp = messages.contents(STAMP)
                    stamps.frombytes((stamp['sec'].astype(np.int64) * 1_000_000_000 + stamp['nanosec']).tobytes())
    return {name: _times(*arrays) for name, arrays in columns.items()}, damages


def begins_with_header(schema: Schema | None) -> bool:
    """Tell whether messages of this definition begin with a ``std_msgs/Header``."""
    if schema is None or schema.encoding != 'ros2msg':
        return False
    lines = (line.split('#')[0].split() for line in schema.data.decode('utf-8', 'replace').splitlines())
    # Constants hold no bytes.
    fields = (words for words in lines if len(words) >= 2 and '=' not in ''.join(words))
    return next(fields, [''])[0] in ('std_msgs/Header', 'std_msgs/msg/Header', 'Header')


def _times(logged: array[int], stamps: array[int], numbers: array[int]) -> TopicTimes:
    known = np.sort(np.array(numbers, np.int64))
    # Recorders that do not number leave zeros.
    lost = int(np.clip(np.diff(known[known > 0]) - 1, 0, None).sum())
    return TopicTimes(np.array(logged), np.array(stamps if len(stamps) == len(logged) else (), np.int64), lost)
