# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The controller: a sample in, a torque out. It swings the rig up, balances it, and stops at its safety limits.

Time comes with the samples. It stops by raising ControlError; its caller then commands zero torque and disarms.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from pendubot_identification.errors import ControlError
from pendubot_identification.model.dynamics import Pair
from pendubot_identification.model.parameters import Parameters
from pendubot_identification.model.rollout import advance

from .estimator import CommandMonitor, Estimator, RigState
from .linear_control import Margins, Regulator, Weights, design, equilibrium, margins
from .sign_check import SignCheck
from .swing_up import SwingUp

UPRIGHT = math.pi / 2
#: With a link farther than this from upright [rad], balancing does not begin, and ends.
REACH = 0.8
#: Balancing begins where, in a simulation with this share of the torque limit, it brings both angles within this [rad]
#: in this time [s]; the simulation's step [s].
CATCH_TORQUE, CATCH_ANGLE, CATCH_TIME, CATCH_STEP = 0.9, 0.15, 0.5, 0.005
#: When parameters change, the jump of the torque is taken out and fades with this time constant [s].
BUMPLESS = 0.1


class ControlMode(Enum):
    """What the controller is doing."""

    SWING_UP = 'swinging up'
    BALANCE = 'balancing'


@dataclass(frozen=True, slots=True)
class Loop:
    """The sampled control loop.

    Attributes:
        period: between samples [s].
        transport: a torque computed from a sample is applied so many samples later, at least 1.
        lag: the motor obeys so much later than the board says [s].
        limit: largest torque [N m].
    """

    period: float
    transport: int = 1
    lag: float = 0.0
    limit: float = 2.0

    @property
    def delay(self) -> float:
        """Dead time from a sample until the torque computed from it acts [s]."""
        return self.transport * self.period + self.lag


@dataclass(frozen=True, slots=True)
class SafetyLimits:
    """Where the controller stops.

    Attributes:
        shoulder: farthest that link 1 may be from upright [rad]; hanging is pi away.
        elbow: farthest that the elbow may turn [rad].
        speed: fastest joint speed [rad/s].
        gap: longest time without a sample [s].
        swing_up: longest swing-up [s]; 0: none at all.
    """

    shoulder: float = 6.0
    elbow: float = 40.0
    speed: float = 60.0
    gap: float = 0.1
    swing_up: float = 30.0


@dataclass(frozen=True, slots=True)
class Design:
    """What is computed from the parameters before anything moves."""

    parameters: Parameters
    regulator: Regulator
    margins: Margins
    swing_up: SwingUp

    @classmethod
    def make(cls, parameters: Parameters, loop: Loop, weights: Weights | None = None) -> Design:
        """Design for a rig and a loop.

        Raises:
            ControlError: the parameters are not physical, or the loop is too slow to balance the rig.
        """
        if problems := parameters.unphysical():
            raise ControlError(f'no rig has these parameters: {problems[0]}; identify the rig again')
        if parameters.P5 <= 0 or parameters.P3 <= 0:
            raise ControlError(
                f'link 2 has its centre of mass at the elbow or behind it (P3 = {parameters.P3:.3g}, P5 = '
                f'{parameters.P5:.3g}); this controller needs one that swings out: both above 0'
            )
        regulator = design(parameters, equilibrium(parameters), loop.period, loop.delay, weights or Weights())
        return cls(parameters, regulator, margins(regulator), SwingUp(parameters))


