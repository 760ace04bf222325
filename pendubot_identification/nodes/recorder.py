# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``recorder``: records topics of any type, byte for byte, in a bag."""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime, timezone
from functools import partial
from pathlib import Path
from typing import Any

from rclpy.duration import Duration
from rclpy.qos import QoSCompatibility, QoSProfile, qos_check_compatible
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo
from rosbags.interfaces import Qos

from pendubot_identification.errors import BagError, ParameterError
from pendubot_identification.level import Level
from pendubot_identification.recordings.bag_writer import BagWriter
from pendubot_identification.recordings.flow import Flow, diagnose
from pendubot_identification.setting import Setting

from .messages import Status
from .runtime import AUTOSTART, ManagedNode, run
from .topics import DEPTH, message_class, received, recorded, subscribe, weakest

DISCOVERY_PERIOD = 0.1  #: Period of the search for new publishers [s].
FETCH_PERIOD = 0.01  #: Period of fetching messages from the middleware [s].
FLUSH_PERIOD = 0.05  #: Period of flushes to the system, after which messages survive a SIGKILL [s].
SYNC_PERIOD = 1.0  #: Period of writes to the disk, after which messages and counts survive a power cut [s].
PATIENCE = 5.0  #: Time after which a warning lists the topics without a publisher [s].


@dataclass
class Topic:
    """A topic to record: its subscription and channel, from its first publisher on, and why messages are missing."""

    name: str
    flow: Flow = field(default_factory=Flow)
    subscription: Subscription | None = None
    channel: int = -1
    type_name: str = ''
    publishers: int = 1
    latest_ns: int = 0  #: The latest log time.
    trouble: str = ''


