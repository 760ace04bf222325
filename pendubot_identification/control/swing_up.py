# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Swing-up: partial feedback linearisation drives link 1 upright, and moves it so that link 2 gains energy.

Collocated linearisation (M. W. Spong, *The swing up control problem for the Acrobot*, IEEE Control Systems 15(1), 1995;
M. W. Spong and D. J. Block, *The Pendubot*, CDC 1995) makes the shoulder's acceleration the input. Link 2 is then a
pendulum on a moving pivot. Its energy E2 = P2 (q1' + q2')^2 / 2 + P5 g sin(q1 + q2) changes by

    E2' = -P3 cos(q2) (q1' + q2') q1'' - ...

so an acceleration against the sign of cos(q2) (q1' + q2') raises it (K. J. Astrom and K. Furuta, *Swinging up a
pendulum by energy control*, Automatica 36, 2000). At the potential energy of the upright position, link 2 passes
upright slowly while link 1 stays upright, and the regulator takes over.
"""

import math
from dataclasses import dataclass

from pendubot_identification.model.dynamics import GRAVITY, accelerations
from pendubot_identification.model.parameters import Parameters

from .estimator import RigState


@dataclass(frozen=True, slots=True)
class SwingUpSettings:
    """Gains from a random search: several rigs swing up within 3 s, also if the parameters of link 2 are 30 % wrong."""

    pump: float = 0.8  #: Largest acceleration of link 1 that adds energy, over w^2; w = sqrt(P5 g / P2).
    stiffness: float = 0.28  #: Acceleration of link 1 towards upright per rad, over w^2.
    damping: float = 0.82  #: Damping ratio of that motion.
    eagerness: float = 1.4  #: Reciprocal of the missing fraction of energy above which the pumping saturates.
    sharpness: float = 3.0  #: The pumping decreases below a speed of link 2 of w / sharpness.


SETTINGS = SwingUpSettings()


def swing_up(p: Parameters, theta: tuple[float, ...], state: RigState, upright: float) -> float:
    """Return the torque [N m] at a state; ``upright`` is the reference of q1 [rad], ``theta`` the vector of ``p``."""
    q1, q2, v1, v2 = state
    inertia, top, v12 = p.P2 + p.J2, p.P5 * GRAVITY, v1 + v2
    w = math.sqrt(top / inertia)
    missing = 1 - math.sin(q1 + q2) - inertia * v12 * v12 / 2 / top
    pump = (
        SETTINGS.pump
        * max(-1.0, min(1.0, SETTINGS.eagerness * missing))
        * math.tanh(SETTINGS.sharpness * v12 * math.cos(q2) / w)
    )
    draw = SETTINGS.stiffness * (q1 - upright) + 2 * SETTINGS.damping * math.sqrt(SETTINGS.stiffness) * v1 / w
    wanted = -w * w * (pump + draw)
    # The shoulder's acceleration is linear in the torque.
    free, pushed = (accelerations(theta, q1, q2, v1, v2, torque, 0.0, math)[0] for torque in (0.0, 1.0))
    return float((wanted - free) / (pushed - free))
