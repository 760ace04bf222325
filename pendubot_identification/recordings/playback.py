"""A bag's messages in the order in which they were received, for whoever plays them."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from pendubot_identification.errors import BagError

from .bag_metadata import Qos, offered_profiles
from .bag_reader import BagReader
from .mcap_file import McapFile

#: How rosbag2 writes what a publisher offers, by name or, in older bags, by number.
RELIABILITY = {'reliable': 'reliable', 'best_effort': 'best_effort', 1: 'reliable', 2: 'best_effort'}
DURABILITY = {'transient_local': 'transient_local', 'volatile': 'volatile', 1: 'transient_local', 2: 'volatile'}


class Played(NamedTuple):
    """A message: when it was received [ns since the epoch], on which topic, and as CDR."""

    log_ns: int
    topic: str
    data: bytes


@dataclass(frozen=True, slots=True)
class PlayedTopic:
    """A topic, its type, and what its publishers offered when it was recorded."""

    name: str
    type_name: str
    qos: Qos


class Playback:
    """The topics of a bag that are to be played.

    Attributes:
        topics: with messages.
        first_ns, last_ns: of the bag [ns since the epoch].
        note: what could be read, in a sentence, where the bag was not closed; else empty.

    Args:
        path: the bag.
        names: of the topics; none: all.

    Raises:
        BagError: the bag cannot be read, holds no message, or lacks a topic.
    """

    def __init__(self, path: Path, names: Sequence[str] = ()) -> None:
        self._reader = BagReader(path)
        info = self._reader.info
        there = {topic.name: topic.type_name for topic in info.topics if topic.count}
        if not there or info.first_ns is None or info.last_ns is None:
            raise BagError(f'{path} holds no message; nothing can be played')
        if missing := [name for name in names if name not in there]:
            raise BagError(f'{path} holds nothing on {missing[0]}; its topics are {", ".join(there)}')
        self.first_ns, self.last_ns = info.first_ns, info.last_ns
        self.note = info.note
        self.topics = tuple(
            PlayedTopic(name, type_name, self._offered(name))
            for name, type_name in there.items()
            if name in (names or there)
        )

    def messages(self, start_ns: int, end_ns: int) -> Iterator[Played]:
        """Return the messages with START <= log time < END [ns since the epoch], in the order of log times.

        Raises:
            BagError: a part of a closed file is damaged.
        """

        def of_topic(file: McapFile, name: str) -> Iterator[Played]:
            return (Played(m.log_time, name, m.data) for m in file.messages(name, start_ns, end_ns))

        for file in self._reader.files:
            streams = [of_topic(file, topic.name) for topic in self.topics if topic.name in file.topics]
            yield from heapq.merge(*streams, key=lambda played: played.log_ns)

    def _offered(self, name: str) -> Qos:
        """Return the weakest of what was offered, so that whoever heard it then hears it now."""
        profiles: list[Any] = []
        for file in self._reader.files:
            for channel in file.channels.values():
                if channel.topic == name:
                    profiles += offered_profiles(channel.metadata.get('offered_qos_profiles', ''))
        reliable = all(RELIABILITY.get(p.get('reliability'), 'reliable') == 'reliable' for p in profiles)
        latched = profiles and all(DURABILITY.get(p.get('durability')) == 'transient_local' for p in profiles)
        return Qos(
            'reliable' if reliable else 'best_effort',
            'transient_local' if latched else 'volatile',
        )
