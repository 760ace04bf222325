# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The plan: a design for identified parameters, whether its margins suffice, and its swing-up tried in simulation."""

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

from .controller import UPRIGHT, Controller, ControlMode
from .linear_control import Design, Loop, Margins, margins

#: The rig is held while both angles are within this of upright [rad].
HELD = 0.2


@dataclass(frozen=True, slots=True)
class PlanSettings:
    """The least margins for a real rig, and the simulation of the swing-up."""

    gain: float = 1.15  #: Least margin of the gain, a factor.
    delay: float = 0.001  #: Least margin of the delay [s]: a busy computer is late now and then.
    longest: float = 10.0  #: A swing-up is simulated for at most this [s] ...
    enough: float = 1.0  #: ... and has succeeded if the rig is then balanced for this [s].
    more: float = 1.3  #: Larger torque limits are tried in steps of this factor ...
    most: float = 20.0  #: ... up to this multiple of the limit.


SETTINGS = PlanSettings()


@dataclass(frozen=True, slots=True)
class Plan:
    """A design and the result of its closed-loop simulation."""

    design: Design
    margins: Margins
    swing_up: float = math.nan  #: When the rig is upright in simulation [s]; infinite if never, NaN if not simulated.
    #: A torque limit [N m] that swings it up where the loop's does not; infinite if none does.
    sufficient: float = math.nan

    @classmethod
    def make(cls, parameters: Parameters, loop: Loop, simulate_closed_loop: bool = True) -> Plan:
        """Design, and simulate the closed loop if wanted, which takes seconds.

        Raises:
            ControlError: there is no such controller, or its margins are too small.
        """
        design = Design.make(parameters, loop)
        m, least = margins(design), SETTINGS
        if m.gain_up < least.gain or m.gain_down > 1 / least.gain or m.delay < least.delay:
            raise ControlError(
                f'this rig can hardly be balanced: the gain may be {m.gain_down:.2f} to {m.gain_up:.2f} times what is '
                f'thought and the delay {1e3 * m.delay:.2g} ms longer, and {1 / least.gain:.2f} to {least.gain:.2f} '
                f'and {1e3 * least.delay:g} ms are needed; sample faster, shorten the delay of '
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
        """Say the margins and how the simulation went."""
        m = self.margins
        text = (
            f'gain may be {m.gain_down:.2f} to {m.gain_up:.2f} times what is thought, the phase margin is '
            f'{math.degrees(m.phase):.0f} degrees, the delay margin {1e3 * m.delay:.0f} ms beside '
            f'{1e3 * self.design.loop.delay:.0f} ms of dead time'
        )
        if math.isfinite(self.swing_up):
            return f'{text}; in simulation it is upright {self.swing_up:.1f} s after hanging'
        return f'{text}; {self.obstacle()}' if self.simulated else text

    def obstacle(self) -> str:
        """Say that the torque limit is too small, and which would do."""
        enough = f'{self.sufficient:.2g} N m would do' if math.isfinite(self.sufficient) else 'neither would more'
        return f'{self.design.loop.limit:g} N m do not swing this rig up, as a simulation shows; {enough}'


def _swing_up_time(design: Design) -> float:
    """Return when [s] the rig with the design's own parameters is held upright, from hanging; infinite if never."""
    rig = LatePlant(design.parameters, design.loop.lag)
    run = simulate_closed_loop(Controller(design), rig, SETTINGS.longest, enough=SETTINGS.enough)
    return math.inf if run.stopped else held_since(run.motion)


def _sufficient_limit(design: Design) -> float:
    """Return a torque limit [N m] that swings the rig up, at most 30 % above the least; infinite if none does."""
    limit = design.loop.limit * SETTINGS.more
    while limit <= SETTINGS.most * design.loop.limit:
        if math.isfinite(_swing_up_time(replace(design, loop=replace(design.loop, limit=limit)))):
            return limit
        limit *= SETTINGS.more
    return math.inf


def deviation(q: Array) -> Array:
    """Return how far positions q [rad], shape (N, 2), are from upright: the larger of both joints', shape (N,)."""
    away = np.abs(np.remainder(q - [UPRIGHT, 0.0] + math.pi, 2 * math.pi) - math.pi)
    return np.asarray(away.max(axis=1))


def held_since(motion: Trajectory) -> float:
    """Return the time [s] from which on a motion is held until its end; infinite if it is not held at the end."""
    out = np.flatnonzero(deviation(motion.q) > HELD)
    first = out[-1] + 1 if out.size else 0
    return float(motion.t[first]) if first < len(motion) else math.inf


class ClosedLoopRun(NamedTuple):
    """The rig's true motion, at which samples the controller balanced, shape (N,), and why it stopped, if it did."""

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
    """Let a controller move a simulated rig with encoders of 4000 counts per turn.

    Args:
        controller: before its first sample.
        rig: at its initial state, with its own motor delay.
        seconds: duration [s].
        sensed: the positions that the controller gets in the place of the true ones, such as with a wrong sign.
        motor: factor of the torque, negative if the motor turns the wrong way.
        enough: end once it has balanced for so long without a break [s].
    """
    period, count = controller.design.loop.period, 2 * math.pi / 4000
    torque, stopped, balanced = 0.0, '', 0
    rows, balancing = [], []
    for k in range(round(seconds / period)):
        q1, q2 = (round((q - zero) / count) * count + zero for q, zero in zip(rig.q, HANGING, strict=True))
        effort = torque
        rows.append((k * period, *rig.q, effort, *rig.qd))
        balancing.append(controller.mode is ControlMode.BALANCE)
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
