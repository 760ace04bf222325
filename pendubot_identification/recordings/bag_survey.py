"""What a bag holds, read from its beginning to its end: every time, stamp and number, and what is damaged."""

from __future__ import annotations

import struct
from array import array
from dataclasses import dataclass, field

import numpy as np
from mcap.records import Message, Schema
from numpy.typing import NDArray

from .mcap_file import McapFile
from .mcap_salvage import Damage, chunk_parts, whole_parts

#: Where the stamp of a message that begins with a header stands, after four bytes of encapsulation.
STAMP_OFFSET = 4


@dataclass
class TopicTimes:
    """A topic's messages in the order of writing, each once: what is repeated in each file is left out after the first.

    Attributes:
        logged: when each was received [ns since the epoch].
        stamps: their ``header.stamp`` [ns]; empty where the type has none.
        count: how many are whole, with those that are repeated.
        lost: numbers that are missing between the first and the last, as the recorder numbered them.
    """

    logged: array[int] = field(default_factory=lambda: array('q'))
    stamps: array[int] = field(default_factory=lambda: array('q'))
    count: int = 0
    lost: int = 0
    _number: int = 0

    def add(self, logged: int, number: int, stamp: int | None) -> None:
        """Take in one message."""
        self.count += 1
        # Writers that do not number leave zeros.
        if number:
            if number <= self._number:
                return
            if self._number:
                self.lost += number - self._number - 1
            self._number = number
        self.logged.append(logged)
        if stamp is not None:
            self.stamps.append(stamp)

    def times(self) -> NDArray[np.int64]:
        """Return the stamps, or where the type has none, the log times [ns], shape (N,)."""
        return np.frombuffer(self.stamps or self.logged or b'', dtype=np.int64)

    def latency(self) -> NDArray[np.float64]:
        """Return how much later than its stamp each message was received [s], shape (N,) or (0,)."""
        if not self.stamps:
            return np.empty(0)
        return np.asarray(np.subtract(*(np.frombuffer(x, dtype=np.int64) for x in (self.logged, self.stamps))) / 1e9)


def survey(files: list[McapFile]) -> tuple[dict[str, TopicTimes], dict[str, list[Damage]]]:
    """Return what is whole by topic, and what is damaged by the file's name.

    Raises:
        BagError: a file cannot be read.
    """
    topics: dict[str, TopicTimes] = {name: TopicTimes() for file in files for name in file.topics}
    damages: dict[str, list[Damage]] = {}
    for file in files:
        damages[file.path.name] = []
        by_number = {
            number: (topics[channel.topic], begins_with_header(file.schemas.get(channel.schema_id)))
            for number, channel in file.channels.items()
        }
        for *_, part in whole_parts(file.path, damages[file.path.name]):
            if isinstance(part, bytes):
                _survey_chunk(part, by_number)
            elif isinstance(part, Message) and part.channel_id in by_number:
                topic, stamped = by_number[part.channel_id]
                stamp = _stamp(part.data, 0) if stamped else None
                topic.add(part.log_time, part.sequence, stamp)
    return topics, damages


def begins_with_header(schema: Schema | None) -> bool:
    """Tell whether messages of this definition begin with a ``std_msgs/Header``."""
    if schema is None or schema.encoding != 'ros2msg':
        return False
    lines = (line.split('#')[0].split() for line in schema.data.decode('utf-8', 'replace').splitlines())
    # Constants hold no bytes.
    fields = (words for words in lines if len(words) >= 2 and '=' not in ''.join(words))
    return next(fields, [''])[0] in ('std_msgs/Header', 'std_msgs/msg/Header', 'Header')


def _survey_chunk(data: bytes, by_number: dict[int, tuple[TopicTimes, bool]]) -> None:
    for head, begin, _ in chunk_parts(data):
        if isinstance(head, tuple) and (known := by_number.get(head[0])) is not None:
            _, number, logged, _ = head
            topic, stamped = known
            topic.add(logged, number, _stamp(data, begin) if stamped else None)


def _stamp(data: bytes, at: int) -> int:
    """Return the stamp of a message in CDR that begins at an offset [ns]."""
    # The second byte of the encapsulation is odd where the message is little-endian.
    order = '<' if data[at + 1] & 1 else '>'
    seconds, nanoseconds = struct.unpack_from(f'{order}iI', data, at + STAMP_OFFSET)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)
