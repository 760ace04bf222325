# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``bridge``: publishes the board's samples on ``joint_states``, and sends effort commands to the board."""

import gc
import math
import secrets
import threading
import time
from collections.abc import Callable
from dataclasses import fields
from functools import partial
from typing import Any

from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from pendubot_identification.errors import ParameterError
from pendubot_identification.level import Level
from pendubot_identification.link.events import ArmingEnded, HostConfig, Report, Sample
from pendubot_identification.link.health import Health
from pendubot_identification.link.host import Host
from pendubot_identification.link.motor import ARMING_TIMEOUT, UNCONFIRMED
from pendubot_identification.link.serial_port import SerialPort
from pendubot_identification.setting import Setting
from pendubot_identification.trajectories.conventions import current_name

from .messages import Status, shoulder_effort
from .ownership import EFFORT_COMMAND, JOINT_COMMANDS, name_others, name_rivals
from .runtime import AUTOSTART, JOINTS, ManagedNode, explained, run

#: Smallest step of the computer's clock that is reported [s].
CLOCK_TOLERANCE = 0.05


class CommandAge:
    """Estimates the age of commands from their times of transmission and reception.

    The difference of these two times is the offset between two clocks plus a latency, which is never negative. Its
    minimum over the last commands is therefore the offset plus the least latency; the age is the excess over it.
    """

    #: The minimum covers this period and the previous one [ns], which bounds the effect of a step of the clock.
    PERIOD = 5_000_000_000

    def __init__(self) -> None:
        self._least = self._least_before = math.inf
        self._since = 0

    def measure(self, sent_ns: int, taken_ns: int) -> float:
        """Return the age of a command [s]; each time [ns] is on its own program's clock."""
        delay = taken_ns - sent_ns
        if not 0 <= taken_ns - self._since < self.PERIOD:
            self._least_before, self._least, self._since = self._least, delay, taken_ns
        self._least = min(self._least, delay)
        return (delay - min(self._least, self._least_before)) * 1e-9


