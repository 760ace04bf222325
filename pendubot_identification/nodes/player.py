"""``player``: publishes what is in a bag again, at its own pace."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from rclpy.duration import Duration
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

from pendubot_identification.errors import ParameterError, PendubotError
from pendubot_identification.recordings.pace import Pace
from pendubot_identification.recordings.playback import Playback

from .ending import Ending
from .matching import check_names, message_class
from .presence import CommandGuard
from .runtime import Setting, SettingsNode, run

SECOND = 1_000_000_000
DEPTH = 1000  #: Messages kept for subscribers that are slow, or that have to be sent again.
DELIVERY = 2.0  #: For so long the last messages may be on their way at the end [s].


class Player(SettingsNode):
    """A thread publishes when a message is due; another publishes the clock; the executor serves pause and rate."""

    PROGRAM = 'player'
    SUMMARY = (
        "Publishes a bag's messages byte for byte, on the topics, with the quality of service and at the pace at which "
        'they were recorded. ~/pause and ~/resume (std_srvs/Trigger) stop and go on; rate may be set meanwhile. With a '
        'clock, nodes with use_sim_time see the time of the recording. Ends at the end of the bag. Effort commands are '
        'not played to a bridge, unless topics names them.'
    )
    SETTINGS = (
        Setting('bag', '', 'the bag: a folder or a .mcap file, closed or not'),
        Setting('topics', [''], 'the topics to play; one empty name: all'),
        Setting('rate', 1.0, 'how many times as fast as recorded', '', 0.001, 1000.0, dynamic=True),
        Setting('start', 0.0, "where to begin, from the bag's first message on", 's', 0.0, 1e9),
        Setting('duration', 0.0, 'how much of the bag to play; 0: to its end', 's', 0.0, 1e9),
        Setting('loop', False, 'begin again at the end'),
        Setting('paused', False, 'wait for ~/resume before the first message'),
        Setting('clock', 0.0, "how often the recording's time is published on /clock; 0: not", 'Hz', 0.0, 1000.0),
        Setting('wait', 0.0, 'wait at most so long until somebody subscribes to every topic', 's', 0.0, 3600.0),
    )

    def __init__(self, ended: Ending) -> None:
        super().__init__(ended)
        s = self.settings()
        # Names in a bag: in this node's namespace if they are relative, but not remapped.
        asked = [self.resolve_topic_name(name, only_expand=True) for name in s['topics'] if name]
        self._playback = Playback(Path(s['bag']), asked)
        self._start_ns = self._playback.first_ns + round(s['start'] * SECOND)
        if self._start_ns > self._playback.last_ns:
            length = (self._playback.last_ns - self._playback.first_ns) / SECOND
            raise ParameterError(f'start is {s["start"]:g} s; the bag lasts {length:.3f} s: give a time within it')
        self._end_ns = self._start_ns + round(s['duration'] * SECOND) if s['duration'] else self._playback.last_ns + 1
        self._loop: bool = s['loop']
        self._wait: float = s['wait']
        self._failure: PendubotError | None = None
        # Woken whenever something is due at another time than it was.
        self._changed = threading.Condition()
        self._pace = Pace(self._start_ns, s['rate'], time.monotonic_ns())
        self._pace.pause(s['paused'], time.monotonic_ns())
        self._publishers_of: dict[str, Publisher] = {
            topic.name: self.create_publisher(
                message_class(topic.name, topic.type_name),
                topic.name,
                QoSProfile(
                    depth=DEPTH,
                    reliability=ReliabilityPolicy[topic.qos.reliability.upper()],
                    durability=DurabilityPolicy[topic.qos.durability.upper()],
                ),
            )
            for topic in self._playback.topics
        }
        # Torques of a recording must move no rig: to a bridge they are played only where they are asked for by name.
        unasked = [publisher for name, publisher in self._publishers_of.items() if name not in asked]
        self._guard = CommandGuard(self, unasked)
        for name in ('pause', 'resume'):
            self.create_service(Trigger, f'~/{name}', partial(self._serve, name == 'pause'))
        self.add_post_set_parameters_callback(lambda changed: self._follow({p.name: p.value for p in changed}))
        if self._playback.note:
            self.get_logger().warning(self._playback.note)
        self._clock_rate: float = s['clock']
        # Not _clock, which is the node's own.
        self._times = self.create_publisher(Clock, '/clock', 10) if self._clock_rate else None
        self._threads: list[threading.Thread] = []
        self._begin(self._play)

    def check(self, values: dict[str, Any]) -> None:
        """Refuse a bag without a name and topics without one."""
        if not values['bag']:
            raise ParameterError('bag is empty; give the folder of a bag')
        check_names([name for name in values['topics'] if name])

    def close(self) -> None:
        """Stop playing.

        Raises:
            PendubotError: the bag could not be read to its end.
        """
        self.ended.set()
        self._alter(lambda: None)
        for thread in list(self._threads):
            thread.join(DELIVERY + 1.0)
        if self._failure is not None:
            raise self._failure

    def _begin(self, work: Callable[[], None]) -> None:
        self._threads.append(threading.Thread(target=work, daemon=True))
        self._threads[-1].start()

    def _play(self) -> None:
        try:
            self._await_subscribers()
            self._guard.look_around(self.ended)
            self.get_logger().info(f'playing {", ".join(self._publishers_of)}')
            self._alter(lambda: self._pace.jump(self._start_ns, time.monotonic_ns()))
            if self._times is not None:
                self._begin(self._tick)
            count = self._play_once()
            while self._loop and not self.ended.is_set():
                count += self._play_once()
            for publisher in self._publishers_of.values():
                publisher.wait_for_all_acked(Duration(seconds=DELIVERY))
            self.get_logger().info(f'{count} messages played')
        except PendubotError as error:
            self._failure = error
        self.end(1 if self._failure else 0)

    def _play_once(self) -> int:
        """Play from start to end, or to the end of the program; return how many messages were published."""
        self._alter(lambda: self._pace.jump(self._start_ns, time.monotonic_ns()))
        count = 0
        for log_ns, topic, data in self._playback.messages(self._start_ns, self._end_ns):
            if not self._await(log_ns):
                return count
            publisher = self._publishers_of[topic]
            self._guard.check(publisher)
            publisher.publish(data)
            count += 1
        # What comes after the last message is part of a duration, too.
        self._await(min(self._end_ns, self._playback.last_ns + 1))
        return count

    def _await(self, log_ns: int) -> bool:
        """Wait until a time of the recording is due; return False when the program ends instead."""
        with self._changed:
            while not self.ended.is_set():
                seconds = self._pace.wait(log_ns, time.monotonic_ns())
                if not seconds:
                    return True
                self._changed.wait(None if math.isinf(seconds) else seconds)
        return False

    def _await_subscribers(self) -> None:
        deadline = time.monotonic() + self._wait
        while not all(publisher.get_subscription_count() for publisher in self._publishers_of.values()):
            if time.monotonic() >= deadline or self.ended.wait(0.02):
                return

    def _tick(self) -> None:
        assert self._times is not None
        message = Clock()
        while not self.ended.is_set():
            with self._changed:
                position = self._pace.position(time.monotonic_ns())
            message.clock.sec, message.clock.nanosec = divmod(min(position, self._end_ns), SECOND)
            self._times.publish(message)
            self.ended.wait(1 / self._clock_rate)

    def _alter(self, action: Callable[[], None]) -> None:
        with self._changed:
            action()
            self._changed.notify_all()

    def _follow(self, changed: dict[str, Any]) -> None:
        if (rate := changed.get('rate')) is not None:
            self._alter(lambda: self._pace.set_rate(rate, time.monotonic_ns()))

    def _serve(self, paused: bool, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._alter(lambda: self._pace.pause(paused, time.monotonic_ns()))
        response.success, response.message = True, 'paused' if paused else 'playing'
        return response


def main() -> int:
    """Run the player; return the exit status."""
    return run(Player)


if __name__ == '__main__':
    raise SystemExit(main())
