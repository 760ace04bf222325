# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Who else is there: what obeys effort commands, and what gives them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.topic_endpoint_info import TopicEndpointInfo
from std_msgs.msg import Float64

from pendubot_identification.errors import PendubotError

from .shutdown import Shutdown

#: The nodes that make a rig move.
DRIVERS = ('exciter', 'balancer')
#: What rmw says of an endpoint whose node it does not know yet, and how long that may take [s].
UNKNOWN, PATIENCE = '_NODE_NAME_UNKNOWN_', 2.0
#: So long one looks for others before the first message; and then again, with every message [s].
DISCOVERY = 1.0
#: How long it is believed that nobody else has come [s].
FRESH = 0.1


class CommandGuard:
    """Keeps recorded commands from a bridge that would obey them, whether it is there or comes later.

    Args:
        node: that publishes.
        publishers: whose messages may be commands; those of other types than commands have are left alone.
    """

    def __init__(self, node: Node, publishers: Iterable[Publisher]) -> None:
        self._node = node
        # Of each: how many listened when it was last looked at, and until when that is believed.
        self._seen = {publisher: (0, 0.0) for publisher in publishers if publisher.msg_type is Float64}

    def look_around(self, ended: Shutdown) -> None:
        """Look who listens, once they had time to be discovered.

        Raises:
            PendubotError: a bridge does.
        """
        if self._seen:
            ended.wait(DISCOVERY)
        for publisher in self._seen:
            self.check(publisher)

    def check(self, publisher: Publisher) -> None:
        """Look who listens now, right before a message.

        Raises:
            PendubotError: a bridge does.
        """
        if publisher not in self._seen:
            return
        count = publisher.get_subscription_count()
        before, until = self._seen[publisher]
        if not count or (count == before and time.monotonic() < until):
            return
        topic = publisher.topic_name
        for listener in _known(lambda: self._node.get_subscriptions_info_by_topic(topic)):
            if _is_bridge(self._node, listener):
                raise PendubotError(
                    f'{full_name(listener)} obeys {topic}, which this bag holds: an armed rig would move; stop the '
                    'bridge, or name in topics what is to be played, without it (named there, it is played)'
                )
        self._seen[publisher] = count, time.monotonic() + FRESH


def bridge_of(node: Node) -> str:
    """Return the full name of the bridge that a node asks to be armed: ``bridge`` in its namespace, or as remapped."""
    return node.resolve_service_name('bridge/arm').removesuffix('/arm')


def rival(node: Node, publisher: Publisher) -> str:
    """Return the name of another exciter or balancer on the publisher's topic; empty where there is none."""
    there = node.get_publishers_info_by_topic(publisher.topic_name)
    names = [full_name(each) for each in there if each.node_name in DRIVERS]
    if (own := node.get_fully_qualified_name()) in names:
        names.remove(own)  # once: another may have the same name
    return names[0] if names else ''


def full_name(endpoint: TopicEndpointInfo) -> str:
    """Return the name of the endpoint's node with its namespace."""
    return f'{endpoint.node_namespace.rstrip("/")}/{endpoint.node_name}'


def _is_bridge(node: Node, listener: TopicEndpointInfo) -> bool:
    """Return whether it is a bridge by its name, or arms something as a bridge of another name does."""
    arm = f'{full_name(listener)}/arm'
    return listener.node_name == 'bridge' or any(name == arm for name, _ in node.get_service_names_and_types())


def _known(look: Callable[[], Sequence[TopicEndpointInfo]]) -> Sequence[TopicEndpointInfo]:
    """Return the endpoints once each one's node is known: it is heard of later than the endpoint itself."""
    deadline = time.monotonic() + PATIENCE
    while True:
        found = look()
        if time.monotonic() > deadline or all(each.node_name != UNKNOWN for each in found):
            return found
        time.sleep(0.02)
