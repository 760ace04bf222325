# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``player``: publishes the messages of a bag, and optionally the motion of an identified rig under its torque."""

import math
import threading
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from pendubot_identification.errors import BagError, ParameterError
from pendubot_identification.model.dynamics import Pair
from pendubot_identification.model.simulation import HANGING, LatePlant
from pendubot_identification.recordings.bag_reader import BagReader, BagWindow
from pendubot_identification.recordings.bag_writer import offered_profiles
from pendubot_identification.recordings.mcap_file import McapFile
from pendubot_identification.results.result import read_result
from pendubot_identification.setting import Setting
from pendubot_identification.trajectories.conventions import JOINT_NAMES

from .messages import joint_sample
from .runtime import JOINTS, SettingsNode, run
from .topics import message_class, weakest

SECOND = 1_000_000_000
DEPTH = 1000  #: Number of messages kept for slow subscribers and for retransmission.
DELIVERY = 2.0  #: Longest wait for the delivery of the last messages [s].
COMMAND = 'std_msgs/msg/Float64'  #: The type of effort commands.
SHARED = ('/clock', '/diagnostics', '/parameter_events', '/rosout')  #: Topics that are the same in every namespace.
RESTART = 1.0  #: Interval of restarts of the simulation from the recorded state [s]: the rig's motion is chaotic.


class Ghost:
    """The simulation of an identified rig under the recorded torque, restarted from the recorded state every second.

    Raises:
        PendubotError: the result cannot be read, or its parameters are unphysical.
    """

    def __init__(self, node: Node, path: Path, joint_names: Sequence[str]) -> None:
        result, self._names = read_result(path), joint_names
        self._plant = LatePlant(result.theta, max(result.effort.delay, 0.0))
        self.publisher = node.create_publisher(JointState, 'ghost/joint_states', 1000)
        self._t = self._begun = -math.inf
        self._q, self._effort = HANGING, (0.0, 0.0)

    def follow(self, data: bytes) -> None:
        """Publish the simulated state at the time of a recorded message; raise ControlError if that is incomplete.

        Missing velocities are computed from two samples.
        """
        message = deserialize_message(data, JointState)
        t, q, effort = joint_sample(message, self._names)
        if (passed := t - self._t) <= 0:
            return
        if passed < RESTART:
            self._plant.advance(self._effort, passed)
        if t - self._begun >= RESTART:
            speeds = {name: v for name, v in zip(message.name, message.velocity, strict=False) if math.isfinite(v)}
            slopes = [(now - before) / passed for now, before in zip(q, self._q, strict=True)]
            qd: Pair = tuple(map(speeds.get, self._names, slopes))
            self._plant.place(q, qd)
            self._begun = t
        elbow = dict(zip(message.name, message.effort, strict=False)).get(self._names[1], 0.0)
        self._t, self._q, self._effort = t, q, (effort, elbow)
        self.publisher.publish(JointState(header=message.header, name=JOINT_NAMES, position=self._plant.q))


