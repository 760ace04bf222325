# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Swing-up: partial feedback linearisation draws link 1 upright, and moves it so that link 2 gains energy.

Collocated linearisation (M. W. Spong, *The swing up control problem for the Acrobot*, IEEE Control Systems 15(1), 1995;
M. W. Spong and D. J. Block, *The Pendubot*, CDC 1995) makes the shoulder's acceleration the input. Link 2 is then a
pendulum on a moving pivot. Its energy E2 = P2 (q1' + q2')^2 / 2 + P5 g sin(q1 + q2) changes by

    E2' = -P3 cos(q2) (q1' + q2') q1'' - ...

so an acceleration against the sign of cos(q2) (q1' + q2') raises it (K. J. Astrom and K. Furuta, *Swinging up a
pendulum by energy control*, Automatica 36, 2000). With the energy of rest upright, link 2 passes upright slowly while
link 1 waits there, and the regulator takes over.
"""

from __future__ import annotations

import math

from pendubot_identification.model.dynamics import GRAVITY, accelerations
from pendubot_identification.model.parameters import Parameters

from .estimator import RigState

#: Accelerations of link 1 in units of w^2, where w = sqrt(P5 g / P2) is the frequency of link 2: the largest one that
#: pumps, and the one per rad that draws link 1 upright, with its damping ratio. Found by random search: they swing up
#: rigs of several proportions within 3 s from near hanging, also with link 2 identified 30 % wrong.
PUMP, STIFFNESS, DAMPING = 0.8, 0.28, 0.82
#: The pump is full while more than 1 / EAGERNESS of the energy is missing and link 2 swings faster than w / SHARPNESS.
EAGERNESS, SHARPNESS = 1.4, 3.0


class SwingUp:
    """The control law of the swing-up for a rig."""

    def __init__(self, parameters: Parameters) -> None:
        p = parameters
        self._theta = tuple(map(float, p.vector()))
        self._inertia, self._top = p.P2 + p.J2, p.P5 * GRAVITY
        self._w = math.sqrt(self._top / self._inertia)

    def torque(self, state: RigState, upright: float = math.pi / 2) -> float:
        """Return the torque [N m] at a state; ``upright`` is the q1 [rad] to which link 1 is drawn."""
        q1, q2, v1, v2 = state
        w, v12 = self._w, v1 + v2
        missing = 1 - math.sin(q1 + q2) - self._inertia * v12 * v12 / 2 / self._top
        pump = PUMP * max(-1.0, min(1.0, EAGERNESS * missing)) * math.tanh(SHARPNESS * v12 * math.cos(q2) / w)
        draw = STIFFNESS * (q1 - upright) + 2 * DAMPING * math.sqrt(STIFFNESS) * v1 / w
        wanted = -w * w * (pump + draw)
        # The shoulder's acceleration is linear in the torque.
        free, _ = accelerations(self._theta, q1, q2, v1, v2, 0.0, 0.0, math)
        pushed, _ = accelerations(self._theta, q1, q2, v1, v2, 1.0, 0.0, math)
        return float((wanted - free) / (pushed - free))
