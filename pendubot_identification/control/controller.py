# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The controller: a sample in, a torque out. It swings the rig up, balances it, and stops at its safety limits.

It stops by raising ControlError; its caller then commands zero torque and disarms.
"""

import math
from dataclasses import dataclass
from enum import Enum

from pendubot_identification.errors import ControlError
from pendubot_identification.model.dynamics import Pair
from pendubot_identification.model.rollout import advance

from .estimator import CommandMonitor, Estimator, RigState
from .linear_control import Design
from .sign_check import SignCheck
from .swing_up import swing_up

UPRIGHT = math.pi / 2


@dataclass(frozen=True, slots=True)
class ControllerSettings:
    """When balancing begins and ends, and how parameters are exchanged."""

    reach: float = 0.8  #: With a link farther than this from upright [rad], balancing does not begin, and ends.
    catch_torque: float = 0.9  #: Balancing begins if a simulation with this fraction of the torque limit ...
    catch_angle: float = 0.15  #: ... brings both angles within this [rad] ...
    catch_time: float = 0.5  #: ... in this time [s] ...
    catch_step: float = 0.005  #: ... by steps of this length [s].
    bumpless: float = 0.1  #: The jump of the torque at new parameters fades with this time constant [s].


SETTINGS = ControllerSettings()


class ControlMode(Enum):
    """The control law in use."""

    SWING_UP = 'swinging up'
    BALANCE = 'balancing'


@dataclass(frozen=True, slots=True)
class SafetyLimits:
    """Where the controller stops."""

    shoulder: float = 6.0  #: Farthest that link 1 may be from upright [rad]; hanging is pi away.
    elbow: float = 40.0  #: Farthest that the elbow may turn [rad].
    speed: float = 60.0  #: Fastest joint speed [rad/s].
    gap: float = 0.1  #: Longest time without a sample, and largest age of one [s].
    swing_up: float = 30.0  #: Longest swing-up [s]; 0: none at all.


class Controller:
    """Estimates the state from the first sample on, and computes torques."""

    def __init__(self, design: Design, bounds: SafetyLimits | None = None) -> None:
        self.mode = ControlMode.SWING_UP
        self.design = design
        self._loop = loop = design.loop
        self._bounds = bounds or SafetyLimits()
        self._estimator = Estimator(design.parameters, loop.period, loop.lag, design.L)
        self.monitor = CommandMonitor(loop.period)
        self._sign_check: SignCheck | None = SignCheck(design.theta, loop.period, loop.lag)
        self._last: float | None = None
        self._swinging_since = 0.0
        self._upright = UPRIGHT
        self._torque = 0.0
        self._offset = 0.0

    def adopt(self, design: Design) -> None:
        """Go on with other parameters, without a jump of the torque."""
        before = None if self._last is None else self._law(self._ahead())
        self.design = design
        self._estimator.adopt(design.parameters, design.L)
        if before is not None:
            self._offset += before - self._law(self._ahead())

    def step(self, t: float, q: Pair, effort: float) -> float:
        """Take a sample: time [s], positions [rad], and the torque applied from it on [N m]; return the next torque.

        Raises:
            ControlError: it stops; the torque has to be 0 now, and the motor disarmed.
        """
        self._follow(t, q, effort)
        self._watch(q, effort)
        ahead = self._ahead()
        self._decide(t, ahead)
        self._offset *= math.exp(-self._loop.period / SETTINGS.bumpless)
        torque = self._law(ahead) + self._offset
        if not math.isfinite(torque):
            raise ControlError(f'the torque came out as {torque}; look at the parameters')
        self._torque = max(-self._loop.limit, min(self._loop.limit, torque))
        self.monitor.command(self._torque)
        return self._torque

    def _ahead(self) -> RigState:
        """Return the state when a torque computed now begins to act."""
        return self._estimator.predict(self.monitor.pending())

    def _follow(self, t: float, q: Pair, effort: float) -> None:
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
        self._estimator.update(q, effort, samples)

    def _watch(self, q: Pair, effort: float) -> None:
        b = self._bounds
        away, speed = abs(q[0] - self._upright), max(map(abs, self._estimator.state[2:]))
        if away > b.shoulder:
            raise ControlError(f'link 1 is {away:.2f} rad from upright; at most {b.shoulder:g} rad are allowed')
        if abs(q[1]) > b.elbow:
            raise ControlError(f'the elbow has turned by {abs(q[1]):.1f} rad; at most {b.elbow:g} rad are allowed')
        if speed > b.speed:
            raise ControlError(f'a joint moves at {speed:.1f} rad/s; at most {b.speed:g} rad/s are allowed')
        if not self.monitor.obeyed(effort):
            raise ControlError(f'the motor does not obey: {effort:g} N m are applied, {self._torque:g} were asked for')
        if self._sign_check is not None and self._sign_check.update(q, effort):
            self._sign_check = None

    def _decide(self, t: float, state: RigState) -> None:
        error = _from_upright(state)
        near = abs(error[0]) < SETTINGS.reach and abs(error[0] + error[1]) < SETTINGS.reach
        if self.mode is ControlMode.BALANCE and not near:
            self.mode, self._swinging_since = ControlMode.SWING_UP, t
        elif self.mode is ControlMode.SWING_UP and near and self._catches(error):
            self.mode = ControlMode.BALANCE
        allowed = self._bounds.swing_up
        if self.mode is ControlMode.SWING_UP and t - self._swinging_since >= allowed:
            raise ControlError(
                f'not upright after {allowed:g} s of swinging up'
                if allowed
                else 'it is not near enough to upright to be caught, and swinging up is not allowed'
            )

    def _law(self, state: RigState) -> float:
        if self.mode is ControlMode.BALANCE:
            return self.design.torque(_from_upright(state))
        return swing_up(self.design.parameters, self.design.theta, state, self._upright)

    def _catches(self, error: RigState) -> bool:
        """Return by simulation whether the regulator would catch the rig from here, with some torque to spare."""
        limit = SETTINGS.catch_torque * self._loop.limit
        for _ in range(round(SETTINGS.catch_time / SETTINGS.catch_step)):
            if max(abs(error[0]), abs(error[0] + error[1])) > SETTINGS.reach:
                return False
            torque = max(-limit, min(limit, self.design.torque(error)))
            state = error[0] + UPRIGHT, *error[1:]
            q1, *rest = advance(self.design.theta, state, (torque, 0.0), SETTINGS.catch_step, math)
            error = (q1 - UPRIGHT, *rest)
        return max(abs(error[0]), abs(error[1])) < SETTINGS.catch_angle


def _from_upright(state: RigState) -> RigState:
    """Return a state as deviation from the nearest upright."""
    q1, q2, v1, v2 = state
    return math.remainder(q1 - UPRIGHT, 2 * math.pi), math.remainder(q2, 2 * math.pi), v1, v2
