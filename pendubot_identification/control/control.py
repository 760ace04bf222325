# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The controller: a sample in, a torque out. It swings up, balances, and stops where it must not go on.

Sans-IO: time comes with the samples, randomness there is none. What stops it is an exception, so that nothing goes on
by oversight; whoever drives it commands zero torque then, and disarms.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from pendubot_identification.errors import ControlError
from pendubot_identification.model.dynamics import Pair
from pendubot_identification.model.parameters import Parameters
from pendubot_identification.model.rollout import advance

from .command_monitor import CommandMonitor
from .estimator import Estimator, State
from .linear_control import Margins, Regulator, Weights, design, equilibrium, margins
from .sign_check import SignCheck
from .swing_up import SwingUp

UPRIGHT = math.pi / 2
#: Farther than this from upright [rad] nothing is caught, and what balanced has fallen.
REACH = 0.8
#: Caught is what a simulation with this much of the torque limit brings within this [rad], in so long [s] by steps [s].
CATCH_TORQUE, CATCH_ANGLE, CATCH_TIME, CATCH_STEP = 0.9, 0.15, 0.5, 0.005
#: New parameters take over the torque where the old ones left it, and bring in their own over this [s].
BUMPLESS = 0.1


class Mode(Enum):
    """What the controller is doing."""

    SWING_UP = 'swinging up'
    BALANCE = 'balancing'


@dataclass(frozen=True, slots=True)
class Loop:
    """What lies between a sample and the torque that answers it.

    Attributes:
        period: between samples [s].
        transport: so many samples after the one from which it was computed a torque is applied; at least 1.
        lag: the motor obeys so much later than the board says [s].
        limit: largest torque [N m].
    """

    period: float
    transport: int = 1
    lag: float = 0.0
    limit: float = 2.0

    @property
    def delay(self) -> float:
        """Dead time from a sample to the effect of its torque [s]."""
        return self.transport * self.period + self.lag


@dataclass(frozen=True, slots=True)
class Limits:
    """Where the controller gives up.

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
    """Everything that follows from the parameters.

    Raises:
        ControlError: they are not physical, or the upright cannot be held so slowly.
    """

    parameters: Parameters
    regulator: Regulator
    margins: Margins
    swing_up: SwingUp

    @classmethod
    def make(cls, parameters: Parameters, loop: Loop, weights: Weights | None = None) -> Design:
        """Design for a rig and a loop."""
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
    """Follows the rig from the first sample on, and computes torques.

    Args:
        design: from the rig's parameters, for this loop.
        loop: what lies between sample and torque.
        bounds: where to give up.

    Attributes:
        mode: what it is doing.
        design: the present one.
    """

    def __init__(self, design: Design, loop: Loop, bounds: Limits | None = None) -> None:
        self.mode = Mode.SWING_UP
        self.design = design
        self._loop = loop
        self._bounds = bounds or Limits()
        self._estimator = self._estimate()
        self._echo = CommandMonitor(loop.transport, loop.period)
        self._sign_check: SignCheck | None = SignCheck(design.parameters, loop.period, loop.lag)
        self._theta = tuple(map(float, design.parameters.vector()))
        self._last: float | None = None
        self._swinging_since = 0.0
        self._upright = UPRIGHT
        self._torque = 0.0
        self._offset = 0.0

    @property
    def transport(self) -> int:
        """How many samples a torque takes, as measured."""
        return self._echo.transport

    def adopt(self, design: Design) -> None:
        """Go on with other parameters, from the present torque, without a jump."""
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
            ControlError: the controller stops; the torque has to be 0 now, and the motor disarmed.
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
        self._echo.command(self._torque)
        return self._torque

    def _estimate(self) -> Estimator:
        loop = self._loop
        return Estimator(self.design.parameters, loop.period, loop.transport, loop.lag, self.design.regulator.L)

    def _follow(self, t: float, q: Pair, effort: float) -> State:
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

    def _watch(self, q: Pair, effort: float, state: State) -> None:
        b = self._bounds
        away, speed = abs(q[0] - self._upright), max(abs(state[2]), abs(state[3]))
        if away > b.shoulder:
            raise ControlError(f'link 1 is {away:.2f} rad from upright; at most {b.shoulder:g} rad are allowed')
        if abs(q[1]) > b.elbow:
            raise ControlError(f'the elbow has turned by {abs(q[1]):.1f} rad; at most {b.elbow:g} rad are allowed')
        if speed > b.speed:
            raise ControlError(f'a joint moves at {speed:.1f} rad/s; at most {b.speed:g} rad/s are allowed')
        if not self._echo.obeyed(effort):
            raise ControlError(f'the motor does not obey: {effort:g} N m are applied, {self._torque:g} were asked for')
        self._estimator.transport = self._echo.transport
        if self._sign_check is not None and self._sign_check.update(q, effort):
            self._sign_check = None

    def _decide(self, t: float, state: State) -> None:
        error = self._error(state)
        near = abs(error[0]) < REACH and abs(error[0] + error[1]) < REACH
        if self.mode is Mode.BALANCE and not near:
            self.mode, self._swinging_since = Mode.SWING_UP, t
        elif self.mode is Mode.SWING_UP and near and self._catches(error):
            self.mode = Mode.BALANCE
        if self.mode is Mode.SWING_UP and t - self._swinging_since >= self._bounds.swing_up:
            allowed = self._bounds.swing_up
            raise ControlError(
                f'not upright after {allowed:g} s of swinging up'
                if allowed
                else 'it is not near enough to upright to be caught, and swinging up is not allowed'
            )

    def _error(self, state: State) -> State:
        """Return the state as deviation from the nearest upright."""
        q1, q2, v1, v2 = state
        return math.remainder(q1 - UPRIGHT, 2 * math.pi), math.remainder(q2, 2 * math.pi), v1, v2

    def _regulated(self, error: State) -> float:
        a, b, c, d = self.design.regulator.K
        return -float(a * error[0] + b * error[1] + c * error[2] + d * error[3])

    def _law(self, state: State) -> float:
        if self.mode is Mode.BALANCE:
            return self._regulated(self._error(state))
        return self.design.swing_up.torque(state, self._upright)

    def _catches(self, error: State) -> bool:
        """Tell by simulation whether the regulator would catch the rig from here, with some torque to spare."""
        limit = CATCH_TORQUE * self._loop.limit
        for _ in range(round(CATCH_TIME / CATCH_STEP)):
            if max(abs(error[0]), abs(error[0] + error[1])) > REACH:
                return False
            torque = max(-limit, min(limit, self._regulated(error)))
            q1, *rest = advance(self._theta, (error[0] + UPRIGHT, *error[1:]), (torque, 0.0), CATCH_STEP, math)
            error = (q1 - UPRIGHT, *rest)
        return max(abs(error[0]), abs(error[1])) < CATCH_ANGLE
