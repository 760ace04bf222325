"""What a bag holds, read from its beginning to its end: every time, stamp and number, and what is damaged."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from mcap.records import Schema
from numpy.typing import NDArray

from .mcap_file import Damage, McapFile
from .mcap_records import Messages

#: The stamp with which a header begins, after four bytes of encapsulation.
STAMP = np.dtype([('sec', '<i4'), ('nanosec', '<u4')])


@dataclass
class TopicTimes:
    """A topic's messages that are whole, in the order of writing.

    Attributes:
        logged: when each was received [ns since the epoch].
        stamps: their ``header.stamp`` [ns], of those that have one.
        numbers: as the recorder numbered them; 0 from recorders that do not.
    """

    logged: array[int] = field(default_factory=lambda: array('q'))
    stamps: array[int] = field(default_factory=lambda: array('q'))
    numbers: array[int] = field(default_factory=lambda: array('q'))

    def add(self, messages: Messages, stamped: bool) -> None:
        """Take in some messages, which may begin with a stamp."""
        self.logged.frombytes(messages.heads['logged'].tobytes())
        self.numbers.frombytes(messages.heads['sequence'].astype(np.int64).tobytes())
        if stamped and (messages.lengths >= 4 + STAMP.itemsize).all():
            stamp = messages.contents(STAMP, 4)
            self.stamps.frombytes((stamp['sec'].astype(np.int64) * 1_000_000_000 + stamp['nanosec']).tobytes())

    @property
    def count(self) -> int:
        """How many there are."""
        return len(self.logged)

    @property
    def lost(self) -> int:
        """How many numbers are missing between the first and the last."""
        numbers = np.unique(np.array(self.numbers, np.int64))
        numbers = numbers[numbers > 0]
        return int(numbers[-1] - numbers[0]) + 1 - len(numbers) if len(numbers) else 0

    @property
    def stamped(self) -> bool:
        """Whether every message has a stamp."""
        return len(self.stamps) == len(self.logged) > 0

    def times(self) -> NDArray[np.int64]:
        """Return the stamps, or where not every message has one, the log times [ns], shape (N,)."""
        return np.array(self.stamps if self.stamped else self.logged, np.int64)

    def latency(self) -> NDArray[np.float64]:
        """Return how much later than its stamp each message was received [s], shape (N,) or (0,)."""
        logged = np.array(self.logged if self.stamped else (), np.int64)
        return (logged - self.times()[: len(logged)]) / 1e9


def survey(files: Sequence[McapFile]) -> tuple[dict[str, TopicTimes], dict[str, list[Damage]]]:
    """Return what is whole by topic, and what is damaged by the file's name.

    Raises:
        BagError: a file cannot be read.
    """
    topics: dict[str, TopicTimes] = {name: TopicTimes() for file in files for name in file.topics}
    damages: dict[str, list[Damage]] = {}
    for file in files:
        damages[file.path.name] = []
        stamped = {number: begins_with_header(file.schemas.get(c.schema_id)) for number, c in file.channels.items()}
        for part in file.whole_parts(damages[file.path.name]):
            channels = part.messages.heads['channel']
            for number in np.unique(channels).tolist():
                if number in file.channels:
                    messages = part.messages.part(channels == number)
                    topics[file.channels[number].topic].add(messages, stamped[number])
    return topics, damages


def begins_with_header(schema: Schema | None) -> bool:
    """Tell whether messages of this definition begin with a ``std_msgs/Header``."""
    if schema is None or schema.encoding != 'ros2msg':
        return False
    lines = (line.split('#')[0].split() for line in schema.data.decode('utf-8', 'replace').splitlines())
    # Constants hold no bytes.
    fields = (words for words in lines if len(words) >= 2 and '=' not in ''.join(words))
    return next(fields, [''])[0] in ('std_msgs/Header', 'std_msgs/msg/Header', 'Header')
