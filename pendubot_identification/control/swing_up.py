# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Swing-up: link 1 is drawn upright by partial feedback linearisation, and moved so that it pumps link 2.

Collocated linearisation (M. W. Spong, *The swing up control problem for the Acrobot*, IEEE Control Systems 15(1), 1995;
M. W. Spong and D. J. Block, *The Pendubot*, CDC 1995) makes the shoulder's acceleration the input. Link 2 is then a
pendulum on a moving pivot. Its energy E2 = P2 (q1' + q2')^2 / 2 + P5 g sin(q1 + q2) changes by

    E2' = -P3 cos(q2) (q1' + q2') q1'' - ...

so an acceleration against the sign of cos(q2) (q1' + q2') raises it (K. J. Astrom and K. Furuta, *Swinging up a
pendulum by energy control*, Automatica 36, 2000). At the energy of rest upright link 2 comes by there slowly, link 1
waits there, and the regulator takes over.
"""

from __future__ import annotations

import math

from pendubot_identification.model.dynamics import GRAVITY, accelerations
from pendubot_identification.model.parameters import Parameters

from .estimator import State

#: Accelerations of link 1 in w^2, w = sqrt(P5 g / P2) being how fast link 2 swings: the largest that pumps, and what
#: draws link 1 upright, for each rad; the damping ratio of that. Chosen among random ones, as those that swing up rigs
#: of several proportions within 3 s from anywhere near hanging, also when link 2 is identified 30 % wrong.
PUMP, STIFFNESS, DAMPING = 0.8, 0.28, 0.82
#: The pump works fully until so much of 1/this of the energy is missing, and for swings faster than w / SHARPNESS.
EAGERNESS, SHARPNESS = 1.4, 3.0


class SwingUp:
    """The law of the swing-up for a rig."""

    def __init__(self, parameters: Parameters) -> None:
        p = parameters
        self._theta = tuple(map(float, p.vector()))
        self._inertia, self._top = p.P2 + p.J2, p.P5 * GRAVITY
        self._w = math.sqrt(self._top / self._inertia)

    def torque(self, state: State, upright: float = math.pi / 2) -> float:
        """Return the torque [N m] wanted at the state q1, q2, q1', q2'; ``upright`` tells to which turn of link 1."""
        q1, q2, v1, v2 = state
        w, v12 = self._w, v1 + v2
        missing = 1 - math.sin(q1 + q2) - self._inertia * v12 * v12 / 2 / self._top
        pump = PUMP * max(-1.0, min(1.0, EAGERNESS * missing)) * math.tanh(SHARPNESS * v12 * math.cos(q2) / w)
        draw = STIFFNESS * (q1 - upright) + 2 * DAMPING * math.sqrt(STIFFNESS) * v1 / w
        wanted = -w * w * (pump + draw)
        # The torque moves the shoulder's acceleration linearly: from what it is without to what is wanted.
        free, _ = accelerations(self._theta, q1, q2, v1, v2, 0.0, 0.0, math)
        pushed, _ = accelerations(self._theta, q1, q2, v1, v2, 1.0, 0.0, math)
        return float((wanted - free) / (pushed - free))
