# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``exciter``: makes the rig move by the paper's pulse train, one torque for every sample that the bridge publishes."""

import math
import time
from dataclasses import fields
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from pendubot_identification.excitation.excitation import PulseTrain
from pendubot_identification.setting import Setting

from .ownership import Driver, name_rivals
from .runtime import SettingsNode, run

#: A longer gap between two joint states [s] ends the excitation: nobody was watching the rig, or nobody moved it.
SILENCE = 2.0
#: All programs are discovered within this [s], and the first joint state is here; Fast DDS announces every 3 s.
DISCOVERY = 4.0
#: Without an answer for this long [s] it asks to be armed once more.
PATIENCE = 3.0
#: A recorder reports once a second; without a report for this long [s] it is taken for gone.
UNRECORDED = 5.0


class Exciter(SettingsNode):
    """Arms, excites for the duration, and ends with zero torque and disarmed, however it ends."""

    PROGRAM = 'exciter'
    SUMMARY = (
        'Publishes a train of random torque pulses on pendubot/effort_command, one torque for every message on '
        'joint_states. At the end, and on SIGINT or SIGTERM, it commands zero torque and disarms the bridge.'
    )
    SETTINGS = (
        Setting('period', 1.0, 'time from one pulse to the next', 's', 0.01, 3600.0),
        Setting('width', 0.05, 'length of a pulse as a fraction of the period (the paper: 0.05)', '', 1e-3, 1.0),
        Setting('amplitude_min', -1.0, 'least torque within a pulse', 'N m', -1000.0, 1000.0),
        Setting('amplitude_max', 1.0, 'greatest torque within a pulse', 'N m', -1000.0, 1000.0),
        Setting('hold', 0.01, 'time for which each random torque is held', 's', 1e-4, 60.0),
        Setting('seed', 1, 'same seed, same torques', '', 0, 2**31 - 1),
        Setting('duration', 18.0, 'length of the excitation; 0: until stopped', 's', 0.0, 86400.0),
        Setting('arm', False, 'whether it arms the bridge itself; otherwise it waits until you call bridge/arm'),
        Setting('recorded', False, 'whether it moves the rig only while a recorder records its joint states'),
    )

    def _open(self, s: dict[str, Any]) -> None:
        self._pulses, self._duration, self._arms = _pulses(s), s['duration'] or math.inf, s['arm']
        # Times [s] by the monotonic clock: of the start, the last request to arm, the beginning of the motion, the last
        # joint state, and the end of the time in which a recorder is known to record.
        self._born, self._asked, self._since, self._heard = time.monotonic(), -math.inf, -math.inf, -math.inf
        self._recorded = -math.inf if s['recorded'] else math.inf
        self._running = False
        # Stamps [s] of the first joint state of the motion and of the last one.
        self._start: float | None = None
        self._stamp = 0.0
        self._armed: bool | None = None
        self._disarmed = 0  # how many reports in a row say that the bridge is not armed
        self._driver = Driver(self)
        self._joint_states = self.create_subscription(JointState, 'joint_states', self._on_joint_state, 100)
        self.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 10)
        self.create_timer(0.1, self._supervise)

    def _check(self, s: dict[str, Any]) -> None:
        _pulses(s)

    def _close(self) -> None:
        """Command zero torque and disarm, unless it never drove."""
        self._running = False
        if self._asked > 0 or self._start is not None:
            self._driver.let_go_and_wait()

    def _on_joint_state(self, message: JointState) -> None:
        stamp = message.header.stamp.sec + message.header.stamp.nanosec * 1e-9
        fault = (name_rivals(self, self._joint_states, wait=True) or self._silence(stamp)) if self._running else ''
        self._heard, self._stamp = time.monotonic(), stamp
        if fault:
            self._give_up(fault)
        elif not self._running:
            # Discarded while disarmed; from the moment of arming on, the bridge is not left without a command.
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
        """Return a sentence if the time since the last joint state, or to this ``stamp`` [s], is too long, else ''."""
        gap = time.monotonic() - max(self._since, self._heard)
        if stamp is not None and self._start is not None:
            gap = max(gap, abs(stamp - self._stamp))
        if gap <= (DISCOVERY if math.isinf(self._heard) else SILENCE):
            return ''
        return f'stopped: no joint states for {gap:.1f} s; look at the bridge, or whether this program was held up'

    def _on_diagnostics(self, array: DiagnosticArray) -> None:
        """Follow whether the bridge is armed, whoever armed it, and whether a recorder writes."""
        for status in array.status:
            if self.ended.is_set():
                return
            values = {value.key: value.value for value in status.values}
            # By a recorder; before it hears the topic it is 0.
            if float(values.get(f'{self._joint_states.topic_name} rate [Hz]', 0.0)) > 0.0:
                self._recorded = max(self._recorded, time.monotonic() + UNRECORDED)
            if status.name == self._driver.bridge.lstrip('/') and 'armed' in values:
                self._armed = values['armed'] == 'True'
                # A report that was under way when the motor was armed may still say the contrary.
                self._disarmed = 0 if self._armed else self._disarmed + 1
                if self._running and self._disarmed > 1:
                    self._give_up(f'stopped, for the bridge is no longer armed: {status.message}')
                elif self._armed:
                    self._begin()

    def _supervise(self) -> None:
        """Arm, if that is wanted, once joint states come in; give up when they no longer do, or a rival comes."""
        if self.ended.is_set():
            return
        if rivals := self._driver.rivals() or name_rivals(self, self._joint_states, wait=True):
            self._give_up(rivals)
            return
        now, driver = time.monotonic(), self._driver
        if self._armed is False or now - self._born >= DISCOVERY:
            # A motor that is armed may be driven by a program that was not found yet; a second would disarm it.
            driver.begin()
        if self._running:
            if silence := self._silence():
                self._give_up(silence)
            elif now > self._recorded:
                self._give_up(f'stopped: nothing was recorded for {UNRECORDED:g} s; look at the recorder')
        elif missing := self._missing(now):
            self.get_logger().info(missing, throttle_duration_sec=5.0)
        # An answer may be lost where both sides have only just met, so it asks again.
        elif now - self._asked > PATIENCE and driver.publisher is not None and driver.arm.service_is_ready():
            self._asked = now
            driver.arm.call_async(Trigger.Request()).add_done_callback(self._on_armed)

    def _missing(self, now: float) -> str:
        """Return a sentence on the missing condition for arming, else ''."""
        name, bridge = self._joint_states.topic_name, self._driver.bridge
        if now - self._heard > SILENCE:
            return f'waiting for {name}: start the bridge'
        if now - self._born >= DISCOVERY and not self._driver.arm.service_is_ready():
            return (
                f'waiting for {bridge}/arm, which nobody serves: start the bridge or, if its node has another name, '
                'remap bridge/arm and bridge/disarm'
            )
        if self._driver.publisher is not None and not self._driver.is_heard():
            return f'waiting: {self._driver.deaf()}'
        if now > self._recorded:
            return f'waiting for a recorder of {name}: start it'
        return '' if self._arms else f'waiting to be armed: call {bridge}/arm'

    def _begin(self) -> None:
        """Excite from the next sample on, unless others may still be found to drive, or nothing records it."""
        now = time.monotonic()
        if not (self._running or self.ended.is_set() or now > self._recorded) and self._driver.is_heard():
            self._running, self._since = True, now

    def _on_armed(self, future: Future) -> None:
        response = future.result()
        if response.success:
            self._begin()
        else:
            self._give_up(f'the bridge did not arm: {response.message}')

    def _give_up(self, sentence: str) -> None:
        self.get_logger().error(sentence)
        self._running = False
        self.end(1)


def _pulses(values: dict[str, Any]) -> PulseTrain:
    return PulseTrain(**{each.name: values[each.name] for each in fields(PulseTrain)})


main = partial(run, Exciter)
