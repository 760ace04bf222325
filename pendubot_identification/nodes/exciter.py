# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``exciter``: moves the rig with the paper's pulse train, one torque for every sample of the bridge."""

import math
import time
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from pendubot_identification.excitation import excitation
from pendubot_identification.level import number
from pendubot_identification.setting import Setting

from .ownership import Driver, name_rivals
from .runtime import SettingsNode, run

#: Longest gap between two joint states [s]; a longer gap ends the excitation, because nothing observed the rig.
SILENCE = 2.0
#: Time for the discovery of all programs and the first joint state [s]; Fast DDS announces every 3 s.
DISCOVERY = 4.0
#: Time without an answer after which the request to arm is repeated [s].
PATIENCE = 3.0
#: Time without a report after which a recorder, which reports once a second, counts as ended [s].
UNRECORDED = 5.0


class Exciter(SettingsNode):
    """Arms the bridge, excites the rig for the duration, and always ends with zero torque and disarmed."""

    PROGRAM = 'exciter'
    SUMMARY = (
        'Publishes a train of random torque pulses on pendubot/effort_command, one torque for every message on '
        'joint_states. At the end, and on SIGINT or SIGTERM, it commands zero torque and disarms the bridge.'
    )
    SETTINGS = (
        *excitation.SETTINGS,
        excitation.DURATION,
        Setting('arm', False, 'whether it arms the bridge itself; otherwise it waits until you call bridge/arm'),
        Setting('recorded', False, 'whether it moves the rig only while a recorder records its joint states'),
    )

    def _open(self, s: dict[str, Any]) -> None:
        self._pulses, self._duration, self._arms = _pulses(s), s['duration'] or math.inf, s['arm']
        self._pulses.torque(0.0)  # imports parts of numpy, which would delay the first torque of an armed motor
        # Times on the monotonic clock [s]: start of the program, last request to arm, start of the motion, last joint
        # state, and expiry of the last recorder's report.
        self._started, self._requested, self._since, self._arrived = time.monotonic(), -math.inf, -math.inf, -math.inf
        self._recorded_until = -math.inf if s['recorded'] else math.inf
        self._running = False
        # Stamps [s] of the first joint state of the motion and of the last one.
        self._start: float | None = None
        self._stamp = 0.0
        self._armed: bool | None = None
        self._disarmed = 0  # number of consecutive reports of a disarmed bridge
        self._driver = Driver(self)
        self._joint_states = self.create_subscription(JointState, 'joint_states', self._on_joint_state, 100)
        self.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 10)
        self.create_timer(0.1, self._supervise)

    def _check(self, s: dict[str, Any]) -> None:
        _pulses(s)

    def _close(self) -> None:
        """Command zero torque and disarm, if it requested arming or moved the rig."""
        self._running = False
        if self._requested > 0 or self._start is not None:
            self._driver.release_and_wait()

    def _on_joint_state(self, message: JointState) -> None:
        stamp = message.header.stamp.sec + message.header.stamp.nanosec * 1e-9
        fault = (name_rivals(self, self._joint_states, wait=True) or self._silence(stamp)) if self._running else ''
        self._arrived, self._stamp = time.monotonic(), stamp
        if fault:
            self._abort(fault)
        elif not self._running:
            # The bridge discards it while disarmed; it prevents a command timeout right after arming.
            self._driver.effort(0.0)
        else:
            self._excite(stamp)

    def _excite(self, stamp: float) -> None:
        if self._start is None:
            self._start = stamp
            self.get_logger().info(f'exciting for {self._duration:g} s')
        if stamp - self._start < self._duration:
            self._driver.effort(self._pulses.torque(stamp - self._start))
        else:
            self.get_logger().info('excitation done')
            self._running = False
            self.end()

    def _silence(self, stamp: float | None = None) -> str:
        """Return a sentence if the gap since the last joint state, or up to ``stamp`` [s], is too long, else ''."""
        gap = time.monotonic() - max(self._since, self._arrived)
        if stamp is not None and self._start is not None:
            gap = max(gap, abs(stamp - self._stamp))
        if gap <= (DISCOVERY if math.isinf(self._arrived) else SILENCE):
            return ''
        return f'stopped: no joint states for {gap:.1f} s; check the bridge, or whether this program was delayed'

    def _on_diagnostics(self, array: DiagnosticArray) -> None:
        """Update whether the bridge is armed, by any program, and whether a recorder writes."""
        for status in array.status:
            if self.ended.is_set():
                return
            values = {value.key: value.value for value in status.values}
            # From a recorder; 0 before the recorder receives the topic.
            if number(values.get(f'{self._joint_states.topic_name} rate [Hz]')) > 0.0:
                self._recorded_until = max(self._recorded_until, time.monotonic() + UNRECORDED)
            if status.name == self._driver.bridge.lstrip('/') and 'armed' in values:
                self._armed = values['armed'] == 'True'
                # A report that was in transit at the time of arming may still contain the former state.
                self._disarmed = 0 if self._armed else self._disarmed + 1
                if self._running and self._disarmed > 1:
                    self._abort(f'stopped, because the bridge is no longer armed: {status.message}')
                elif self._armed:
                    self._begin()

    def _supervise(self) -> None:
        """Arm, if requested, as soon as joint states arrive; give up if they stop, or at a second publisher."""
        if self.ended.is_set():
            return
        if rivals := self._driver.rivals() or name_rivals(self, self._joint_states, wait=True):
            self._abort(rivals)
            return
        now, driver = time.monotonic(), self._driver
        if self._armed is False or now - self._started >= DISCOVERY:
            # A program that is not discovered yet may drive an armed motor; a second publisher would disarm it.
            driver.begin()
        if self._running:
            if silence := self._silence():
                self._abort(silence)
            elif now > self._recorded_until:
                self._abort(f'stopped: nothing was recorded for {UNRECORDED:g} s; check the recorder')
        elif missing := self._missing(now):
            self.get_logger().info(missing, throttle_duration_sec=5.0)
        # Repeated, because an answer may be lost right after the discovery.
        elif now - self._requested > PATIENCE and driver.publisher is not None and not driver.unserved():
            self._requested = now
            driver.arm.call_async(Trigger.Request()).add_done_callback(self._on_armed)

    def _missing(self, now: float) -> str:
        """Return a sentence on the missing condition for arming; '' if all are met."""
        name = self._joint_states.topic_name
        if now - self._arrived > SILENCE:
            return f'waiting for {name}: start the bridge'
        if now - self._started >= DISCOVERY and (unserved := self._driver.unserved()):
            return f'waiting: {unserved}'
        if self._driver.publisher is not None and not self._driver.is_received():
            return f'waiting: {self._driver.not_received()}'
        if now > self._recorded_until:
            return f'waiting for a recorder of {name}: start it'
        return '' if self._arms else f'waiting to be armed: call {self._driver.bridge}/arm'

    def _begin(self) -> None:
        """Start the excitation at the next sample, if the bridge receives the commands and a recorder records."""
        now = time.monotonic()
        if not (self._running or self.ended.is_set() or now > self._recorded_until) and self._driver.is_received():
            self._running, self._since = True, now

    def _on_armed(self, future: Future) -> None:
        response = future.result()
        if response.success:
            self._begin()
        else:
            self._abort(f'the bridge did not arm: {response.message}')

    def _abort(self, sentence: str) -> None:
        self.get_logger().error(sentence)
        self._running = False
        self.end(1)


def _pulses(values: dict[str, Any]) -> excitation.PulseTrain:
    return excitation.PulseTrain(**{each.name: values[each.name] for each in excitation.SETTINGS})


main = partial(run, Exciter)
