# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Topics of any type: names, message classes, what to ask publishers for; messages fetched as bytes, many at once."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Sequence
from importlib import import_module
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.duration import Duration
from rclpy.exceptions import InvalidTopicNameException
from rclpy.node import Node
from rclpy.qos import (
    DurabilityPolicy,
    LivelinessPolicy,
    QoSCompatibility,
    QoSProfile,
    ReliabilityPolicy,
    qos_check_compatible,
)
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo
from rclpy.validate_topic_name import validate_topic_name
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

from pendubot_identification.errors import BagError, ParameterError

BATCH = 500  #: Messages of one topic that are fetched before the others, and all else, have a turn.
DEPTH = 10_000  #: Messages of a topic that may wait: ten seconds' worth at 1 kHz.
SECOND, UNLIMITED = 10**9, 2**63 - 1  #: [ns]
#: What rmw says of an endpoint whose node it does not know yet, and how long that may take [s].
UNKNOWN, PATIENCE = '_NODE_NAME_UNKNOWN_', 2.0


def full_name(endpoint: TopicEndpointInfo) -> str:
    """Return the name of the endpoint's node with its namespace."""
    return f'{endpoint.node_namespace.rstrip("/")}/{endpoint.node_name}'


def wait_for_names(look: Callable[[], Sequence[TopicEndpointInfo]], count: int = 0) -> list[TopicEndpointInfo]:
    """Return the endpoints that ``look`` finds, once there are ``count`` and the nodes of all are known.

    DDS knows an endpoint before the name of its node. After ``PATIENCE`` it returns the endpoints that are known.
    """
    deadline = time.monotonic() + PATIENCE
    while True:
        found = list(look())
        complete = len(found) >= count and all(each.node_name != UNKNOWN for each in found)
        if complete or time.monotonic() >= deadline:
            return found
        time.sleep(0.02)


def name_publishers(node: Node, topic: str, count: int, wait: bool = False) -> str:
    """Return a sentence that names the ``count`` publishers of a topic that only one program may publish.

    It counts publishers whose names are unknown, with ``wait`` after it waited for the names.
    """

    def look() -> list[TopicEndpointInfo]:
        return list(node.get_publishers_info_by_topic(topic))

    found = wait_for_names(look, count) if wait else look()
    names = sorted(full_name(each) for each in found if each.node_name != UNKNOWN)
    count = max(count, len(found))
    if len(names) < count:
        names.append(f'{count - len(names)} of unknown name')
    return (
        f'{topic} has {count} publisher{"s" * (count > 1)}: {", ".join(names)}; only one program may publish there: '
        'end the others (a killed program counts until its DDS lease ends, after up to 20 s)'
    )


def name_rivals(node: Node, subscription: Subscription, wait: bool = False) -> str:
    """Return a sentence that names the publishers of a subscription if there are several, else ''."""
    count = subscription.get_publisher_count()
    return name_publishers(node, subscription.topic_name, count, wait) if count > 1 else ''


def check_names(topics: Sequence[str], setting: str = 'topics') -> None:
    """Refuse, by ParameterError, what is no topic's name; ``setting`` says where it was given."""
    try:
        for topic in topics:
            validate_topic_name(topic)
    except InvalidTopicNameException as error:
        reason = ' '.join(str(error).split())
        raise ParameterError(f'{setting}: {reason}; a name such as joint_states is expected') from error


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
    """Return the weakest of the qualities of service in a bag: whoever heard its publishers hears it, too."""
    reliable = all(p.reliability is not QosReliability.BEST_EFFORT for p in profiles)
    latched = bool(profiles) and all(p.durability is QosDurability.TRANSIENT_LOCAL for p in profiles)
    found = quality(depth, reliable, latched)

    def longest(times: Iterable[QosTime]) -> Duration:
        # Zero stands for no limit.
        return Duration(nanoseconds=max((t.sec * SECOND + t.nsec or UNLIMITED for t in times), default=0))

    found.deadline = longest(p.deadline for p in profiles)
    found.lifespan = longest(p.lifespan for p in profiles)
    found.liveliness_lease_duration = longest(p.liveliness_lease_duration for p in profiles)
    if profiles and all(p.liveliness is QosLiveliness.MANUAL_BY_TOPIC for p in profiles):
        found.liveliness = LivelinessPolicy.MANUAL_BY_TOPIC
    return found


def matched(publishers: Sequence[TopicEndpointInfo], depth: int) -> QoSProfile:
    """Return what to ask for: a publisher is heard that offers as much or more, so what every one of them offers."""
    reliable = all(p.qos_profile.reliability == ReliabilityPolicy.RELIABLE for p in publishers)
    latched = all(p.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for p in publishers)
    return quality(depth, reliable, latched)


def heard(publishers: Sequence[TopicEndpointInfo], qos: QoSProfile) -> int:
    """Return how many of the publishers a subscription that asks for this hears."""
    return sum(qos_check_compatible(p.qos_profile, qos)[0] != QoSCompatibility.ERROR for p in publishers)


class Fetched(ReentrantCallbackGroup):
    """What no executor waits for."""

    def can_execute(self, _: Any) -> bool:
        """Say no."""
        return False


class Fetcher:
    """Subscriptions that no executor waits for: whoever made them fetches what has come, now and then.

    To wake up for one message costs an executor five times as much as to fetch it, a thousand times a second; and
    every message brings the time of its coming along. May be used from any thread. ``take`` is called with each
    message: its topic, its bytes, and what the middleware says of it.
    """

    def __init__(self, node: Node, take: Callable[[str, bytes, dict[str, Any]], None]) -> None:
        self._node = node
        self._take = take
        self._group = Fetched()
        self._lock = threading.RLock()
        self._subscriptions: dict[str, Subscription] = {}

    def qos(self, name: str) -> QoSProfile | None:
        """Return how a topic is subscribed to; None where it is not."""
        known = self._subscriptions.get(name)
        return known.qos_profile if known else None

    def subscribe(self, name: str, message_type: type, qos: QoSProfile) -> Subscription:
        """Subscribe to a topic; a second time in place of the first, of which nothing that came is lost."""
        with self._lock:
            if name in self._subscriptions:
                self.fetch_all()
                self._node.destroy_subscription(self._subscriptions.pop(name))
            self._subscriptions[name] = self._node.create_subscription(
                message_type, name, lambda _: None, qos, callback_group=self._group, raw=True
            )
            return self._subscriptions[name]

    def fetch(self) -> bool:
        """Take what has come, up to a batch of each topic; return whether there may be more."""
        with self._lock:
            counts = [self._fetch_some(name, source) for name, source in self._subscriptions.items()]
            return BATCH in counts

    def fetch_all(self) -> None:
        """Take all that waits; what is published even faster than that is not waited for."""
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
