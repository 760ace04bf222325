"""``recorder``: writes topics of any type, byte for byte, into a bag."""

from __future__ import annotations

import threading
import time
from collections import Counter
from datetime import datetime, timezone
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from rclpy.exceptions import InvalidTopicNameException
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo
from rclpy.validate_topic_name import validate_topic_name

from pendubot_identification.adapters.bag_writer import BagWriter, Qos
from pendubot_identification.core.errors import BagError, ParameterError

from .runtime import Setting, SettingsNode, run

DISCOVERY_PERIOD = 0.1  #: How often topics that nobody publishes yet are looked for [s].
SYNC_PERIOD = 1.0  #: How often what was recorded is put on the disk [s].
PATIENCE = 5.0  #: After this time topics that nobody publishes are named in a warning [s].
DEPTH = 1000  #: Messages that may wait while the disk is slow: a second's worth at 1 kHz.


class Recorder(SettingsNode):
    """Subscribes to every topic as soon as somebody publishes it, and writes what comes."""

    PROGRAM = 'recorder'
    SUMMARY = (
        'Records topics of any type into a bag (MCAP) that ros2 bag and pendubot read. Topics may appear later than '
        'the recorder; each is subscribed to with the quality of service of its publishers. SIGINT and SIGTERM close '
        'the bag; after SIGKILL or a power cut it holds everything but the last moments.'
    )
    SETTINGS = (
        Setting('output', '', "the bag's folder, which must not exist; empty: pendubot_<UTC date-time> in this folder"),
        Setting('topics', ['/joint_states', '/pendubot/effort_command'], 'the topics to record'),
        Setting('max_messages', 0, 'end after so many messages of the first topic; 0: when stopped', minimum=0),
    )

    def __init__(self, ended: threading.Event) -> None:
        super().__init__(ended)
        settings = self.settings()
        self._topics = self._resolved(settings['topics'])
        self._max_messages: int = settings['max_messages']
        self._subscribed: dict[str, Subscription] = {}
        self._counts: Counter[str] = Counter()
        self._latest_ns: dict[str, int] = {}
        # The executor's thread writes, the main thread closes.
        self._lock = threading.Lock()
        self._open = True
        self._bag = BagWriter(Path(settings['output'] or f'pendubot_{datetime.now(timezone.utc):%Y%m%dT%H%M%SZ}'))
        self.get_logger().info(f'recording to {self._bag.path}')
        self._missing_since = time.monotonic()
        self.create_timer(DISCOVERY_PERIOD, self._discover)
        self.create_timer(SYNC_PERIOD, self._sync)

    def check(self, values: dict[str, Any]) -> None:
        """Refuse topics that cannot be recorded.

        Raises:
            ParameterError: there are none, or one is no topic's name.
        """
        self._resolved(values['topics'])

    def close(self) -> None:
        """Close the bag and say what it holds; a second time does nothing.

        Raises:
            BagError: the system refuses to write.
        """
        with self._lock:
            if not self._open:
                return
            self._open = False
            self._bag.close()
        for topic in self._topics:
            self.get_logger().info(f'{topic}: {self._counts[topic]} messages')

    def _resolved(self, topics: list[str]) -> list[str]:
        if not any(topics):
            raise ParameterError('topics is empty; name at least one topic to record, such as /joint_states')
        try:
            for topic in topics:
                validate_topic_name(topic)
        except InvalidTopicNameException as error:
            reason = ' '.join(str(error).split())
            raise ParameterError(f'topics: {reason}; a name such as /joint_states is expected') from error
        return list(dict.fromkeys(self.resolve_topic_name(topic) for topic in topics))

    def _discover(self) -> None:
        for topic in self._topics:
            publishers = self.get_publishers_info_by_topic(topic)
            types = sorted({publisher.topic_type for publisher in publishers})
            if len(types) > 1:
                sentence = f'{topic} is published as {" and as ".join(types)}; stop the publisher of the wrong type'
                if not self._counts[topic]:
                    raise BagError(sentence)
                # What is recorded is of one type; a stranger must not end a recording that runs.
                self.get_logger().error(sentence, once=True)
            elif types and topic not in self._subscribed:
                self._subscribe(topic, types[0], publishers)
        missing = [topic for topic in self._topics if topic not in self._subscribed]
        if missing and time.monotonic() - self._missing_since > PATIENCE:
            self._missing_since = float('inf')
            self.get_logger().warning(f'nobody publishes {", ".join(missing)} yet; still waiting')

    def _subscribe(self, topic: str, type_name: str, publishers: list[TopicEndpointInfo]) -> None:
        # A subscription hears a publisher that offers at least as much: ask for what every one of them offers.
        reliable = all(p.qos_profile.reliability == ReliabilityPolicy.RELIABLE for p in publishers)
        latched = all(p.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for p in publishers)
        qos = QoSProfile(
            depth=DEPTH,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        )
        package, _, name = type_name.partition('/msg/')
        try:
            message_type = getattr(import_module(f'{package}.msg'), name)
        except (ImportError, AttributeError) as error:
            raise BagError(f'{topic} is of type {type_name}, which is not installed; source its workspace') from error
        with self._lock:
            if not self._open:
                return
            offered = Qos(qos.reliability.name.lower(), qos.durability.name.lower())
            channel = self._bag.add_topic(topic, type_name, offered)
        self._subscribed[topic] = self.create_subscription(
            message_type, topic, partial(self._record, topic, channel), qos, raw=True
        )
        self.get_logger().info(f'recording {topic} [{type_name}]')

    def _record(self, topic: str, channel: int, data: bytes, info: dict[str, int]) -> None:
        received_ns = info['received_timestamp'] or time.time_ns()
        with self._lock:
            if not self._open:
                return
            # What had to be sent again was received later than what it precedes; players go by log time.
            log_ns = self._latest_ns[topic] = max(received_ns, self._latest_ns.get(topic, 0))
            number = self._counts[topic] + 1
            self._bag.write(channel, data, log_ns, info['source_timestamp'] or received_ns, sequence=number)
            self._counts[topic] = number
        if topic == self._topics[0] and number == self._max_messages:
            self.close()
            self.end()

    def _sync(self) -> None:
        with self._lock:
            if self._open:
                self._bag.sync()


def main() -> int:
    """Run the recorder."""
    return run(Recorder)


if __name__ == '__main__':
    raise SystemExit(main())
