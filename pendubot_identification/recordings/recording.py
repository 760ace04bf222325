"""A recording under way: a bag, and how messages come in on each of its topics. Needs no ROS."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from pendubot_identification.level import Diagnosis
from pendubot_identification.recordings.flow import Flow, diagnose

from .bag_metadata import Qos
from .bag_writer import BagWriter


@dataclass(frozen=True, slots=True)
class Arrival:
    """A message as it came: CDR, when it was received and published [ns since the epoch], its publisher's number."""

    data: bytes
    received_ns: int
    published_ns: int
    number: int | None = None


@dataclass
class _Topic:
    channel: int
    flow: Flow = field(default_factory=Flow)
    publishers: int = 1
    latest_ns: int = 0


class Recording:
    """Writes what arrives into a bag. :meth:`sync` may be called from another thread.

    Args:
        path: the bag's folder, which must not exist.
        names: of the topics that are to be recorded.
        reserve: of the disk, that other programs are left with [bytes].

    Raises:
        BagError: the name is taken, the reserve is not there, or the system refuses to write. Every method raises it
            when the bag cannot be written any more.
    """

    def __init__(self, path: Path, names: Sequence[str], reserve: int) -> None:
        self.names = tuple(names)
        self._reserve = reserve
        self._topics: dict[str, _Topic] = {}
        self._bag = BagWriter(path, reserve=reserve)
        self._diagnosed = time.monotonic()
        self.flush, self.sync, self.close = self._bag.flush, self._bag.sync, self._bag.close

    def begin(self, name: str, type_name: str, qos: Qos) -> None:
        """Announce a topic; a second time nothing but its quality of service may be another."""
        if name not in self._topics:
            self._topics[name] = _Topic(self._bag.add_topic(name, type_name, qos))

    def publishers(self, name: str, count: int) -> None:
        """Take note of how many publish a topic: else what is lost is taken for another publisher's first message."""
        self._topics[name].publishers = count

    def count(self, name: str) -> int:
        """Return how many messages of a topic are in the bag."""
        return self._topics[name].flow.count if name in self._topics else 0

    def take(self, name: str, arrival: Arrival) -> None:
        """Write a message."""
        topic = self._topics[name]
        # What had to be sent again was received later than what it precedes; players go by log time.
        topic.latest_ns = max(arrival.received_ns, topic.latest_ns)
        number = topic.flow.count + 1
        self._bag.write(topic.channel, arrival.data, topic.latest_ns, arrival.published_ns, sequence=number)
        topic.flow.heard(arrival.number, time.time_ns() - arrival.published_ns, topic.publishers)

    def diagnose(self, troubles: Sequence[str] = ()) -> Diagnosis:
        """Return how it is doing since the last time."""
        now = time.monotonic()
        flows = {name: self._topics[name].flow if name in self._topics else Flow() for name in self.names}
        elapsed, self._diagnosed = now - self._diagnosed, now
        found = diagnose(
            flows, max(elapsed, 1e-3), troubles=tuple(troubles), free=self._bag.free, reserve=self._reserve
        )
        return Diagnosis(found.level, found.message, {'bag': str(self._bag.path)} | found.values)
