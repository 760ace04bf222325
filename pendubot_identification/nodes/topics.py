# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Topics of any type: names, message classes, quality of service, and batches of messages as bytes."""

import threading
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

from pendubot_identification.errors import BagError

BATCH = 500  #: Largest number of messages of one topic that are fetched in a row.
DEPTH = 10_000  #: Queue length of a topic: ten seconds at 1 kHz.


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


def recorded(profile: QoSProfile) -> Qos:
    """Return an offered quality of service in the representation of a bag."""

    def time_of(duration: Duration) -> QosTime:
        return QosTime(*divmod(duration.nanoseconds, 10**9))

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
    """Return the weakest quality of service, which is compatible with every publisher or subscriber of the others."""
    reliable = all(p.reliability is not QosReliability.BEST_EFFORT for p in profiles)
    latched = bool(profiles) and all(p.durability is QosDurability.TRANSIENT_LOCAL for p in profiles)
    return QoSProfile(
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


class Fetched(ReentrantCallbackGroup):
    """The callback group of subscriptions that no executor serves."""

    def can_execute(self, _: Any) -> bool:
        """Return False."""
        return False


class Fetcher:
    """Subscriptions that no executor serves: their owner fetches the received messages in batches, from any thread.

    An executor needs five times the processor time to wake up for a message as to fetch it, a thousand times a second.
    The middleware records the arrival of every message, so the delay is harmless. ``take`` is called with each
    message's topic, bytes and middleware information.
    """

    def __init__(self, node: Node, take: Callable[[str, bytes, dict[str, Any]], None]) -> None:
        self._node = node
        self._take = take
        self._group = Fetched()
        self._lock = threading.RLock()
        self.subscriptions: dict[str, Subscription] = {}

    def subscribe(self, name: str, message_type: type, qos: QoSProfile | int) -> Subscription:
        """Subscribe to a topic, or replace its subscription after fetching the received messages."""
        with self._lock:
            if name in self.subscriptions:
                self.fetch_all()
                self._node.destroy_subscription(self.subscriptions.pop(name))
            self.subscriptions[name] = self._node.create_subscription(
                message_type, name, lambda _: None, qos, callback_group=self._group, raw=True
            )
            return self.subscriptions[name]

    def fetch(self) -> bool:
        """Fetch received messages, at most one batch per topic; return whether more may be waiting."""
        with self._lock:
            counts = [self._fetch_some(name, source) for name, source in self.subscriptions.items()]
            return BATCH in counts

    def fetch_all(self) -> None:
        """Fetch all waiting messages, with a bound for publishers that are faster than the fetching."""
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
