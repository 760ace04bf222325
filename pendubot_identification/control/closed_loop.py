# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The controller on a simulated rig, before it is let loose on a real one."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.errors import ControlError
from pendubot_identification.model.dynamics import Pair
from pendubot_identification.model.simulation import HANGING, LatePlant
from pendubot_identification.trajectories.trajectory import Trajectory

from .control import UPRIGHT, Controller, Design, Loop, Mode

Array = NDArray[np.float64]

#: A swing-up is simulated for so long, and has succeeded when it then balances for so long [s].
LONGEST, ENOUGH = 10.0, 1.0
#: More torque is tried in such steps, up to so many times the limit.
MORE, MOST = 1.3, 20.0
#: Held is what stays within this of upright [rad], in both angles.
HELD = 0.2


@dataclass(frozen=True, slots=True)
class ClosedLoopRun:
    """What happened.

    Attributes:
        motion: what the rig truly did, sample by sample.
        balancing: at which samples the controller was balancing, shape (N,).
        stopped: why the controller stopped; empty where it did not.
    """

    motion: Trajectory
    balancing: NDArray[np.bool_]
    stopped: str = ''

    def held_since(self) -> float:
        """Return since when [s] it has been held to the end; infinite where it is not held at the end."""
        return held_since(self.motion)


def deviation(q: Array) -> Array:
    """Return how far positions q [rad], shape (N, 2), are from upright: of the worse of both joints, shape (N,)."""
    away = np.abs(np.remainder(q - [UPRIGHT, 0.0] + math.pi, 2 * math.pi) - math.pi)
    return np.asarray(away.max(axis=1))


def held_since(motion: Trajectory) -> float:
    """Return since when [s of its own time] a motion is held until its end; infinite where it is not."""
    out = np.flatnonzero(deviation(motion.q) > HELD)
    first = out[-1] + 1 if out.size else 0
    return float(motion.t[first]) if first < len(motion) else math.inf


def simulate_closed_loop(
    controller: Controller,
    rig: LatePlant,
    loop: Loop,
    seconds: float,
    counts_per_turn: int = 4000,
    sensed: Callable[[Pair], Pair] = lambda q: q,
    motor: float = 1.0,
    enough: float = math.inf,
) -> ClosedLoopRun:
    """Let a controller move a simulated rig.

    Args:
        controller: anything but started.
        rig: where it begins; its motor's delay is its own.
        loop: the true period, transport and limit, which need not be what the controller was designed for.
        seconds: for so long.
        counts_per_turn: of the encoders.
        sensed: what the bridge makes of the true positions, such as with a wrong sign.
        motor: which way, and how strongly, the motor turns.
        enough: end once it has balanced for so long without a break [s].
    """
    count = 2 * math.pi / counts_per_turn
    commands = deque([0.0] * loop.transport)
    rows, balancing, stopped, balanced = [], [], '', 0
    for k in range(round(seconds / loop.period)):
        q1, q2 = (round((q - zero) / count) * count + zero for q, zero in zip(rig.q, HANGING, strict=True))
        effort = commands.popleft()
        rows.append((k * loop.period, *rig.q, effort, *rig.qd))
        balancing.append(controller.mode is Mode.BALANCE)
        balanced = balanced + 1 if balancing[-1] else 0
        if stopped or balanced * loop.period > enough:
            break
        try:
            torque = controller.step(k * loop.period, sensed((q1, q2)), effort)
        except ControlError as error:
            torque, stopped = 0.0, str(error)
        commands.append(max(-loop.limit, min(loop.limit, torque)))
        rig.advance((motor * effort, 0.0), loop.period)
    t, q1, q2, tau, v1, v2 = np.array(rows).T
    motion = Trajectory(t, np.column_stack([q1, q2]), np.column_stack([tau, 0 * tau]), np.column_stack([v1, v2]))
    return ClosedLoopRun(motion, np.array(balancing), stopped)


def swing_up_time(design: Design, loop: Loop) -> float:
    """Return after how long [s] the rig, as identified, is held upright, from hanging; infinite where it is not."""
    rig = LatePlant(design.parameters, loop.lag)
    closed_loop = simulate_closed_loop(Controller(design, loop), rig, loop, LONGEST, enough=ENOUGH)
    return math.inf if closed_loop.stopped else closed_loop.held_since()


def sufficient_limit(design: Design, loop: Loop) -> float:
    """Return a torque limit [N m] that swings the rig up, within 30 % of the least; infinite where none does."""
    limit = loop.limit * MORE
    while limit <= MOST * loop.limit:
        if math.isfinite(swing_up_time(design, replace(loop, limit=limit))):
            return limit
        limit *= MORE
    return math.inf
