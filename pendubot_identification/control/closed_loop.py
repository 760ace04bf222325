# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Closed-loop simulation: the controller on a simulated rig."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.errors import ControlError
from pendubot_identification.model.dynamics import Pair
from pendubot_identification.model.simulation import HANGING, LatePlant
from pendubot_identification.trajectories.trajectory import Trajectory

from .controller import UPRIGHT, Controller, ControlMode, Loop

Array = NDArray[np.float64]

#: The rig is held while both angles are within this of upright [rad].
HELD = 0.2


@dataclass(frozen=True, slots=True)
class ClosedLoopRun:
    """The outcome of a simulation.

    Attributes:
        motion: the rig's true motion, sample by sample.
        balancing: at which samples the controller was balancing, shape (N,).
        stopped: why the controller stopped; empty if it did not.
    """

    motion: Trajectory
    balancing: NDArray[np.bool_]
    stopped: str = ''


def deviation(q: Array) -> Array:
    """Return how far positions q [rad], shape (N, 2), are from upright: the larger of both joints', shape (N,)."""
    away = np.abs(np.remainder(q - [UPRIGHT, 0.0] + math.pi, 2 * math.pi) - math.pi)
    return np.asarray(away.max(axis=1))


def held_since(motion: Trajectory) -> float:
    """Return the time [s] from which on a motion is held until its end; infinite if it is not held at the end."""
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
        controller: before its first sample.
        rig: at its initial state, with its own motor delay.
        loop: the true period, transport and limit, which may differ from those of the design.
        seconds: duration [s].
        counts_per_turn: of the encoders.
        sensed: turns true positions into those that the controller is told, for instance with a wrong sign.
        motor: factor of the torque, negative if the motor turns the wrong way.
        enough: end once it has balanced for so long without a break [s].
    """
    count = 2 * math.pi / counts_per_turn
    commands = deque([0.0] * loop.transport)
    rows, balancing, stopped, balanced = [], [], '', 0
    for k in range(round(seconds / loop.period)):
        q1, q2 = (round((q - zero) / count) * count + zero for q, zero in zip(rig.q, HANGING, strict=True))
        effort = commands.popleft()
        rows.append((k * loop.period, *rig.q, effort, *rig.qd))
        balancing.append(controller.mode is ControlMode.BALANCE)
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
