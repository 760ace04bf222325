# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Whether encoders and motor are wired as the parameters take it: told from the first tenths of a second of motion.

The motion of short windows is simulated as it would be if the wiring were right, an encoder's sign wrong, the motor's
sign wrong, or the encoders exchanged. What predicts the motion far better than the others is the truth; parameters that
are off blur all of them alike.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from pendubot_identification.errors import ControlError
from pendubot_identification.model.dynamics import Pair
from pendubot_identification.model.parameters import Parameters
from pendubot_identification.model.rollout import advance
from pendubot_identification.model.simulation import HANGING

#: Length of a window [s], its simulation's steps, and how many steps later the next one begins.
WINDOW, STEPS, STRIDE = 0.08, 8, 2
#: Errors [rad] below this say nothing; the truth explains so many times better, in squares.
FLOOR, CLEARLY = 0.0015, 5.0


class _Fault(NamedTuple):
    name: str
    place: Callable[[Pair], Pair]
    motor: float


def _mirrored(q1: float) -> float:
    return 2 * HANGING[0] - q1


_FAULTS = (
    _Fault('', lambda q: q, 1.0),
    _Fault("the shoulder's encoder counts the wrong way (sign)", lambda q: (_mirrored(q[0]), q[1]), 1.0),
    _Fault("the elbow's encoder counts the wrong way (sign)", lambda q: (q[0], -q[1]), 1.0),
    _Fault('the motor turns the wrong way, or both encoders do', lambda q: q, -1.0),
    _Fault('shoulder and elbow are exchanged', lambda q: (q[1] + HANGING[0], q[0] - HANGING[0]), 1.0),
)


#: Takes a straight line off the values along a window.
_LINE = np.column_stack([np.ones(STEPS + 1), np.arange(STEPS + 1)])
_WITHOUT_LINE = np.eye(STEPS + 1) - _LINE @ np.linalg.pinv(_LINE)


class SignCheck:
    """Watches the beginning of a motion.

    Args:
        parameters: of the rig.
        period: between samples [s].
        lag: the motor obeys so much later than the board says [s].
    """

    def __init__(self, parameters: Parameters, period: float, lag: float) -> None:
        self._theta = tuple(map(float, parameters.vector()))
        self._every = max(1, round(WINDOW / STEPS / period))
        self._step = self._every * period
        self._late = round(lag / period)
        self._size = STEPS * self._every + 1
        self._positions: deque[Pair] = deque(maxlen=self._size)
        self._efforts: deque[float] = deque(maxlen=self._size + self._late)
        self._errors = [0.0] * len(_FAULTS)
        self.interrupt()

    def interrupt(self) -> None:
        """Begin another window with the next sample: some were lost."""
        self._positions.clear()
        self._efforts.clear()
        self._countdown = self._size + self._late

    def update(self, q: Pair, effort: float) -> bool:
        """Take a sample; return True once the wiring has shown itself to be right.

        Raises:
            ControlError: it is wrong; the sentence names what is.
        """
        self._positions.append(q)
        self._efforts.append(effort)
        self._countdown -= 1
        if self._countdown > 0:
            return False
        self._countdown = STRIDE * self._every
        torques = self._torques()
        for k, wiring in enumerate(_FAULTS):
            seen = [wiring.place(q) for q in list(self._positions)[:: self._every]]
            self._errors[k] += self._error(seen, [wiring.motor * torque for torque in torques])
        best = min(range(len(_FAULTS)), key=self._errors.__getitem__)
        second = min(error for k, error in enumerate(self._errors) if k != best)
        if second < CLEARLY * self._errors[best] + FLOOR**2:
            return False
        if best:
            raise ControlError(f'{_FAULTS[best].name}: the rig moves as it would then; mend that, see docs/rig.md')
        return True

    def _torques(self) -> list[float]:
        """Return the mean torque of each step of the window."""
        n, applied = self._every, list(self._efforts)[: STEPS * self._every]
        return [sum(applied[k : k + n]) / n for k in range(0, len(applied), n)]

    def _error(self, seen: list[Pair], torques: list[float]) -> float:
        """Return how far the window's positions are from a simulation of them, in mean square [rad^2].

        What a straight line takes off is not counted: the initial velocities are but differences.
        """
        (q1, q2), (later1, later2) = seen[:2]
        state: tuple[float, ...] = (q1, q2, (later1 - q1) / self._step, (later2 - q2) / self._step)
        errors = [(0.0, 0.0)]
        for torque, (q1, q2) in zip(torques, seen[1:], strict=True):
            state = advance(self._theta, state, (torque, 0.0), self._step, math)
            errors.append((q1 - state[0], q2 - state[1]))
        rest = np.array(errors)
        return float((_WITHOUT_LINE @ rest).ravel() @ rest.ravel() / len(rest))