class Bridge(ManagedNode):
    """The node between the board and ROS. Three threads share one :class:`Host` under a lock: the port's reader, which
    also publishes the samples; a timer, for timeouts; and the executor, for commands and services.
    """

    PROGRAM = 'bridge'
    SUMMARY = (
        "Publishes the board's samples as joint_states, stamped with the board's sampling time. After ~/arm it sends "
        'the torques on pendubot/effort_command or pendubot/joint_commands to the board. It waits for the port, and '
        'reopens a lost port.'
    )
    SETTINGS = (
        Setting('port', '/dev/pendubot', "the board's serial port: a path or a pyserial URL", path=True),
        Setting('baud', 921600, 'speed of the port', 'bit/s', 1200, 12_000_000),
        JOINTS,
        Setting('sign', [1, 1], "1 or -1 for each joint: direction of its encoder's counts", '', -1, 1, length=2),
        Setting('zero', [-math.pi / 2, 0.0], 'position of each joint at count 0', 'rad', -7.0, 7.0, length=2),
        Setting('counts_per_turn', [0, 0], "of each encoder; 0: the board's value", 'counts', 0, 1 << 31, length=2),
        Setting('torque_limit', 2.0, 'largest torque sent; raised only while disarmed', 'N m', 0.0, 1e3, dynamic=True),
        Setting('watchdog_ms', 100, 'time without a command until the board stops its motor', 'ms', 10, 65535),
        Setting('command_timeout', 0.1, 'time without an effort command until the torque is 0', 's', 0.001, 3600.0),
        Setting('link_timeout', 0.1, 'time without a valid frame until the link is lost: disarmed', 's', 0.01, 60.0),
        Setting('max_speed', 100.0, 'largest joint speed; faster samples are dropped and disarm', 'rad/s', 0.1, 1e6),
        Setting('max_travel', [0.0, 0.0], "largest angle from count 0; 0: the board's", 'rad', 0.0, 1e4, length=2),
        Setting('confirm_zeros', True, 'whether ~/confirm_zeros has to be called once after every start of the board'),
        AUTOSTART,
    )

    def _open(self, s: dict[str, Any]) -> None:
        frozen: dict[str, Any] = {name: tuple(v) if isinstance(v, list) else v for name, v in s.items()}
        config = HostConfig(**{each.name: frozen[each.name] for each in fields(HostConfig)})
        self._host = Host(config, new_session=lambda: 1 + secrets.randbelow((1 << 32) - 1))
        self._lock = threading.Lock()
        self._pause = 0.0  # until the next check of timeouts [s]
        self._arming: list[Future] = []
        self._disarming: list[tuple[Future, int]] = []  # calls of ~/disarm and their deadlines [ns]
        self._health = Health()
        # Offset from the monotonic clock to ROS time, constant even if the system's clock is set later.
        self._epoch_ns = time.time_ns() - time.monotonic_ns()
        names = [*s['joint_names'], current_name(s['joint_names'][0])]
        # One message object for all samples, because its construction takes longer than all other work on a sample.
        self._message = JointState(name=names, position=[0.0] * 3, velocity=[0.0] * 3, effort=[0.0] * 3)
        self._joint_states = self.create_publisher(JointState, 'joint_states', 1000)
        Status(self, self._diagnosis, rig=s['port'])
        self._shoulder = s['joint_names'][0]
        self._commands = (
            self.create_subscription(Float64, EFFORT_COMMAND, self._on_effort, 1),
            self.create_subscription(JointState, JOINT_COMMANDS, self._on_joint_command, 1),
        )
        self._command_timeout, self._command_age = s['command_timeout'], CommandAge()
        self._stale = 0
        self._logged_rivals = ''  # the last logged sentence about rivals
        # Arming takes time: effort commands are discarded during it, not queued.
        self.serve('~/arm', self._on_arm)
        self.serve('~/disarm', self._on_disarm)
        self.serve('~/confirm_zeros', self._on_confirm_zeros)
        self._link = SerialPort(
            s['port'],
            s['baud'],
            on_bytes=lambda data, arrival: self._step(lambda now: self._host.receive(data, now), arrival),
            on_opened=lambda: self._step(self._host.opened),
            on_closed=lambda reason: self._step(lambda now: self._host.closed(reason, now)),
        )
        self._closing = threading.Event()
        self._timer_thread = threading.Thread(target=self._check_timeouts, name='timeouts', daemon=True)
        # Exclude the present, permanent objects from garbage collection, which would delay samples by tens of ms.
        gc.freeze()
        self._link.start()
        self._timer_thread.start()

    def _check(self, s: dict[str, Any]) -> None:
        if 0 in s['sign']:
            raise ParameterError('sign holds a 0; 1 or -1 is expected for each joint')
        if not s['port']:
            raise ParameterError('port is empty; set it to a path or a pyserial URL')
        if self.opened and self._host.armed and s['torque_limit'] > (limit := self._host.motor.torque_limit):
            raise ParameterError(
                f'torque_limit is {limit:g} N m, and is not raised while the motor is armed; call ~/disarm first'
            )

    def _change(self, s: dict[str, Any]) -> None:
        if self.opened:
            self._step(partial(self._host.motor.set_torque_limit, s['torque_limit']))

    def _deactivate(self) -> None:
        """Disarm; an inactive bridge neither arms nor publishes joint states."""
        self._step(self._host.motor.disarm)

    def _close(self) -> None:
        """Disarm the board and close the port."""
        self._closing.set()
        self._step(self._host.motor.disarm)
        self._timer_thread.join(2.0)
        self._link.close()

    def _step(self, action: Callable[[int], object], now: int | None = None) -> None:
        """Execute an action of the host, from any thread; a failure ends the program, which disarms."""
        try:
            with self._lock:
                action(time.monotonic_ns() if now is None else now)
                if data := self._host.output.take_data():
                    self._link.write(data)
                if self._disarming:
                    self._answer_disarming(time.monotonic_ns())
                for event in (events := self._host.output.take_events()):
                    # Under the lock, so that the threads' reports and answers keep their order.
                    if isinstance(event, Report):
                        self._health.note(event)
                        self.log(event.level, event.text)
                    elif isinstance(event, ArmingEnded):
                        while self._arming:
                            self.answer(self._arming.pop(), event)
            for event in events:
                if isinstance(event, Sample) and self.active:
                    self._publish(event)
        except Exception as error:
            if not self.ended.is_set():
                self.get_logger().fatal(f'{explained(error)}; ending')
                self.end(1)

    def _publish(self, sample: Sample) -> None:
        """Publish a sample: shoulder, elbow, and the measured motor current [A] as the effort of a third entry."""
        m = self._message
        m.header.stamp.sec, m.header.stamp.nanosec = divmod(sample.stamp_ns + self._epoch_ns, 10**9)
        m.position[0], m.position[1] = sample.q
        m.velocity[0], m.velocity[1] = sample.qd
        m.effort[0], m.effort[2] = sample.effort, sample.current
        self._joint_states.publish(m)

    def _check_timeouts(self) -> None:
        while not self._closing.wait(self._pause):
            self._step(self._poll)

    def _poll(self, now: int) -> None:
        self._disarm_if_contested(now)
        self._host.poll(now)
        self._pause = self._host.motor.next_poll(now) * 1e-9

    def _diagnosis(self) -> tuple[Level, str, dict[str, Any]]:
        with self._lock:
            # For example a computer that receives the time after its start: other programs' stamps then differ.
            set_by = (time.time_ns() - time.monotonic_ns() - self._epoch_ns) / 1e9
            if abs(set_by) > CLOCK_TOLERANCE:
                text = f"the computer's clock was set by {set_by:+.2f} s: stamps keep the old time; restart the bridge"
                self._health.note(Report(Level.WARN, text))
                self.get_logger().warning(text, once=True)
            if rivals := name_rivals(self, *self._commands):
                self._health.note(Report(Level.ERROR, rivals))
                if rivals != self._logged_rivals:
                    # Logged again, because their names may become known later.
                    self.get_logger().error(rivals)
            self._logged_rivals = rivals
            level, message, values = self._health.diagnose(self._host, time.monotonic_ns())
        return level, message, values | {'stale': self._stale}

    def _disarm_if_contested(self, now: int) -> None:
        """Disarm an armed motor, or stop arming it, if there are several publishers of effort commands."""
        if (self._host.armed or self._arming) and (rivals := name_rivals(self, *self._commands)):
            self._host.output.emit(ArmingEnded(rivals))
            if rivals != self._logged_rivals:  # a diagnosis may have come first
                self._host.output.report(Level.ERROR, rivals)
            self._logged_rivals = rivals
            self._host.motor.stop('a second publisher of effort commands appeared', now)

    def _on_effort(self, message: Float64, info: dict[str, Any]) -> None:
        self._step(lambda now: self._effort(message.data, info['source_timestamp'], now))

    def _on_joint_command(self, message: JointState, info: dict[str, Any]) -> None:
        """Use the shoulder's effort; ignore a NaN, which ros2_control sends before a controller is active."""
        try:
            torque = shoulder_effort(message, self._shoulder)
        except ParameterError as error:
            self.get_logger().error(f'{JOINT_COMMANDS} was ignored: {error}', throttle_duration_sec=1.0)
            return
        if not math.isnan(torque):
            self._step(lambda now: self._effort(torque, info['source_timestamp'], now))

    def _effort(self, torque: float, sent_ns: int, now: int) -> None:
        """Pass a torque [N m] to the host unless it is too old, for example after a pause of this program."""
        self._disarm_if_contested(now)
        age = self._command_age.measure(sent_ns, time.time_ns())
        if age <= self._command_timeout:
            self._host.motor.effort(torque, now)
            return
        self._stale += 1
        text = f'an effort command was {age:.2f} s old and was not applied; '
        text += f'at most {self._command_timeout:g} s (command_timeout) are allowed'
        self._host.output.report_new('stale', now, Level.WARN, text)

    async def _on_arm(self) -> tuple[bool, str]:
        future = Future()
        self._step(lambda now: self._arm(future, now))
        outcome: ArmingEnded = await future
        message = outcome.reason or 'armed'
        self.get_logger().info(f'arming: {message}')
        return not outcome.reason, message

    def _arm(self, future: Future, now: int) -> None:
        self._arming.append(future)
        # The same call would arm another bridge of this name, and the same torques would drive it.
        obstacle = name_rivals(self, *self._commands) or name_others(self, self._joint_states)
        if not self.active:
            obstacle = f'the bridge is inactive; call ros2 lifecycle set {self.get_fully_qualified_name()} activate'
        # Not during shutdown: the last message to the board has to be the disarm.
        obstacle = 'the bridge is ending' if self.ended.is_set() else obstacle
        if obstacle:
            self._host.output.emit(ArmingEnded(obstacle))
            self._host.motor.disarm(now)
        else:
            self._host.arm(now)

    async def _on_disarm(self) -> tuple[bool, str]:
        future = Future()
        self._step(lambda now: self._disarm(future, now))
        answer: tuple[bool, str] = await future
        return answer

    def _disarm(self, future: Future, now: int) -> None:
        self._host.motor.disarm(now)
        self._disarming.append((future, now + ARMING_TIMEOUT))

    def _answer_disarming(self, now: int) -> None:
        """Answer the calls of ~/disarm once the board has confirmed that it is disarmed, or does not."""
        if self._host.link != 'up':
            answer = False, f'no board to disarm: {self._host.condition(now).text}'
        elif not self._host.motor.disarming:
            answer = True, 'disarmed'
        elif now >= self._disarming[0][1]:
            answer = False, UNCONFIRMED
        else:
            return
        self.answer(self._disarming.pop(0)[0], answer)

    async def _on_confirm_zeros(self) -> tuple[bool, str]:
        if others := name_others(self, self._joint_states):
            return False, others
        with self._lock:
            confirmed, message = self._host.confirm_zeros(time.monotonic_ns())
            self._link.write(self._host.output.take_data())
        self.get_logger().info(f'zeros: {message}')
        return confirmed, message


main = partial(run, Bridge)
