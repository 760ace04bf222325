# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Topics by name: what a subscription has to ask for to hear every publisher, and of which class messages are."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from typing import Any

from rclpy.exceptions import InvalidTopicNameException
from rclpy.qos import DurabilityPolicy, QoSCompatibility, QoSProfile, ReliabilityPolicy, qos_check_compatible
from rclpy.topic_endpoint_info import TopicEndpointInfo
from rclpy.validate_topic_name import validate_topic_name

from pendubot_identification.errors import BagError, ParameterError


def check_names(topics: Sequence[str], setting: str = 'topics') -> None:
    """Refuse what is no topic's name; ``setting`` says where it was given.

    Raises:
        ParameterError: with the reason.
    """
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


def matched(publishers: Sequence[TopicEndpointInfo], depth: int) -> QoSProfile:
    """Return what to ask for: a publisher is heard that offers as much or more, so what every one of them offers."""
    reliable = all(p.qos_profile.reliability == ReliabilityPolicy.RELIABLE for p in publishers)
    latched = all(p.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for p in publishers)
    return QoSProfile(
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def heard(publishers: Sequence[TopicEndpointInfo], qos: QoSProfile) -> int:
    """Return how many of the publishers a subscription that asks for this hears."""
    compatible = (qos_check_compatible(publisher.qos_profile, qos)[0] for publisher in publishers)
    return sum(each != QoSCompatibility.ERROR for each in compatible)
