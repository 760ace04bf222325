# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Sign check: detects wrong signs and exchanged encoders in the first tenths of a second of motion.

Short windows are simulated under each hypothesis: correct wiring, a wrong sign of an encoder or the motor, or exchanged
encoders. The check accepts the hypothesis with a much smaller prediction error than all others. Inaccurate parameters
increase all errors equally. A hand that holds a link spoils all predictions, so a fault also has to explain the motion
much better than uniform motion does.
"""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pendubot_identification.errors import ControlError
from pendubot_identification.model.dynamics import Pair, advance
from pendubot_identification.model.simulation import HANGING


@dataclass(frozen=True, slots=True)
class SignCheckSettings:
    """Windows of the simulations, and the acceptance of a hypothesis."""

    window: float = 0.08  #: Length of a window [s].
    steps: int = 8  #: Number of simulation steps in a window.
    stride: int = 2  #: Number of steps between the starts of two windows.
    ratio: float = 5.0  #: Squared error of the second best hypothesis over the accepted one, at least.
    floor: float = 0.0015  #: RMS error by which the second best hypothesis has to exceed that ratio [rad].


SETTINGS = SignCheckSettings()

#: The fault, '' first; the map from measured to true positions; the sign of the motor.
_FAULTS: tuple[tuple[str, Callable[[Pair], Pair], float], ...] = (
    ('', lambda q: q, 1.0),
    ("the shoulder's encoder counts the wrong way (sign)", lambda q: (2 * HANGING[0] - q[0], q[1]), 1.0),
    ("the elbow's encoder counts the wrong way (sign)", lambda q: (q[0], -q[1]), 1.0),
    ('the motor turns the wrong way, or both encoders do', lambda q: q, -1.0),
    ('shoulder and elbow are exchanged', lambda q: (q[1] + HANGING[0], q[0] - HANGING[0]), 1.0),
)


class SignCheck:
    """Accumulates the hypotheses' errors until one is accepted; ``period`` and ``lag`` [s] belong to the loop."""

    def __init__(self, theta: tuple[float, ...], period: float, lag: float) -> None:
        self._theta = theta
        self._every = max(1, round(SETTINGS.window / SETTINGS.steps / period))
        self._step = self._every * period
        self._late = round(lag / period)
        self._size = SETTINGS.steps * self._every + 1
        self._positions: deque[Pair] = deque(maxlen=self._size)
        self._efforts: deque[float] = deque(maxlen=self._size + self._late)
        self._restart()
        self.interrupt()

    def _restart(self) -> None:
        self._errors = [0.0] * len(_FAULTS)
        self._uniform = 0.0  # error of uniform motion

    def interrupt(self) -> None:
        """Start a new window at the next sample, after lost samples."""
        self._positions.clear()
        self._efforts.clear()
        self._countdown = self._size + self._late

    def update(self, q: Pair, effort: float) -> bool:
        """Update with positions [rad] and torque [N m]; return True for correct wiring, raise ControlError if not."""
        self._positions.append(q)
        self._efforts.append(effort)
        self._countdown -= 1
        if self._countdown > 0:
            return False
        self._countdown = SETTINGS.stride * self._every
        n = self._every
        applied, positions = list(self._efforts)[: SETTINGS.steps * n], list(self._positions)[::n]
        torques = [sum(applied[k : k + n]) / n for k in range(0, len(applied), n)]
        for k, (_, place, motor) in enumerate(_FAULTS):
            self._errors[k] += self._error(list(map(place, positions)), [motor * torque for torque in torques])
        self._uniform += _squared(positions)
        if math.isinf(self._errors[0]):
            raise ControlError('a simulation of the rig diverges with these parameters; identify the rig again')
        best, second = sorted(range(len(_FAULTS)), key=self._errors.__getitem__)[:2]
        decisive = SETTINGS.ratio * self._errors[best] + SETTINGS.floor**2
        if self._errors[second] < decisive:
            return False
        if name := _FAULTS[best][0]:
            if self._uniform < decisive:
                self._restart()
                return False
            raise ControlError(f'{name}, according to the motion of the rig; correct that, see docs/rig.md')
        return True

    def _error(self, measured: list[Pair], torques: list[float]) -> float:
        """Return the mean squared prediction error of a window's positions [rad^2], with the mean torque of each step.

        It is infinite if the simulation diverges. A straight line is subtracted from the errors, because the initial
        velocities are differences of positions.
        """
        (q1, q2), (later1, later2) = measured[:2]
        state: tuple[float, ...] = (q1, q2, (later1 - q1) / self._step, (later2 - q2) / self._step)
        errors = [(0.0, 0.0)]
        try:
            for torque, (q1, q2) in zip(torques, measured[1:], strict=True):
                state = advance(self._theta, state, (torque, 0.0), self._step, math)
                errors.append((q1 - state[0], q2 - state[1]))
            error = _squared(errors)
            return error if math.isfinite(error) else math.inf
        except (ValueError, ArithmeticError):
            return math.inf


def _squared(pairs: list[Pair]) -> float:
    """Return the mean squared deviation of both joints from straight lines [rad^2]."""
    with np.errstate(all='ignore'):
        line, values = np.linspace(-1, 1, len(pairs)), np.array(pairs) - np.mean(pairs, axis=0)
        return float(((values - np.outer(line, line @ values / (line @ line))) ** 2).sum() / len(pairs))
