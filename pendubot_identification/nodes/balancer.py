# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``balancer``: swings the rig up and balances it, with the parameters on pendubot/params as its only model."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.subscription import Subscription
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from pendubot_identification.control.balancing import Balancing, Phase
from pendubot_identification.control.controller import SafetyLimits
from pendubot_identification.control.linear_control import Loop
from pendubot_identification.control.plan import Plan
from pendubot_identification.errors import ControlError, PendubotError
from pendubot_identification.level import Level, number
from pendubot_identification.model.parameters import Parameters
from pendubot_identification.setting import Setting

from .messages import LATCHED, Status, joint_sample
from .ownership import PATIENCE, Driver, name_rivals
from .runtime import JOINTS, SettingsNode, explained, run

#: Longest time from the first message of a new publisher until the publisher is counted [s].
MATCHING = 0.05


class Balancer(SettingsNode):
    """Waits for parameters and samples, designs a controller, and moves the rig from ~/start to ~/stop or a fault.

    :class:`.control.balancing.Balancing` makes the decisions.
    """

    PROGRAM = 'balancer'
    SUMMARY = (
        'Swings the rig up and balances it with the parameters on pendubot/params: one torque on '
        'pendubot/effort_command for every message on joint_states. It arms the bridge at ~/start only, and disarms '
        'at ~/stop and at any fault: late or missing samples, angles or speeds beyond their limits, a motor that '
        'ignores commands, wrong wiring, unphysical parameters.'
    )
    SETTINGS = (
        JOINTS,
        Setting('torque_limit', 2.0, 'largest commanded torque, within the limit of the bridge', 'N m', 1e-3, 1e3),
        Setting('accept_warn', False, 'whether parameters of level WARN, or without a level, are used', dynamic=True),
        Setting('motor_delay', -1.0, 'delay of the motor; -1: as identified', 's', -1.0, 0.5),
        Setting('swing_up_time', 30.0, 'longest swing-up; 0: it only balances a rig near upright', 's', 0.0, 1e4),
        Setting('max_shoulder', 6.0, 'largest deviation of link 1 from upright; hanging is 3.14', 'rad', 0.1, 100.0),
        Setting('max_elbow', 40.0, 'largest angle of the elbow', 'rad', 0.1, 1e3),
        Setting('max_speed', 60.0, 'largest joint speed', 'rad/s', 0.1, 1e4),
        Setting('max_age', 0.1, 'largest age of a sample, and longest time without one', 's', 0.001, 10.0),
    )

    def _open(self, s: dict[str, Any]) -> None:
        self._names = s['joint_names']
        limits = SafetyLimits(s['max_shoulder'], s['max_elbow'], s['max_speed'], s['max_age'], s['swing_up_time'])
        self._balancing = Balancing(s['torque_limit'], None if s['motor_delay'] < 0 else s['motor_delay'], limits)
        self._worker = threading.Thread()
        self._designed: tuple[tuple[Parameters, Loop], Plan | str] | None = None  # result of the worker
        self._driver = Driver(self)
        self._started = Future()  # the answer to ~/start
        # Only the newest sample: a torque for an older sample would be late.
        self._samples = self.create_subscription(JointState, 'joint_states', self._on_sample, 1)
        self._identified: list[Subscription] = []
        self._newest: tuple[list[float], float] | None = None  # parameters and their arrival [s]
        self._subscribe_parameters()
        self.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 10)
        self.serve('~/start', self._on_start)
        self.serve('~/stop', self._on_stop)
        self.create_timer(min(0.05, s['max_age'] / 2), self._supervise)
        Status(self, self._diagnosis)

    def _close(self) -> None:
        """Command zero torque and disarm; wait at most a second for the answer of the bridge."""
        if self._balancing.phase is not Phase.IDLE:
            self._balancing.stop()
            self._driver.release_and_wait()

    def _subscribe_parameters(self) -> None:
        """Subscribe to the parameters and their quality, or resubscribe to receive the latched messages again."""
        for subscription in self._identified:
            self.destroy_subscription(subscription)
        self._missed = False
        self._identified = [
            self.create_subscription(Float64MultiArray, 'pendubot/params', self._on_params, LATCHED),
            self.create_subscription(DiagnosticArray, 'pendubot/identification', self._on_identification, LATCHED),
        ]

    def _on_sample(self, m: JointState) -> None:
        with self._stopping_on_error():
            self._refuse_second_rig()
            stamp, q, effort = joint_sample(m, self._names)
            age = self.get_clock().now().nanoseconds * 1e-9 - stamp
            torque = self._balancing.sample(stamp, age, time.monotonic(), q, effort)
            if torque is not None:
                self._driver.effort(torque)

    def _on_params(self, m: Float64MultiArray) -> None:
        self._newest = list(m.data), time.monotonic()

    def _take_parameters(self) -> None:
        """Use the newest parameters after the time in which a new publisher is counted."""
        if self._newest is not None and time.monotonic() - self._newest[1] >= MATCHING:
            values, self._newest = self._newest[0], None
            if self._has_one_publisher(self._identified[0]):
                self._balancing.readiness.offer(values)

    def _on_identification(self, array: DiagnosticArray) -> None:
        if self._has_one_publisher(self._identified[1]):
            for status in array.status:
                values = {pair.key: pair.value for pair in status.values}
                self._balancing.readiness.assess(Level(min(2, status.level[0])), status.message, values)

    def _has_one_publisher(self, subscription: Subscription) -> bool:
        """Return whether a topic has one publisher; otherwise log an error, because its message is ignored."""
        if rivals := name_rivals(self, subscription):
            self._missed = True
            self.get_logger().error(f'a message was ignored: {rivals}', throttle_duration_sec=1.0)
        return not rivals

    def _refuse_second_rig(self) -> None:
        """Raise ControlError, which stops the motion, if joint states have a second publisher."""
        if self._balancing.phase is not Phase.IDLE and (rivals := name_rivals(self, self._samples)):
            raise ControlError(rivals)

    def _rivals(self) -> str:
        """Return a sentence that names the publishers of an input with several publishers, else ''."""
        return next(filter(None, (name_rivals(self, each) for each in (self._samples, *self._identified))), '')

    def _on_diagnostics(self, array: DiagnosticArray) -> None:
        for status in array.status:
            values = {pair.key: number(pair.value) for pair in status.values}
            if status.name == self._driver.bridge.lstrip('/') and 'sample period [s]' in values:
                self._balancing.readiness.board_limit = values['torque limit [N m]']
                self._balancing.readiness.period = values['sample period [s]']

    async def _on_start(self) -> tuple[bool, str]:
        if rivals := self._driver.rivals() or self._rivals():
            return False, rivals
        if unserved := self._driver.unserved():
            return False, unserved
        try:
            self._balancing.begin(time.monotonic())
        except PendubotError as error:
            return False, str(error)
        self._driver.begin()
        if not self._driver.is_received(PATIENCE):
            self._balancing.stop()
            return False, self._driver.not_received()
        self._started = Future()
        self._driver.arm.call_async(Trigger.Request()).add_done_callback(self._on_armed)
        answer: tuple[bool, str] = await self._started
        return answer

    def _on_armed(self, future: Future) -> None:
        answer = future.result()
        if self._balancing.phase is not Phase.ARMING:  # it was stopped in the meantime
            self._driver.release()
            return
        if answer.success:
            self._balancing.armed()
            self.get_logger().info('armed and moving')
        else:
            self._balancing.stop()
        self.answer(self._started, (answer.success, f'bridge: {answer.message}'))

    async def _on_stop(self) -> tuple[bool, str]:
        self._stop()
        return True, 'stopped; the bridge is requested to disarm'

    def _stop(self, reason: str = '') -> None:
        """Command zero torque, disarm, and answer ~/start if it is still waiting."""
        self._balancing.stop(reason)
        self._driver.release()
        self.answer(self._started, (False, reason or 'it was stopped in the meantime'))

    def _supervise(self) -> None:
        """Detect missing samples, design for new parameters in a separate thread, and publish no torque while idle."""
        # While the program ends, _close() still needs the publisher.
        if self._balancing.phase is Phase.IDLE and not self.ended.is_set():
            self._driver.end()
            if self._missed and not self._rivals():
                self._subscribe_parameters()
        with self._stopping_on_error():
            self._refuse_second_rig()
            self._take_parameters()
            self._balancing.silence(time.monotonic())
        if not self._worker.is_alive():
            self._take_design()
            before = self._balancing.obstacle
            wanted = self._balancing.to_prepare(self.get_parameter('accept_warn').value)
            if self._balancing.obstacle not in ('', before):
                self.get_logger().warning(f'waiting: {self._balancing.obstacle}')
            if wanted is not None:
                idle = self._balancing.phase is Phase.IDLE
                self._worker = self.compute(self._design, wanted, idle)

    def _design(self, wanted: tuple[Parameters, Loop], idle: bool) -> None:
        try:
            self._designed = wanted, Plan.make(*wanted, simulate_closed_loop=idle)
        except Exception as error:
            self._designed = wanted, explained(error)

    def _take_design(self) -> None:
        """Use the result of the worker, in the thread of all other callbacks."""
        if self._designed is not None:
            (wanted, result), self._designed = self._designed, None
            if isinstance(result, Plan):
                self._balancing.prepared(result)
                self.get_logger().info(f'prepared: {result.summary()}')
            else:
                self._balancing.not_prepared(wanted, result)
                self.get_logger().error(f'the parameters cannot be used: {result}')

    @contextmanager
    def _stopping_on_error(self) -> Iterator[None]:
        """Command zero torque and disarm at any error."""
        moving = self._balancing.phase is not Phase.IDLE
        try:
            yield
        except Exception as error:
            reason = explained(error)
            self.get_logger().error(f'stopped: {reason}', throttle_duration_sec=1.0)
            if moving:
                self._stop(reason)
            else:
                self._balancing.stop(reason)

    def _diagnosis(self) -> tuple[Level, str, dict[str, str]]:
        level, message, values = self._balancing.diagnosis()
        if (rivals := self._rivals()) and rivals not in message:
            return Level.ERROR, f'{message}; {rivals}', values
        return level, message, values


main = partial(run, Balancer)
