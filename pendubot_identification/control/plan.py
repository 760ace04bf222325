# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The plan: a design for identified parameters with sufficient margins, and the simulation of its swing-up."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from pendubot_identification.arrays import Array, Flags
from pendubot_identification.errors import ControlError
from pendubot_identification.model.dynamics import Pair
from pendubot_identification.model.parameters import Parameters
from pendubot_identification.model.simulation import HANGING, LatePlant
from pendubot_identification.trajectories.trajectory import Trajectory

from .controller import UPRIGHT, Controller
from .linear_control import Design, Loop, Margins, margins

#: Largest deviation of both angles from upright while the rig is balanced [rad].
HELD = 0.2


@dataclass(frozen=True, slots=True)
class PlanSettings:
    """The smallest margins for a real rig, and the simulation of the swing-up."""

    gain: float = 1.15  #: Smallest gain margin, a factor.
    delay: float = 0.001  #: Smallest delay margin [s], because a busy computer is sometimes late.
    longest: float = 10.0  #: Longest simulation of a swing-up [s].
    enough: float = 1.0  #: Duration of balancing after a successful swing-up [s].
    more: float = 1.3  #: Factor between the torque limits in the search for a sufficient limit.
    most: float = 20.0  #: Largest torque limit in that search, as a multiple of the loop's limit.


SETTINGS = PlanSettings()


@dataclass(frozen=True, slots=True)
class Plan:
    """A design and the result of its closed-loop simulation."""

    design: Design
    margins: Margins
    swing_up: float = math.nan  #: Time of the swing-up in simulation [s]; infinite if it fails, NaN if not simulated.
    #: Sufficient torque limit for the swing-up [N m] if the loop's limit is not; infinite if there is none.
    sufficient: float = math.nan

    @classmethod
    def make(cls, parameters: Parameters, loop: Loop, simulate_closed_loop: bool = True) -> Plan:
        """Return a design and, if wanted, simulate the closed loop, which takes seconds.

        Raises:
            ControlError: no controller can be designed, or its margins are too small.
        """
        design = Design.make(parameters, loop)
        m, least = margins(design), SETTINGS
        if m.gain_up < least.gain or m.gain_down > 1 / least.gain or m.delay < least.delay:
            raise ControlError(
                f'the stability margins are too small: gain factors of {m.gain_down:.2f} to {m.gain_up:.2f} and '
                f'{1e3 * m.delay:.2g} ms of additional delay are stable, and {1 / least.gain:.2f} to {least.gain:.2f} '
                f'and {1e3 * least.delay:g} ms are required; sample faster, shorten the delay of '
                f'{1e3 * loop.delay:.3g} ms, or build a longer link 1'
            )
        if not simulate_closed_loop:
            return cls(design, m)
        swing_up = _swing_up_time(design)
        return cls(design, m, swing_up, math.nan if math.isfinite(swing_up) else _sufficient_limit(design))

    @property
    def simulated(self) -> bool:
        """Whether the swing-up was simulated, with success or without."""
        return not math.isnan(self.swing_up)

    def summary(self) -> str:
        """Return a sentence with the margins and the result of the simulation."""
        m = self.margins
        text = (
            f'stable for gain factors of {m.gain_down:.2f} to {m.gain_up:.2f}, phase margin '
            f'{math.degrees(m.phase):.0f} degrees, delay margin {1e3 * m.delay:.0f} ms in addition to '
            f'{1e3 * self.design.loop.delay:.0f} ms of dead time'
        )
        if math.isfinite(self.swing_up):
            return f'{text}; the swing-up takes {self.swing_up:.1f} s in simulation'
        return f'{text}; {self.obstacle()}' if self.simulated else text

    def obstacle(self) -> str:
        """Return a sentence with the insufficient torque limit and a sufficient limit."""
        enough = f'{self.sufficient:.2g} N m are enough' if math.isfinite(self.sufficient) else 'nor does more torque'
        return f'{self.design.loop.limit:g} N m do not swing this rig up in simulation; {enough}'


def _swing_up_time(design: Design) -> float:
    """Return the swing-up time [s] of the simulated rig with the design's parameters; infinite if it fails."""
    rig = LatePlant(design.parameters, design.loop.lag)
    run = simulate_closed_loop(Controller(design), rig, SETTINGS.longest, enough=SETTINGS.enough)
    return math.inf if run.stopped else held_since(run.motion)


def _sufficient_limit(design: Design) -> float:
    """Return a sufficient torque limit [N m], at most 30 % above the smallest; infinite if there is none."""
    limit = design.loop.limit * SETTINGS.more
    while limit <= SETTINGS.most * design.loop.limit:
        if math.isfinite(_swing_up_time(replace(design, loop=replace(design.loop, limit=limit)))):
            return limit
        limit *= SETTINGS.more
    return math.inf


def deviation(q: Array) -> Array:
    """Return the larger joint's deviation from upright [rad], shape (N,), of positions q [rad], shape (N, 2)."""
    away = np.abs(np.remainder(q - [UPRIGHT, 0.0] + math.pi, 2 * math.pi) - math.pi)
    return np.asarray(away.max(axis=1))


def held_since(motion: Trajectory) -> float:
    """Return the time [s] from which a motion stays upright until its end; infinite if it is not upright at the end."""
    out = np.flatnonzero(deviation(motion.q) > HELD)
    first = out[-1] + 1 if out.size else 0
    return float(motion.t[first]) if first < len(motion) else math.inf


class ClosedLoopRun(NamedTuple):
    """The rig's true motion, the flags of the samples in balancing mode, shape (N,), and the reason of a stop or ''."""

    motion: Trajectory
    balancing: Flags
    stopped: str


def simulate_closed_loop(
    controller: Controller,
    rig: LatePlant,
    seconds: float,
    sensed: Callable[[Pair], Pair] = lambda q: q,
    motor: float = 1.0,
    enough: float = math.inf,
) -> ClosedLoopRun:
    """Simulate a controller on a rig with encoders of 4000 counts per turn.

    Args:
        controller: controller before its first sample.
        rig: rig in its initial state, with its own motor delay.
        seconds: duration [s].
        sensed: map from true to measured positions, for example with a wrong sign.
        motor: factor of the torque, negative if the motor turns the wrong way.
        enough: duration of uninterrupted balancing after which the simulation ends [s].
    """
    period, count = controller.design.loop.period, 2 * math.pi / 4000
    torque, stopped, balanced = 0.0, '', 0
    rows, balancing = [], []
    for k in range(round(seconds / period)):
        q1, q2 = (round((q - zero) / count) * count + zero for q, zero in zip(rig.q, HANGING, strict=True))
        effort = torque
        rows.append((k * period, *rig.q, effort, *rig.qd))
        balancing.append(controller.balancing)
        balanced = balanced + 1 if balancing[-1] else 0
        if stopped or balanced * period > enough:
            break
        try:
            torque = controller.step(k * period, sensed((q1, q2)), effort)
        except ControlError as error:
            torque, stopped = 0.0, str(error)
        rig.advance((motor * effort, 0.0), period)
    t, q1, q2, tau, v1, v2 = np.array(rows).T
    motion = Trajectory(t, np.column_stack([q1, q2]), np.column_stack([tau, 0 * tau]), np.column_stack([v1, v2]))
    return ClosedLoopRun(motion, np.array(balancing), stopped)
