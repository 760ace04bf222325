# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""How far identified parameters explain a recording: its energy balance, and its motion predicted piece by piece."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.criteria.energy import energy_regression
from pendubot_identification.model.parameters import Parameters
from pendubot_identification.model.simulation import simulate
from pendubot_identification.trajectories.signals import SMOOTHING, differentiate, resample
from pendubot_identification.trajectories.trajectory import Trajectory

Array = NDArray[np.float64]

#: P1 to P5 stand in the energy; the parameters after them are friction.
INERTIAL = 5


class Balance(NamedTuple):
    """Both sides of the paper's equation (6), from the first sample to every later one.

    Attributes:
        t: time [s], shape (N,).
        gained: E(t) - E(0) [J], shape (N,).
        received: work of the torque less that of friction [J], shape (N,). The residual is received - gained.
    """

    t: Array
    gained: Array
    received: Array


def energy_balance(trajectory: Trajectory, theta: Array) -> Balance:
    """Return the energy balance of a recording with the seven parameters theta, shape (7,)."""
    made = energy_regression(trajectory)
    return Balance(
        made.t, made.phi[:, :INERTIAL] @ theta[:INERTIAL], made.y - made.phi[:, INERTIAL:] @ theta[INERTIAL:]
    )


def predicted(trajectory: Trajectory, parameters: Parameters, length: float) -> list[Trajectory]:
    """Simulate a recording piece by piece, each from its measured state and with its torque.

    Args:
        trajectory: the recording.
        parameters: of the rig.
        length: of the pieces [s].

    Raises:
        ParameterError: the parameters are not physical.
    """
    motion = resample(trajectory)
    q, qd = differentiate(motion.q, motion.interval, SMOOTHING)
    step = max(2, round(length / motion.interval))
    pieces = []
    for k in range(0, len(motion) - 1, step):
        part = slice(k, min(k + step, len(motion)))
        start = (float(q[k, 0]), float(q[k, 1])), (float(qd[k, 0]), float(qd[k, 1]))
        pieces.append(simulate(parameters, motion.t[part], motion.tau[part], *start))
    return pieces