class Controller:
    """Estimates the state from the first sample on, and computes torques.

    Args:
        design: from the rig's parameters, for this loop.
        loop: period, dead time and torque limit.
        bounds: where to stop.

    Attributes:
        mode: what it is doing.
        design: the present one.
    """

    def __init__(self, design: Design, loop: Loop, bounds: SafetyLimits | None = None) -> None:
        self.mode = ControlMode.SWING_UP
        self.design = design
        self._loop = loop
        self._bounds = bounds or SafetyLimits()
        self._estimator = self._estimate()
        self._monitor = CommandMonitor(loop.transport, loop.period)
        self._sign_check: SignCheck | None = SignCheck(design.parameters, loop.period, loop.lag)
        self._theta = tuple(map(float, design.parameters.vector()))
        self._last: float | None = None
        self._swinging_since = 0.0
        self._upright = UPRIGHT
        self._torque = 0.0
        self._offset = 0.0

    @property
    def transport(self) -> int:
        """So many samples after its own a torque is applied, as measured."""
        return self._monitor.transport

    def adopt(self, design: Design) -> None:
        """Go on with other parameters, without a jump of the torque."""
        before = None if self._last is None else self._law(self._estimator.predict())
        old, self.design = self._estimator, design
        self._theta = tuple(map(float, design.parameters.vector()))
        self._estimator = self._estimate()
        self._estimator.resume(old)
        if before is not None:
            self._offset += before - self._law(self._estimator.predict())

    def step(self, t: float, q: Pair, effort: float) -> float:
        """Take a sample and return the torque [N m] to be applied, within the limit.

        Args:
            t: when it was taken [s].
            q: joint positions [rad].
            effort: the torque that is applied from it on [N m], as the board says.

        Raises:
            ControlError: it stops; the torque has to be 0 now, and the motor disarmed.
        """
        state = self._follow(t, q, effort)
        self._watch(q, effort, state)
        ahead = self._estimator.predict()
        self._decide(t, ahead)
        self._offset *= math.exp(-self._loop.period / BUMPLESS)
        torque = self._law(ahead) + self._offset
        if not math.isfinite(torque):
            raise ControlError(f'the torque came out as {torque}; look at the parameters')
        self._torque = max(-self._loop.limit, min(self._loop.limit, torque))
        self._estimator.command(self._torque)
        self._monitor.command(self._torque)
        return self._torque

    def _estimate(self) -> Estimator:
        loop = self._loop
        return Estimator(self.design.parameters, loop.period, loop.transport, loop.lag, self.design.regulator.L)

    def _follow(self, t: float, q: Pair, effort: float) -> RigState:
        if not all(map(math.isfinite, (t, *q, effort))):
            raise ControlError(f'a sample holds {t}, {q}, {effort}; all of it has to be finite')
        elapsed = self._loop.period if self._last is None else t - self._last
        if not 0 < elapsed <= self._bounds.gap:
            raise ControlError(f'{elapsed:.3f} s passed between two samples; at most {self._bounds.gap:g} s may')
        if self._last is None:
            self._swinging_since = t
            self._upright = UPRIGHT + 2 * math.pi * round((q[0] - UPRIGHT) / (2 * math.pi) + 1e-9)
        self._last = t
        samples = max(1, round(elapsed / self._loop.period))
        if samples > 1 and self._sign_check is not None:
            self._sign_check.interrupt()
        return self._estimator.update(q, effort, samples)

    def _watch(self, q: Pair, effort: float, state: RigState) -> None:
        b = self._bounds
        away, speed = abs(q[0] - self._upright), max(abs(state[2]), abs(state[3]))
        if away > b.shoulder:
            raise ControlError(f'link 1 is {away:.2f} rad from upright; at most {b.shoulder:g} rad are allowed')
        if abs(q[1]) > b.elbow:
            raise ControlError(f'the elbow has turned by {abs(q[1]):.1f} rad; at most {b.elbow:g} rad are allowed')
        if speed > b.speed:
            raise ControlError(f'a joint moves at {speed:.1f} rad/s; at most {b.speed:g} rad/s are allowed')
        if not self._monitor.obeyed(effort):
            raise ControlError(f'the motor does not obey: {effort:g} N m are applied, {self._torque:g} were asked for')
        self._estimator.transport = self._monitor.transport
        if self._sign_check is not None and self._sign_check.update(q, effort):
            self._sign_check = None

    def _decide(self, t: float, state: RigState) -> None:
        error = self._error(state)
        near = abs(error[0]) < REACH and abs(error[0] + error[1]) < REACH
        if self.mode is ControlMode.BALANCE and not near:
            self.mode, self._swinging_since = ControlMode.SWING_UP, t
        elif self.mode is ControlMode.SWING_UP and near and self._catches(error):
            self.mode = ControlMode.BALANCE
        if self.mode is ControlMode.SWING_UP and t - self._swinging_since >= self._bounds.swing_up:
            allowed = self._bounds.swing_up
            raise ControlError(
                f'not upright after {allowed:g} s of swinging up'
                if allowed
                else 'it is not near enough to upright to be caught, and swinging up is not allowed'
            )

    def _error(self, state: RigState) -> RigState:
        """Return the state as deviation from the nearest upright."""
        q1, q2, v1, v2 = state
        return math.remainder(q1 - UPRIGHT, 2 * math.pi), math.remainder(q2, 2 * math.pi), v1, v2

    def _regulated(self, error: RigState) -> float:
        a, b, c, d = self.design.regulator.K
        return -float(a * error[0] + b * error[1] + c * error[2] + d * error[3])

    def _law(self, state: RigState) -> float:
        if self.mode is ControlMode.BALANCE:
            return self._regulated(self._error(state))
        return self.design.swing_up.torque(state, self._upright)

    def _catches(self, error: RigState) -> bool:
        """Tell by simulation whether the regulator would catch the rig from here, with some torque to spare."""
        limit = CATCH_TORQUE * self._loop.limit
        for _ in range(round(CATCH_TIME / CATCH_STEP)):
            if max(abs(error[0]), abs(error[0] + error[1])) > REACH:
                return False
            torque = max(-limit, min(limit, self._regulated(error)))
            q1, *rest = advance(self._theta, (error[0] + UPRIGHT, *error[1:]), (torque, 0.0), CATCH_STEP, math)
            error = (q1 - UPRIGHT, *rest)
        return max(abs(error[0]), abs(error[1])) < CATCH_ANGLE
