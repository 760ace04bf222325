# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The rig's state from encoder positions and applied torques, now and when the next torque will act.

A Kalman filter with constant gain whose model is the nonlinear one: so it needs no velocities from differences, which
lag, and predicts over the loop's dead time wherever the rig swings.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.model.dynamics import Pair
from pendubot_identification.model.parameters import Parameters
from pendubot_identification.model.simulation import Plant

from .command_monitor import LONGEST

Array = NDArray[np.float64]
State = tuple[float, float, float, float]


class Estimator:
    """Follows the state sample by sample.

    Args:
        parameters: of the rig.
        period: between samples [s].
        transport: a torque computed from a sample is applied so many samples later, at least 1.
        lag: the motor obeys so much later than the board says [s].
        L: gain of the positions' innovations, shape (4, 2).

    Attributes:
        innovation: how far the last positions were from what was expected [rad].
        transport: as given; it may be set to what was measured.
    """

    def __init__(self, parameters: Parameters, period: float, transport: int, lag: float, L: Array) -> None:
        self._plant = Plant(parameters)
        self._period = period
        self._whole = math.floor(lag / period + 1e-9)
        self._part = max(0.0, lag - self._whole * period)
        self._L = [tuple(map(float, row)) for row in L]
        self._state: State | None = None
        #: Torques applied, the last one from the last sample on; and those commanded that are still to be applied.
        self._applied: deque[float] = deque([0.0] * (self._whole + 2), maxlen=self._whole + 2)
        self._commanded: deque[float] = deque([0.0] * LONGEST, maxlen=LONGEST)
        self.transport = transport
        self.innovation: Pair = (0.0, 0.0)

    def update(self, q: Pair, effort: float, samples: int = 1) -> State:
        """Take positions [rad] and the torque applied from now on [N m]; return q1, q2, q1', q2'.

        ``samples``: how many periods have passed since the last one, more than 1 where some were lost.
        """
        if self._state is None:
            self._state = (*q, 0.0, 0.0)
            self._applied.append(effort)
            return self._state
        self._plant.place(self._state[:2], self._state[2:])
        for _ in range(samples):
            self._move(self._applied[-self._whole - 2], self._part)
            self._move(self._applied[-self._whole - 1], self._period - self._part)
            self._applied.append(effort)
        q1, q2, v1, v2 = (*self._plant.q, *self._plant.qd)
        r1, r2 = self.innovation = q[0] - q1, q[1] - q2
        a, b, c, d = self._L if samples == 1 else self._after(samples)
        self._state = (
            q1 + a[0] * r1 + a[1] * r2,
            q2 + b[0] * r1 + b[1] * r2,
            v1 + c[0] * r1 + c[1] * r2,
            v2 + d[0] * r1 + d[1] * r2,
        )
        return self._state

    def predict(self) -> State:
        """Return the state at the moment when a torque computed now begins to act."""
        assert self._state is not None, 'there is nothing to predict from before the first sample'
        self._plant.place(self._state[:2], self._state[2:])
        self._move(self._applied[-self._whole - 2], self._part)
        for torque in [*list(self._applied)[-self._whole - 1 :], *self._pending()]:
            self._move(torque, self._period)
        return (*self._plant.q, *self._plant.qd)

    def _after(self, samples: int) -> list[tuple[float, ...]]:
        """Return the gain after a gap: the positions are new, and speed explains what moved meanwhile, not more."""
        elapsed = samples * self._period
        bound = min(1.0, 1 / (elapsed * max(abs(value) for row in self._L[2:] for value in row)))
        return [(1.0, 0.0), (0.0, 1.0), *(tuple(bound * value for value in row) for row in self._L[2:])]

    def resume(self, before: Estimator) -> None:
        """Go on where another one, of other parameters, was."""
        self._state, self.transport = before._state, before.transport
        self._applied.extend(before._applied)
        self._commanded.extend(before._commanded)

    def command(self, torque: float) -> None:
        """Note the torque [N m] that was computed from this sample."""
        self._commanded.append(torque)

    def _pending(self) -> list[float]:
        """Return the torques that were commanded and not applied yet, in their order."""
        return list(self._commanded)[LONGEST + 1 - self.transport :]

    def _move(self, torque: float, duration: float) -> None:
        if duration > 0:
            self._plant.advance((torque, 0.0), duration)
