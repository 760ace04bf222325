# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The balancer's state machine, without ROS: when to design, start and stop. It never restarts by itself.

At a fault a method raises ControlError; the caller then calls :meth:`Balancing.stop` and disarms.
"""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from pendubot_identification.errors import ControlError
from pendubot_identification.level import Level, number
from pendubot_identification.model.dynamics import Pair
from pendubot_identification.model.parameters import NAMES, Parameters

from .controller import Controller, SafetyLimits
from .linear_control import Loop
from .plan import Plan, deviation


@dataclass(frozen=True, slots=True)
class BalancingSettings:
    """Conditions of a start."""

    patience: float = 3.0  #: Longest wait for the bridge's answer to the arming request [s].
    near: float = 0.3  #: Largest deviation from upright [rad] at which a rig is balanced without a swing-up.


SETTINGS = BalancingSettings()


class Readiness:
    """Collects the inputs of a design, which may arrive in any order.

    ``limit`` is the user's largest torque [N m]. ``motor_delay`` is the delay of the motor behind the board's report
    [s]; None: as identified. ``board_limit`` is the torque limit of bridge and board [N m], and ``period`` the board's
    sampling period [s], None before the bridge has reported it.
    """

    def __init__(self, limit: float, motor_delay: float | None = None) -> None:
        self._limit = limit
        self.board_limit = math.inf
        self._motor_delay = motor_delay
        self._theta: tuple[float, ...] = ()
        self._assessments: deque[tuple[Level, str, Mapping[str, str]]] = deque(maxlen=8)
        self.period: float | None = None

    def offer(self, theta: Sequence[float]) -> Parameters:
        """Store a parameter vector; raise PendubotError if it is unphysical or has a wrong length."""
        parameters = Parameters.from_vector(theta)
        self._theta = tuple(theta)
        if problems := parameters.unphysical():
            raise ControlError(f'the parameters are unphysical: {problems[0]}; identify the rig again')
        return parameters

    def assess(self, level: Level, message: str, values: Mapping[str, str]) -> None:
        """Store the quality of identified parameters; ``values`` are the parameters by name, and ``effort.delay``."""
        self._assessments.append((level, message, values))

    def ready(self, accept_warn: bool) -> tuple[Parameters, Loop]:
        """Return the parameters and the loop; raise ControlError if an input is missing or its quality too low."""
        if not self._theta:
            raise ControlError('no parameters were received on pendubot/params; start the identifier')
        parameters = self.offer(self._theta)
        lag = self._assessed(accept_warn)
        if self.period is None:
            raise ControlError(
                'the bridge has not reported its sample period on /diagnostics; start it or, if its node has another '
                'name, remap bridge/arm and bridge/disarm'
            )
        if not (limit := min(self._limit, self.board_limit)) > 0:
            raise ControlError(f'the bridge limits torques to {limit:g} N m; raise its torque_limit')
        return parameters, Loop(self.period, lag if self._motor_delay is None else self._motor_delay, limit)

    def _assessed(self, accept_warn: bool) -> float:
        """Return the motor delay [s], 0 if unknown; raise ControlError if the quality is too low or unknown."""
        how = 'set the parameter accept_warn to true to use them nevertheless'
        for level, message, values in reversed(self._assessments):
            if tuple(number(values.get(name)) for name in NAMES[: len(self._theta)]) != self._theta:
                continue
            if level is Level.ERROR:
                raise ControlError(f'the parameters are of level ERROR ({message}); record and identify again')
            if level is Level.WARN and not accept_warn:
                raise ControlError(f'the parameters are of level WARN ({message}); {how}')
            delay = number(values.get('effort.delay'))
            return max(0.0, delay) if math.isfinite(delay) else 0.0
        if not accept_warn:
            raise ControlError(
                f'the quality of the parameters on pendubot/params is not on pendubot/identification; {how}'
            )
        return 0.0


class Phase(Enum):
    """Arming state of the motor."""

    IDLE = 'idle'
    ARMING = 'arming'
    RUNNING = 'running'


class Balancing:
    """Requests a plan after the first parameters and samples, and moves the rig from :meth:`armed` to :meth:`stop`.

    Attributes:
        readiness: the parameters, their quality, and the loop; it defines ``limit`` [N m] and ``motor_delay`` [s].
        plan: the plan of the present or next motion, None before the first. While idle, it is a simulated plan.
        obstacle: reason why no motion can start; empty if there is none.
        stopped: reason of the last stop; empty before the first stop, and after a requested stop.
    """

    def __init__(self, limit: float, motor_delay: float | None = None, bounds: SafetyLimits | None = None) -> None:
        self.readiness = Readiness(limit, motor_delay)
        self.phase = Phase.IDLE
        self.plan: Plan | None = None
        self.obstacle = ''
        self.stopped = ''
        self._bounds = bounds or SafetyLimits()
        self._controller: Controller | None = None
        self._coming: Plan | None = None
        self._refused: tuple[Parameters, Loop] | None = None
        self._q: Pair | None = None
        self._heard = -math.inf
        self._upright_since: float | None = None
        self._arming_since = 0.0

    def to_prepare(self, accept_warn: bool) -> tuple[Parameters, Loop] | None:
        """Return parameters and loop for which a plan is missing; None if there is nothing to prepare."""
        try:
            wanted = self.readiness.ready(accept_warn)
            if self._q is None:
                raise ControlError(
                    'no sample was received on joint_states; start the bridge, or remap the topic as for the bridge'
                )
        except ControlError as error:
            self.obstacle = str(error)
            if self.phase is Phase.IDLE:
                self.plan = None
            return None
        plan = self._coming or self.plan
        if self.phase is not Phase.IDLE and plan is not None:
            # The loop is constant during a motion.
            wanted = wanted[0], plan.design.loop
        if wanted == self._refused:
            return None
        self.obstacle = ''
        if plan is not None and wanted == (plan.design.parameters, plan.design.loop):
            return None
        return wanted

    def prepared(self, plan: Plan) -> None:
        """Use a plan now or, during a motion, from the next sample on. An idle balancer needs a simulated plan."""
        self._refused, self.obstacle = None, ''
        if self.phase is not Phase.IDLE:
            self._coming = plan
        elif plan.simulated:
            self.plan = plan

    def not_prepared(self, wanted: tuple[Parameters, Loop], reason: str) -> None:
        """Store the reason why there is no plan for these parameters and this loop."""
        self._refused, self.obstacle = wanted, reason
        if self.phase is Phase.IDLE:
            self.plan = None

    def begin(self, now: float) -> None:
        """Start arming at ``now`` [s].

        Raises:
            ControlError: there is no plan or sample, or the rig is far from upright and the swing-up is impossible.
        """
        if self.phase is not Phase.IDLE:
            raise ControlError(f'it is {self.phase.value} already')
        if self.plan is None or self._q is None:
            raise ControlError(self.obstacle or 'the controller is being designed; try again in a moment')
        self._require_sample(now)
        near = float(deviation(np.array([self._q]))[0]) < SETTINGS.near
        if not near and self.plan.swing_up == math.inf:
            raise ControlError(f'{self.plan.obstacle()}; hold it upright and start again to balance only')
        if not near and not self._bounds.swing_up:
            raise ControlError('swing_up_time is 0; hold it upright, then start again')
        self.phase, self.stopped, self._arming_since = Phase.ARMING, '', now

    def armed(self) -> None:
        """Start the motion at the next sample, after the bridge was armed."""
        assert self.plan is not None, 'begin() comes first'
        self._controller = Controller(self.plan.design, self._bounds)
        self._coming, self._upright_since = None, None
        self.phase = Phase.RUNNING

    def stop(self, reason: str = '') -> None:
        """Stop the motion; ``reason`` is the fault, if there is one."""
        self.phase, self.stopped, self._controller = Phase.IDLE, reason, None
        # Plans from during the motion were not simulated: request them again.
        self._coming = self._refused = None
        if self.plan is not None and not self.plan.simulated:
            self.plan = None

    def sample(self, t: float, age: float, now: float, q: Pair, effort: float) -> float | None:
        """Process a sample: its sampling time, age and arrival [s], positions [rad], torque from then on [N m].

        The arrival and the times of other calls are on one monotonic clock; the sampling time is on the bridge's clock.

        Returns:
            The torque to command [N m], None while idle.

        Raises:
            ControlError: the motion has to stop.
        """
        self.silence(now)
        self._q, self._heard = q, now
        if self.phase is Phase.IDLE:
            return None
        if (controller := self._controller) is None:
            return 0.0
        # Also not in the future: with a stopped or reset clock no sample would ever be old.
        if not abs(age) <= self._bounds.gap:
            raise ControlError(
                f'a sample is {age:.3f} s old; at most {self._bounds.gap:g} s either way are allowed: check the '
                'clocks and use_sim_time'
            )
        if self._coming is not None:
            self.plan, self._coming = self._coming, None
            controller.adopt(self.plan.design)
        torque = controller.step(t, q, effort)
        self._upright_since = (self._upright_since or now) if controller.balancing else None
        return torque

    def silence(self, now: float) -> None:
        """Raise ControlError if an answer or a sample is missing for too long; call it several times per gap."""
        if self.phase is Phase.ARMING and now - self._arming_since > SETTINGS.patience:
            raise ControlError(
                f'the bridge did not answer within {SETTINGS.patience:g} s whether it is armed; start again'
            )
        if self.phase is Phase.RUNNING:
            self._require_sample(now)

    def _require_sample(self, now: float) -> None:
        if now - self._heard > self._bounds.gap:
            raise ControlError(f'no sample for {now - self._heard:.3f} s: check the bridge, or this machine paused')

    def diagnosis(self) -> tuple[Level, str, dict[str, str]]:
        """Return a level, a sentence, and figures by name."""
        values = {'phase': self.phase.value, 'mode': 'none'}
        if self._controller is not None:
            values['mode'] = 'balancing' if self._controller.balancing else 'swinging up'
            values['balancing for [s]'] = f'{self._heard - (self._upright_since or self._heard):.1f}'
            values['transport [samples]'] = str(self._controller.monitor.transport)
        if self.plan is not None:
            m, loop = self.plan.margins, self.plan.design.loop
            values |= {
                'period [s]': f'{loop.period:g}',
                'dead time [s]': f'{loop.delay:.4f}',
                'torque limit [N m]': f'{loop.limit:g}',
                'gain margin down': f'{m.gain_down:.3f}',
                'gain margin up': f'{m.gain_up:.3f}',
                'phase margin [deg]': f'{math.degrees(m.phase):.1f}',
                'delay margin [s]': f'{m.delay:.4f}',
                'swing-up in simulation [s]': f'{self.plan.swing_up:.2f}',
            }
        if self.stopped:
            return Level.ERROR, f'stopped: {self.stopped}', values
        if self.phase is Phase.IDLE:
            waiting = self.obstacle or ('' if self.plan else 'the controller is being designed')
            return (Level.WARN, f'waiting: {waiting}', values) if waiting else (Level.OK, 'ready', values)
        return Level.OK, values['mode'] if self._controller else self.phase.value, values
