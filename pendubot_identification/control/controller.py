# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The controller: computes a torque from each sample. It swings the rig up, balances it, and has safety limits.

At a violated limit it raises ControlError; its caller then commands zero torque and disarms.
"""

import math
from dataclasses import dataclass

from pendubot_identification.errors import ControlError
from pendubot_identification.model.dynamics import GRAVITY, Pair, accelerations, advance

from .estimator import CommandMonitor, Estimator, RigState
from .linear_control import Design
from .sign_check import SignCheck

UPRIGHT = math.pi / 2


@dataclass(frozen=True, slots=True)
class ControllerSettings:
    """Gains of the swing-up, conditions of the switch to balancing, and the bumpless transfer to new parameters.

    The gains are from a random search: several rigs swing up within 3 s, also if the parameters of link 2 are 30 %
    wrong.
    """

    pump: float = 0.8  #: Largest acceleration of link 1 that adds energy, over w^2; w = sqrt(P5 g / P2).
    stiffness: float = 0.28  #: Acceleration of link 1 towards upright per rad, over w^2.
    damping: float = 0.82  #: Damping ratio of that motion.
    eagerness: float = 1.4  #: Reciprocal of the missing fraction of energy above which the pumping saturates.
    friction: float = 3.0  #: Pumping against the friction of the elbow, as a multiple of that torque over P5 g.
    sharpness: float = 3.0  #: The pumping decreases below a speed of link 2 of w / sharpness.
    reach: float = 0.8  #: Largest deviation of a link from upright while balancing [rad].
    catch_torque: float = 0.9  #: Fraction of the torque limit in the simulation before the switch to balancing.
    catch_angle: float = 0.15  #: Largest deviation of both angles at the end of that simulation [rad].
    catch_time: float = 0.5  #: Duration of that simulation [s].
    catch_step: float = 0.005  #: Step of that simulation [s].
    bumpless: float = 0.1  #: Time constant with which the torque's jump at new parameters decays [s].


SETTINGS = ControllerSettings()


@dataclass(frozen=True, slots=True)
class SafetyLimits:
    """Limits at which the controller stops."""

    shoulder: float = 6.0  #: Largest deviation of link 1 from upright [rad]; pi while hanging.
    elbow: float = 40.0  #: Largest angle of the elbow [rad].
    speed: float = 60.0  #: Largest joint speed [rad/s].
    gap: float = 0.1  #: Longest time without a sample, and largest age of a sample [s].
    swing_up: float = 30.0  #: Longest swing-up [s]; 0: no swing-up.


class Controller:
    """Estimates the state and computes the torque at every sample.

    ``balancing`` is whether the regulator is in use, instead of the swing-up.
    """

    def __init__(self, design: Design, bounds: SafetyLimits | None = None) -> None:
        self.balancing = False
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
        """Change to another design without a jump of the torque."""
        before = None if self._last is None else self._law(self._ahead())
        self.design = design
        self._estimator.adopt(design.parameters, design.L)
        if before is not None:
            self._offset += before - self._law(self._ahead())

    def step(self, t: float, q: Pair, effort: float) -> float:
        """Process a sample with time [s], positions [rad] and present torque [N m]; return the next torque [N m].

        Raises:
            ControlError: a limit is violated; command zero torque and disarm the motor.
        """
        self._follow(t, q, effort)
        self._watch(q, effort)
        ahead = self._ahead()
        self._decide(t, ahead)
        self._offset *= math.exp(-self._loop.period / SETTINGS.bumpless)
        torque = self._law(ahead) + self._offset
        if not math.isfinite(torque):
            raise ControlError(f'the computed torque is {torque}; check the parameters')
        self._torque = max(-self._loop.limit, min(self._loop.limit, torque))
        self.monitor.command(self._torque)
        return self._torque

    def _ahead(self) -> RigState:
        """Return the predicted state at the time when the next torque takes effect."""
        return self._estimator.predict(self.monitor.pending())

    def _follow(self, t: float, q: Pair, effort: float) -> None:
        if not all(map(math.isfinite, (t, *q, effort))):
            raise ControlError(f'a sample has the values {t}, {q}, {effort}; all have to be finite')
        elapsed = self._loop.period if self._last is None else t - self._last
        if not 0 < elapsed <= self._bounds.gap:
            raise ControlError(f'the time between two samples is {elapsed:.3f} s; at most {self._bounds.gap:g} s may')
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
            raise ControlError(
                f'the motor ignores commands: {effort:g} N m applied, {self._torque:g} N m commanded; the log of the '
                'bridge has the reason'
            )
        if self._sign_check is not None and self._sign_check.update(q, effort):
            self._sign_check = None

    def _decide(self, t: float, state: RigState) -> None:
        error = _from_upright(state)
        near = abs(error[0]) < SETTINGS.reach and abs(error[0] + error[1]) < SETTINGS.reach
        if self.balancing and not near:
            self.balancing, self._swinging_since = False, t
        elif not self.balancing and near:
            self.balancing = self._catches(error)
        allowed = self._bounds.swing_up
        if not self.balancing and t - self._swinging_since >= allowed:
            raise ControlError(
                f'not upright after {allowed:g} s of swinging up'
                if allowed
                else 'it is too far from upright for balancing, and swing_up_time is 0'
            )

    def _law(self, state: RigState) -> float:
        if self.balancing:
            return self.design.torque(_from_upright(state))
        return _swing_up(self.design, state, self._upright)

    def _catches(self, error: RigState) -> bool:
        """Return whether the regulator balances the rig from this state in a simulation with a reduced torque limit."""
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
    """Return the deviation of a state from the nearest upright position."""
    q1, q2, v1, v2 = state
    return math.remainder(q1 - UPRIGHT, 2 * math.pi), math.remainder(q2, 2 * math.pi), v1, v2


def _swing_up(design: Design, state: RigState, upright: float) -> float:
    """Return the torque [N m] at a state that drives link 1 to ``upright`` [rad] so that link 2 gains energy.

    Collocated partial feedback linearisation (M. W. Spong, *The swing up control problem for the Acrobot*, IEEE Control
    Systems 15(1), 1995; M. W. Spong and D. J. Block, *The Pendubot*, CDC 1995) makes the shoulder's acceleration the
    input. Link 2 is then a pendulum on a moving pivot. Its energy E2 = P2 (q1' + q2')^2 / 2 + P5 g sin(q1 + q2) changes
    by

        E2' = -P3 cos(q2) (q1' + q2') q1'' - ...

    so an acceleration against the sign of cos(q2) (q1' + q2') raises it (K. J. Astrom and K. Furuta, *Swinging up a
    pendulum by energy control*, Automatica 36, 2000). Without an addition for the energy that the elbow's friction
    takes, the energy would settle below the top. At the potential energy of the upright position, link 2 passes
    upright slowly while link 1 stays upright, and the regulator takes over.
    """
    p, (q1, q2, v1, v2) = design.parameters, state
    inertia, top, v12 = p.P2 + p.J2, p.P5 * GRAVITY, v1 + v2
    w = math.sqrt(top / inertia)
    missing = 1 - math.sin(q1 + q2) - inertia * v12 * v12 / 2 / top
    lost = (p.b2 * abs(v2) + p.Fc2) / top
    pump = (
        SETTINGS.pump
        * max(-1.0, min(1.0, SETTINGS.eagerness * missing + SETTINGS.friction * lost))
        * math.tanh(SETTINGS.sharpness * v12 * math.cos(q2) / w)
    )
    draw = SETTINGS.stiffness * (q1 - upright) + 2 * SETTINGS.damping * math.sqrt(SETTINGS.stiffness) * v1 / w
    wanted = -w * w * (pump + draw)
    # The shoulder's acceleration is linear in the torque.
    free, pushed = (accelerations(design.theta, state, (torque, 0.0), math)[0] for torque in (0.0, 1.0))
    return float((wanted - free) / (pushed - free))
