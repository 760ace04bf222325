# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Exclusive ownership of the motor: detection of second publishers, and the client of the bridge."""

import threading
import time
from collections.abc import Sequence

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription
from rclpy.task import Future
from rclpy.topic_endpoint_info import TopicEndpointInfo
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

EFFORT_COMMAND = 'pendubot/effort_command'
#: Effort commands as sensor_msgs/JointState, from ros2_control's joint_state_topic_hardware_interface.
JOINT_COMMANDS = 'pendubot/joint_commands'
#: The rmw's placeholder for an unknown node name, and the longest wait for the name [s].
UNKNOWN, PATIENCE = '_NODE_NAME_UNKNOWN_', 2.0


def _full_name(info: TopicEndpointInfo) -> str:
    """Return the full name of an endpoint's node."""
    return f'{info.node_namespace.rstrip("/")}/{info.node_name}'


def _name_publishers(node: Node, topics: Sequence[str], count: int, wait: bool) -> str:
    """Return a sentence that names the ``count`` publishers of topics that together permit one publisher.

    DDS discovers a publisher before its node's name. With ``wait`` it waits at most ``PATIENCE`` for the names.
    """
    deadline = time.monotonic() + PATIENCE * wait
    while True:
        infos = [info for topic in topics for info in node.get_publishers_info_by_topic(topic)]
        known = [each for each in infos if each.node_name != UNKNOWN]
        names = sorted(map(_full_name, known))
        if len(names) >= count or time.monotonic() >= deadline:
            break
        time.sleep(0.02)
    count = max(count, len(names))
    unknown = [f'{count - len(names)} of unknown name'] * (len(names) < count)
    published = [topic for topic in topics if node.count_publishers(topic)] or topics[:1]
    have = 'have' if len(published) > 1 else 'has'
    return (
        f'{" and ".join(published)} {have} {count} publisher{"s" * (count > 1)}: {", ".join(names + unknown)}'
        '; only one program may publish there: end the others (a killed program counts until its DDS lease ends, after '
        'up to 20 s)'
    )


def name_rivals(node: Node, *subscriptions: Subscription, wait: bool = False) -> str:
    """Return a sentence that names the publishers of subscriptions if there is more than one in total, else ''.

    With ``wait`` it waits for their names.
    """
    count = sum(subscription.get_publisher_count() for subscription in subscriptions)
    return _name_publishers(node, [each.topic_name for each in subscriptions], count, wait) if count > 1 else ''


def name_others(node: Node, publisher: Publisher) -> str:
    """Return a sentence that names the publishers of a topic if a node's own publisher is not the only one, else ''."""
    count = node.count_publishers(publisher.topic_name)
    return _name_publishers(node, [publisher.topic_name], count, wait=False) if count > 1 else ''


class Driver:
    """A node's client of a bridge: effort commands, from :meth:`begin` on, and the services that arm and disarm.

    ``bridge`` is the full name of the bridge: ``bridge`` in the node's namespace, or as remapped. ``publisher`` is None
    before :meth:`begin` and after :meth:`end`, so that only the program that drives the motor is a publisher.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self.publisher: Publisher | None = None
        self.bridge = node.resolve_service_name('bridge/arm').removesuffix('/arm')
        # A separate group, so that answers arrive while a service of the node waits for them.
        group = ReentrantCallbackGroup()
        self.arm = node.create_client(Trigger, 'bridge/arm', callback_group=group)
        self.disarm = node.create_client(Trigger, 'bridge/disarm', callback_group=group)

    def unserved(self) -> str:
        """Return a sentence on a service of the bridge that nobody serves, else ''."""
        for service in (self.arm, self.disarm):
            if not service.service_is_ready():
                return (
                    f'nobody serves {service.service_name}; start the bridge or, if its node has another name, remap '
                    'bridge/arm and bridge/disarm'
                )
        return ''

    def begin(self) -> None:
        """Publish effort commands from now on."""
        if self.publisher is None:
            self.publisher = self._node.create_publisher(Float64, EFFORT_COMMAND, 1)

    def is_received(self, patience: float = 0.0) -> bool:
        """Return whether the bridge subscribes to the effort commands, after at most ``patience`` [s]."""
        deadline = time.monotonic() + patience
        while self.publisher is not None:
            infos = self._node.get_subscriptions_info_by_topic(self.publisher.topic_name)
            received = self.publisher.get_subscription_count() > 0 and self.bridge in map(_full_name, infos)
            if received or time.monotonic() >= deadline:
                return received
            time.sleep(0.01)
        return False

    def not_received(self) -> str:
        """Return a sentence on a bridge that does not receive the effort commands."""
        topic = self._node.resolve_topic_name(EFFORT_COMMAND)
        return f'{self.bridge} does not subscribe to {topic}: remap {EFFORT_COMMAND} as you did for the bridge'

    def end(self) -> None:
        """Stop publishing effort commands."""
        if self.publisher is not None:
            self._node.destroy_publisher(self.publisher)
            self.publisher = None

    def effort(self, torque: float) -> None:
        """Publish a torque [N m], if :meth:`begin` was called."""
        if self.publisher is not None:
            self.publisher.publish(Float64(data=torque))

    def release(self) -> Future:
        """Command zero torque and disarm; return the future answer of the bridge, which is logged if it fails."""
        self.effort(0.0)
        future = self.disarm.call_async(Trigger.Request())
        future.add_done_callback(self._on_disarmed)
        return future

    def _on_disarmed(self, future: Future) -> None:
        answer = future.result()
        if not answer.success:
            self._node.get_logger().error(f'{self.bridge}: {answer.message}')

    def release_and_wait(self) -> None:
        """Command zero torque and disarm; wait at most a second for the answer of the bridge."""
        answered = threading.Event()
        self.release().add_done_callback(lambda _: answered.set())
        if not answered.wait(1.0):
            self._node.get_logger().warning('the bridge did not answer to disarm; check that it is disarmed')

    def rivals(self) -> str:
        """Return a sentence that names the publishers of commands if another program has a publisher, else ''."""
        topics = [self._node.resolve_topic_name(topic) for topic in (EFFORT_COMMAND, JOINT_COMMANDS)]
        count = sum(self._node.count_publishers(topic) for topic in topics)
        own = self.publisher is not None
        return _name_publishers(self._node, topics, count, wait=True) if count > own else ''