class Player(SettingsNode):
    """Publishes each message of a bag, in a separate thread, at its due time."""

    PROGRAM = 'player'
    SUMMARY = (
        "Publishes a bag's messages byte for byte, with the recorded reliability, durability and timing, then ends. In "
        'a namespace, the topics are within it. Effort commands (std_msgs/Float64) would move an armed rig: they are '
        'played only if topics contains them. ros2 bag play has more options.'
    )
    SETTINGS = (
        Setting('bag', '', 'BAG or BAG@START:END in seconds from its first message: a folder or .mcap file', path=True),
        Setting('topics', [''], 'the topics to play; one empty name: all except effort commands'),
        Setting('rate', 1.0, 'speed relative to the recording', '', 0.001, 1000.0),
        Setting('wait', 0.0, 'longest wait until every topic has a subscriber', 's', 0.0, 3600.0),
        Setting('ghost', '', 'result file, whose rig is simulated on ghost/joint_states; empty: none', path=True),
        JOINTS,
    )

    def _open(self, s: dict[str, Any]) -> None:
        window, self._rate, self._wait = BagWindow.parse(s['bag']), s['rate'], s['wait']
        self._reader = BagReader(window.path)
        kinds = self._chosen(self._wanted(s))
        self._first_ns = self._reader.first_ns + round((window.start or 0.0) * SECOND)
        self._end_ns = self._reader.last_ns + 1
        if window.end is not None:
            self._end_ns = min(self._end_ns, self._reader.first_ns + round(window.end * SECOND))
        if self._first_ns >= self._end_ns:
            raise ParameterError(f'{window}: the bag lasts {self._reader.duration:.3f} s; give a START within it')
        for note in filter(None, [self._reader.note, window.cut(self._reader.duration)]):
            self.get_logger().warning(note)
        self._publishers_of = {
            name: self.create_publisher(message_class(name, kind), self._published(name), self._qos(name))
            for name, kind in kinds.items()
        }
        self._joint_states = self.resolve_topic_name('joint_states')
        played = [publisher.topic_name for publisher in self._publishers_of.values()]
        if s['ghost'] and self._joint_states not in played:
            topics = f'{self._joint_states}, which is not among the played topics {", ".join(played)}'
            raise ParameterError(f'ghost follows {topics}; name its topic by -r joint_states:=TOPIC')
        self._ghost = Ghost(self, Path(s['ghost']), s['joint_names']) if s['ghost'] else None
        self._failure: Exception | None = None
        self._thread = threading.Thread(target=self._play, daemon=True)
        self._thread.start()

    def _check(self, s: dict[str, Any]) -> None:
        if not s['bag']:
            raise ParameterError('bag is empty; give the folder of a bag')
        self._wanted(s)

    def _close(self) -> None:
        """Stop playing; raise PendubotError if the bag could not be read to its end."""
        self.ended.set()
        self._thread.join(DELIVERY + 1.0)
        if self._failure is not None:
            raise self._failure

    def _wanted(self, s: dict[str, Any]) -> set[str]:
        """Return the full names of the topics to play, not remapped, because they are names in a bag."""
        return set(self.resolved(s['topics'], only_expand=True))

    def _chosen(self, wanted: set[str]) -> dict[str, str]:
        """Return the types of the topics to play, by their names in the bag.

        Raises:
            BagError: a topic is missing, or two have the same name in this node's namespace.
        """
        recorded = {name: kind for name, (kind, count) in self._reader.topics.items() if count}
        if wanted:
            other = wanted - recorded.keys()  # names in this node's namespace
            chosen = {n: kind for n, kind in recorded.items() if n in wanted or self._published(n) in other}
        else:
            wanted = {'any topic except effort commands'}
            chosen = {name: kind for name, kind in recorded.items() if kind != COMMAND}
            for name in sorted(recorded.keys() - chosen.keys()):
                self.get_logger().info(f'{name} would move an armed rig; name it in topics to play it')
        if len(chosen) < len(wanted):
            missing = ', '.join(sorted(wanted))
            raise BagError(f'{self._reader.path} has no messages on {missing}; its topics are {", ".join(recorded)}')
        names = {self._published(name): name for name in chosen}
        if alike := [name for name in chosen if name not in names.values()]:
            topic = self._published(alike[0])
            raise BagError(f'{alike[0]} and {names[topic]} would both be played as {topic}; name one of them in topics')
        return chosen

    def _published(self, name: str) -> str:
        """Return the name under which a topic is published: in this node's namespace, unless all rigs share it."""
        namespace = self.get_namespace().rstrip('/')
        return name if name in SHARED or name.startswith(f'{namespace}/') else namespace + name

    def _qos(self, name: str) -> QoSProfile:
        """Return the weakest recorded quality of service of a topic."""
        channels = (c for file in self._reader.files for c in file.channels.values() if c.topic == name)
        texts = (channel.metadata.get('offered_qos_profiles', '') for channel in channels)
        return weakest([profile for text in texts for profile in offered_profiles(text)], DEPTH)

    def _play(self) -> None:
        try:
            deadline = time.monotonic() + self._wait
            publishers = [*self._publishers_of.values(), *([self._ghost.publisher] if self._ghost else [])]
            while not all(publisher.get_subscription_count() for publisher in publishers):
                if time.monotonic() >= deadline or self.ended.wait(0.02):
                    break
            self.get_logger().info(f'playing {", ".join(self._publishers_of)}')
            self._begun_ns = time.monotonic_ns()
            count = sum(map(self._play_file, self._reader.files))
            for publisher in publishers:
                publisher.wait_for_all_acked(Duration(seconds=DELIVERY))
            self.get_logger().info(f'{count} messages played')
        except Exception as error:
            self._failure = error
        self.end(1 if self._failure else 0)

    def _play_file(self, file: McapFile) -> int:
        """Play a file until its end or the end of the program; return the number of played messages."""
        count = 0
        for messages in file.messages(self._publishers_of, self._first_ns, self._end_ns):
            # The recorder fetches topic by topic.
            for message in sorted(messages, key=lambda message: message.log_time):
                due_ns = self._begun_ns + (message.log_time - self._first_ns) / self._rate
                if self.ended.wait((due_ns - time.monotonic_ns()) / SECOND):
                    return count
                publisher = self._publishers_of[file.channels[message.channel_id].topic]
                publisher.publish(message.data)
                if self._ghost is not None and publisher.topic_name == self._joint_states:
                    self._ghost.follow(message.data)
                count += 1
        return count


main = partial(run, Player)
