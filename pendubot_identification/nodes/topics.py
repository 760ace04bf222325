# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Topics of any type: names, message classes, quality of service, and messages fetched as bytes, many at once."""

import threading
from collections.abc import Callable, Iterable, Sequence
from importlib import import_module
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

from pendubot_identification.errors import BagError

BATCH = 500  #: Messages of one topic that are fetched before the others, and all else, have a turn.
DEPTH = 10_000  #: Messages of a topic that may wait: ten seconds' worth at 1 kHz.
SECOND, UNLIMITED = 10**9, 2**63 - 1  #: [ns]


def message_class(topic: str, type_name: str) -> Any:
    """Return the class of a topic's messages from their type, such as ``std_msgs/msg/Float64``.

    Raises:
        BagError: the package is not installed.
    """
    package, _, name = type_name.partition('/msg/')
    try:
        return getattr(import_module(f'{package}.msg'), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise BagError(f'{topic} is of type {type_name}, which is not installed; source its workspace') from error


def quality(depth: int, reliable: bool, latched: bool) -> QoSProfile:
    """Return a quality of service."""
    return QoSProfile(
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def recorded(profile: QoSProfile) -> Qos:
    """Return an offered quality of service as a bag holds it."""

    def time_of(duration: Duration) -> QosTime:
        return QosTime(*divmod(duration.nanoseconds, SECOND))

    return Qos(
        QosHistory[profile.history.name],
        profile.depth,
        QosReliability[profile.reliability.name],
        QosDurability[profile.durability.name],
        time_of(profile.deadline),
        time_of(profile.lifespan),
        QosLiveliness[profile.liveliness.name],
        time_of(profile.liveliness_lease_duration),
        profile.avoid_ros_namespace_conventions,
    )


def weakest(profiles: Sequence[Qos], depth: int) -> QoSProfile:
    """Return the weakest of some qualities of service: it fits to every publisher or subscriber of one of them."""
    reliable = all(p.reliability is not QosReliability.BEST_EFFORT for p in profiles)
    latched = bool(profiles) and all(p.durability is QosDurability.TRANSIENT_LOCAL for p in profiles)
    return quality(depth, reliable, latched)


def as_recorded(profiles: Sequence[Qos], depth: int) -> QoSProfile:
    """Return the weakest of the qualities of service in a bag with their longest times and their liveliness."""
    found = weakest(profiles, depth)

    def longest(times: Iterable[QosTime]) -> Duration:
        # Zero stands for no limit.
        return Duration(nanoseconds=max((t.sec * SECOND + t.nsec or UNLIMITED for t in times), default=0))

    found.deadline = longest(p.deadline for p in profiles)
    found.lifespan = longest(p.lifespan for p in profiles)
    found.liveliness_lease_duration = longest(p.liveliness_lease_duration for p in profiles)
    if profiles and all(p.liveliness is QosLiveliness.MANUAL_BY_TOPIC for p in profiles):
        found.liveliness = LivelinessPolicy.MANUAL_BY_TOPIC
    return found


class Fetched(ReentrantCallbackGroup):
    """The group of subscriptions for which no executor waits."""

    def can_execute(self, _: Any) -> bool:
        """Return False."""
        return False


class Fetcher:
    """Subscriptions for which no executor waits: their owner fetches the messages that have come, now and then.

    To wake up for one message costs an executor five times as much as to fetch it, a thousand times a second; and
    every message brings its time of arrival along. May be used from any thread. ``take`` is called with each message:
    its topic, its bytes, and the information of the middleware.
    """

    def __init__(self, node: Node, take: Callable[[str, bytes, dict[str, Any]], None]) -> None:
        self._node = node
        self._take = take
        self._group = Fetched()
        self._lock = threading.RLock()
        self.subscriptions: dict[str, Subscription] = {}

    def subscribe(self, name: str, message_type: type, qos: QoSProfile) -> Subscription:
        """Subscribe to a topic; a second time in place of the first, of which no message that came is lost."""
        with self._lock:
            if name in self.subscriptions:
                self.fetch_all()
                self._node.destroy_subscription(self.subscriptions.pop(name))
            self.subscriptions[name] = self._node.create_subscription(
                message_type, name, lambda _: None, qos, callback_group=self._group, raw=True
            )
            return self.subscriptions[name]

    def fetch(self) -> bool:
        """Take the messages that have come, up to a batch of each topic; return whether there may be more."""
        with self._lock:
            counts = [self._fetch_some(name, source) for name, source in self.subscriptions.items()]
            return BATCH in counts

    def fetch_all(self) -> None:
        """Take all messages that wait, but do not follow a publisher that is even faster than this."""
        for _ in range(DEPTH // BATCH):
            if not self.fetch():
                return

    def _fetch_some(self, name: str, source: Subscription) -> int:
        with source.handle:
            for k in range(BATCH):
                if (message := source.handle.take_message(source.msg_type, True)) is None:
                    return k
                self._take(name, *message)
        return BATCH
