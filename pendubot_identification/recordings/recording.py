"""A recording under way: a bag, and how messages come in on each of its topics. Needs no ROS."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from pendubot_identification.errors import BagError
from pendubot_identification.level import Diagnosis
from pendubot_identification.recordings.flow import Flow, diagnose

from .bag_metadata import Qos
from .bag_writer import BagWriter, Limits


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
    latched: bool
    flow: Flow = field(default_factory=Flow)
    publishers: int = 1
    #: The most publishers that there were together.
    kept: int = 1
    latest_ns: int = 0
    #: What came last while paused, of a latched topic: it is still in force afterwards.
    waiting: Arrival | None = None


class Recording:
    """Writes what arrives into a bag. :meth:`sync` may be called from another thread.

    Args:
        path: the bag's folder, which must not exist.
        names: of the topics that are to be recorded.
        limits: of the bag's files, and of the disk.

    Raises:
        BagError: the name is taken, the reserve is not there, or the system refuses to write. Every method raises it
            when the bag cannot be written any more.
    """

    def __init__(self, path: Path, names: Sequence[str], limits: Limits) -> None:
        self.names = tuple(names)
        self.paused = False
        self._limits = limits
        self._topics: dict[str, _Topic] = {}
        self._bag = BagWriter(path, limits=limits)
        self._diagnosed = time.monotonic()
        self.path = self._bag.path
        self.flush, self.sync, self.close = self._bag.flush, self._bag.sync, self._bag.close

    def begin(self, name: str, type_name: str, qos: Qos) -> None:
        """Announce a topic; a second time nothing but its quality of service may be another."""
        latched = qos.durability == 'transient_local'
        if name not in self._topics:
            self._topics[name] = _Topic(self._bag.add_topic(name, type_name, qos), latched)

    def publishers(self, name: str, count: int) -> None:
        """Take note of how many publish a topic: the last message of each is kept for the next file, if it latches."""
        topic = self._topics[name]
        # As many as there are now: else what is lost after one of them left is taken for another's first.
        topic.publishers = count
        if count > topic.kept:
            topic.kept = count
            if topic.latched:
                self._bag.keep(topic.channel, count)

    def count(self, name: str) -> int:
        """Return how many messages of a topic are in the bag."""
        return self._topics[name].flow.count if name in self._topics else 0

    def take(self, name: str, arrival: Arrival) -> None:
        """Write a message, unless paused."""
        topic = self._topics[name]
        if self.paused:
            topic.waiting = arrival if topic.latched else None
            topic.flow.skipped += 1
            return
        # What had to be sent again was received later than what it precedes; players go by log time.
        topic.latest_ns = max(arrival.received_ns, topic.latest_ns)
        number = topic.flow.count + 1
        self._bag.write(topic.channel, arrival.data, topic.latest_ns, arrival.published_ns, sequence=number)
        topic.flow.heard(arrival.number, time.time_ns() - arrival.published_ns, topic.publishers)

    def pause(self) -> str:
        """Write nothing until :meth:`resume`."""
        self.paused = True
        self._bag.flush()
        return 'paused'

    def resume(self) -> str:
        """Write again, first what was latched meanwhile."""
        self.paused = False
        for name, topic in self._topics.items():
            topic.flow.forget()
            waiting, topic.waiting = topic.waiting, None
            if waiting is not None:
                self.take(name, waiting)
        return 'recording'

    def split(self) -> str:
        """End the present file; the next message begins another.

        Raises:
            BagError: nothing is in it yet.
        """
        if not self._bag.split():
            raise BagError(f'{self._bag.files[-1]} holds no message yet; split when one has come')
        return f'{self._bag.files[-1]} is closed; the next message begins another'

    def diagnose(self, troubles: Sequence[str] = ()) -> Diagnosis:
        """Return how it is doing since the last time."""
        now = time.monotonic()
        flows = {name: self._topics[name].flow if name in self._topics else Flow() for name in self.names}
        elapsed, self._diagnosed = now - self._diagnosed, now
        found = diagnose(
            flows,
            max(elapsed, 1e-3),
            paused=self.paused,
            troubles=tuple(troubles),
            free=self._bag.free,
            reserve=self._limits.reserve,
        )
        where = {'bag': str(self.path), 'file': self._bag.files[-1]}
        return Diagnosis(found.level, found.message, where | found.values)
