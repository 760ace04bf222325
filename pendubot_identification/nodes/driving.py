# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Who gives effort commands, and who obeys them."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.task import Future
from rclpy.topic_endpoint_info import TopicEndpointInfo
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from pendubot_identification.errors import PendubotError

from .shutdown import Shutdown
from .topics import PATIENCE, full_name, name_publishers, wait_for_names

#: So long one looks for others before the first message; and then again, with every message [s].
DISCOVERY = 1.0
#: How long it is believed that nobody else has come [s].
FRESH = 0.1


class Driver:
    """A node's way to a bridge: its effort commands, from :meth:`begin` on, and the services that arm and disarm.

    ``bridge`` is the full name of the bridge: ``bridge`` in the node's namespace, or as remapped. ``publisher`` is None
    before :meth:`begin` and after :meth:`end`: only a program that drives publishes effort commands.
    """

    def __init__(self, node: Node, callback_group: CallbackGroup | None = None) -> None:
        self._node = node
        self._topic = node.resolve_topic_name('pendubot/effort_command')
        self.publisher: Publisher | None = None
        self.bridge = node.resolve_service_name('bridge/arm').removesuffix('/arm')
        self.arm = node.create_client(Trigger, 'bridge/arm', callback_group=callback_group)
        self.disarm = node.create_client(Trigger, 'bridge/disarm', callback_group=callback_group)

    def begin(self) -> None:
        """Publish effort commands from now on."""
        if self.publisher is None:
            self.publisher = self._node.create_publisher(Float64, 'pendubot/effort_command', QoSProfile(depth=1))

    def is_heard(self) -> bool:
        """Wait, for ``PATIENCE`` at most, until somebody receives the effort commands; return whether they do."""
        deadline = time.monotonic() + PATIENCE
        while self.publisher is not None and not self.publisher.get_subscription_count():
            if time.monotonic() > deadline:
                return False
            time.sleep(0.01)
        return True

    def end(self) -> None:
        """Publish no effort commands from now on."""
        if self.publisher is not None:
            self._node.destroy_publisher(self.publisher)
            self.publisher = None

    def effort(self, torque: float) -> None:
        """Command a torque [N m], once :meth:`begin` was called."""
        if self.publisher is not None:
            self.publisher.publish(Float64(data=torque))

    def let_go(self) -> Future:
        """Command zero torque and disarm; return the bridge's answer to come."""
        self.effort(0.0)
        return self.disarm.call_async(Trigger.Request())

    def let_go_and_wait(self) -> None:
        """Command zero torque and disarm; wait, for a second at most, until the bridge has answered or is gone."""
        answered = threading.Event()
        self.let_go().add_done_callback(lambda _: answered.set())
        deadline = time.monotonic() + 1.0
        while not answered.wait(0.02):
            if not self.disarm.service_is_ready() or time.monotonic() > deadline:
                self._node.get_logger().warning('the bridge did not answer to disarm; look whether it has done so')
                return

    def rivals(self) -> str:
        """Return a sentence that names the publishers of effort commands if another program is one, else ''."""
        count = self._node.count_publishers(self._topic)
        own = self.publisher is not None
        return name_publishers(self._node, self._topic, count, wait=True) if count > own else ''


class CommandGuard:
    """Keeps recorded commands from a bridge that would obey them, whether it is there or comes later.

    Of the ``publishers`` those of other types than commands have are left alone.
    """

    def __init__(self, node: Node, publishers: Iterable[Publisher]) -> None:
        self._node = node
        # Of each: how many listened when it was last looked at, and until when that is believed.
        self._seen = {publisher: (0, 0.0) for publisher in publishers if publisher.msg_type is Float64}

    def look_around(self, ended: Shutdown) -> None:
        """Look who listens, as :meth:`check` does, once they had time to be discovered."""
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
        listeners = wait_for_names(lambda: self._node.get_subscriptions_info_by_topic(topic))
        for listener in filter(self._is_bridge, listeners):
            raise PendubotError(
                f'{full_name(listener)} obeys {topic}, which this bag holds: an armed rig would move; stop the '
                'bridge, or name in topics what is to be played, without it (named there, it is played)'
            )
        self._seen[publisher] = count, time.monotonic() + FRESH

    def _is_bridge(self, listener: TopicEndpointInfo) -> bool:
        """Return whether it is a bridge by its name, or arms something as a bridge of another name does."""
        services = [name for name, _ in self._node.get_service_names_and_types()]
        return listener.node_name == 'bridge' or f'{full_name(listener)}/arm' in services
