# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Topics of any type: message classes, quality of service, and messages as bytes."""

from collections.abc import Iterator, Sequence
from importlib import import_module
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

from pendubot_identification.errors import BagError

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


class Unserved(ReentrantCallbackGroup):
    """The callback group of subscriptions that no executor serves."""

    def can_execute(self, _: Any) -> bool:
        """Return False."""
        return False


def subscribe(node: Node, name: str, message_type: type, qos: QoSProfile | int) -> Subscription:
    """Subscribe to a topic without an executor: the caller takes its messages by :func:`received`.

    An executor needs five times the processor time to wake up for a message as to take it, a thousand times a second.
    The middleware records the arrival of every message, so the delay is harmless.
    """
    return node.create_subscription(message_type, name, lambda _: None, qos, callback_group=Unserved(), raw=True)


def received(subscription: Subscription) -> Iterator[tuple[bytes, dict[str, Any]]]:
    """Yield the waiting messages as bytes, with information of the middleware; at most a full queue."""
    with subscription.handle:
        for _ in range(DEPTH):
            if (message := subscription.handle.take_message(subscription.msg_type, True)) is None:
                return
            yield message