class Recorder(ManagedNode):
    """Subscribes to every topic as soon as it has a publisher, and writes its messages.

    The executor fetches and writes a hundred times a second. A separate thread waits for the disk, so that a slow disk
    delays no other work.
    """

    PROGRAM = 'recorder'
    SUMMARY = (
        'Records topics of any type into a bag (MCAP) that ros2 bag and pendubot read. Topics may appear later than '
        'the recorder; each is recorded as its publishers offer it. SIGINT, SIGTERM and a disk that fills close the '
        'bag; after SIGKILL only the last moments are missing.'
    )
    SETTINGS = (
        Setting('output', '', "the bag's folder, which must not exist; empty: pendubot_<UTC date-time>", path=True),
        Setting('topics', ['joint_states', 'pendubot/effort_command'], 'the topics to record'),
        Setting('reserve', 100_000_000, 'free space on the disk below which the bag is closed', 'bytes', 0),
        Setting('max_messages', 0, 'number of messages of the first topic; 0: until stopped', minimum=0),
        AUTOSTART,
    )

    def _open(self, s: dict[str, Any]) -> None:
        self._topics = [Topic(name) for name in self._resolved(s['topics'])]
        self._max_messages: int = s['max_messages']
        self._fetching = threading.Lock()
        self._ending = threading.Event()
        self._failure: BagError | None = None
        path = Path(s['output'] or f'pendubot_{datetime.now(timezone.utc):%Y%m%dT%H%M%SZ}')
        self._reserve: int = s['reserve']
        self._bag = BagWriter(path, reserve=self._reserve)
        self.get_logger().info(f'recording to {path}')
        self._missing_since = self._diagnosed = time.monotonic()
        self._status = Status(self, self._diagnosis)
        self.create_timer(DISCOVERY_PERIOD, partial(self._guarded, self._discover))
        self.create_timer(FETCH_PERIOD, self._fetch)
        self.create_timer(FLUSH_PERIOD, partial(self._guarded, self._bag.flush))
        threading.Thread(target=self._keep_synced, args=(self._ending,), name='sync', daemon=True).start()

    def _check(self, s: dict[str, Any]) -> None:
        self._resolved(s['topics'])

    def _deactivate(self) -> None:
        """Write all received messages, then pause; the next activation continues the same bag."""
        self._fetch()

    def _close(self) -> None:
        """Close the bag and report its messages; raise BagError if the system refused to write."""
        self._fetch()
        self._ending.set()
        try:
            self._bag.close()
        except BagError as error:
            self._failure = self._failure or error
        for topic in self._topics:
            lost = f', {topic.flow.lost} lost' * (topic.flow.lost > 0)
            self.get_logger().info(f'{topic.name}: {topic.flow.count} messages{lost}')
        if self._failure is not None:
            self._status.publish(Level.ERROR, str(self._failure), {})
            # Otherwise the program ends before a subscriber receives the status.
            self._status.publisher.wait_for_all_acked(Duration(seconds=1))
            raise self._failure

    def _guarded(self, action: Callable[[], object]) -> bool:
        """Execute an action on the bag; if writing fails, end the program and keep the complete part of the bag."""
        try:
            if not self._ending.is_set():
                action()
                return True
        except BagError as error:
            if not self._ending.is_set():
                self._failure = self._failure or error
                self.end(1)
        return False

    def _resolved(self, topics: list[str]) -> list[str]:
        if not topics:
            raise ParameterError('topics is empty; name at least one topic to record, such as joint_states')
        return list(dict.fromkeys(self.resolved(topics)))

    def _discover(self) -> None:
        for topic in self._topics:
            trouble = self._follow(topic, self.get_publishers_info_by_topic(topic.name))
            if trouble and trouble != topic.trouble:
                self.get_logger().error(trouble)
            topic.trouble = trouble
        missing = [topic.name for topic in self._topics if topic.subscription is None]
        if missing and time.monotonic() - self._missing_since > PATIENCE:
            self._missing_since = float('inf')
            self.get_logger().warning(f'nobody publishes {", ".join(missing)} yet; still waiting')

    def _follow(self, topic: Topic, publishers: list[TopicEndpointInfo]) -> str:
        """Subscribe, again if no publisher is compatible; return a sentence if not all are recorded, else ''."""
        # With its recorded type, because a restarted publisher may have another one.
        types = sorted({publisher.topic_type for publisher in publishers} | {topic.type_name} - {''})
        if len(types) > 1:
            trouble = f'{topic.name} is published as {" and as ".join(types)}; stop the publisher of the wrong type'
            # A channel has one type; a wrong publisher must not end a running recording.
            if not topic.flow.count:
                raise BagError(trouble)
            return trouble
        if not publishers:
            return ''
        subscription = topic.subscription
        if subscription is None or not _compatible(publishers, subscription.qos_profile):
            subscription = self._subscribe(topic, types[0], [recorded(each.qos_profile) for each in publishers])
        # Distinguishes a lost message from another publisher's first message.
        topic.publishers = len(publishers)
        missed = len(publishers) - _compatible(publishers, subscription.qos_profile)
        return f'{topic.name}: {missed} of {len(publishers)} publishers offer less and are not recorded' * (missed > 0)

    def _subscribe(self, topic: Topic, type_name: str, offered: list[Qos]) -> Subscription:
        message_type = message_class(topic.name, type_name)
        self._fetch()
        with self._fetching:
            if topic.subscription is None:
                topic.channel, topic.type_name = self._bag.add_topic(topic.name, type_name, *offered), type_name
            else:
                self.destroy_subscription(topic.subscription)
            topic.subscription = subscribe(self, topic.name, message_type, weakest(offered, DEPTH))
        self.get_logger().info(f'recording {topic.name} [{type_name}]')
        return topic.subscription

    def _fetch(self) -> None:
        with self._fetching:  # also by the main thread, at the end of the program
            for topic in self._topics:
                for data, info in received(topic.subscription) if topic.subscription is not None else ():
                    self._write(topic, data, info)

    def _write(self, topic: Topic, data: bytes, info: dict[str, Any]) -> None:
        if not self.active:
            topic.flow.pause()
            return
        received_ns = info['received_timestamp'] or time.time_ns()
        published_ns = info['source_timestamp'] or received_ns
        # A retransmitted message arrives after its successor; players use the log time.
        topic.latest_ns = max(received_ns, topic.latest_ns)
        number = topic.flow.count + 1
        if self._guarded(lambda: self._bag.write(topic.channel, data, topic.latest_ns, published_ns, number)):
            lag_ns = time.time_ns() - published_ns
            topic.flow.add(info['publication_sequence_number'], lag_ns, topic.publishers)
        if 0 < self._max_messages <= self._topics[0].flow.count:
            self._ending.set()
            self.end(self.exit_status)

    def _keep_synced(self, ending: threading.Event) -> None:
        while not ending.wait(SYNC_PERIOD):
            self._guarded(self._bag.sync)

    def _diagnosis(self) -> tuple[Level, str, dict[str, Any]]:
        now = time.monotonic()
        elapsed, self._diagnosed = max(now - self._diagnosed, 1e-3), now
        flows = {topic.name: topic.flow for topic in self._topics}
        troubles = tuple(topic.trouble for topic in self._topics if topic.trouble)
        level, message, values = diagnose(flows, elapsed, troubles=troubles, free=self._bag.free, reserve=self._reserve)
        return level, message, {'bag': self._bag.path} | values


def _compatible(publishers: list[TopicEndpointInfo], qos: QoSProfile) -> int:
    """Return the number of publishers that are compatible with a subscription of this quality of service."""
    return sum(qos_check_compatible(p.qos_profile, qos)[0] != QoSCompatibility.ERROR for p in publishers)


main = partial(run, Recorder)
