# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The rig's state, estimated from encoder positions and applied torques, and how late commanded torques are applied.

The estimator is a Kalman filter with constant gain and the nonlinear model. It needs no differences of positions, which
lag behind, and it predicts over the loop's dead time at any speed.
"""

from collections import Counter, deque
from collections.abc import Iterable
from dataclasses import dataclass

from pendubot_identification.arrays import Array
from pendubot_identification.model.dynamics import Pair
from pendubot_identification.model.parameters import Parameters
from pendubot_identification.model.simulation import LatePlant

#: q1, q2 [rad], q1', q2' [rad/s].
RigState = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class MonitorSettings:
    """How commanded and applied torques are compared."""

    same_torque: float = 2e-6  #: Torques [N m] that differ by less are equal: the board counts in micro-N m.
    longest_transport: int = 10  #: Largest delay of a command [samples].
    transport_samples: int = 40  #: A delay is accepted if of the last unambiguous samples, so many, ...
    transport_share: float = 0.8  #: ... this fraction shows it.
    disobedience: float = 0.1  #: The motor does not obey if no commanded torque was applied for this time [s].


SETTINGS = MonitorSettings()


class Estimator:
    """Estimates the state by the Kalman gain ``L`` of the positions' innovation, shape (4, 2).

    Period and lag [s] are those of the loop.
    """

    def __init__(self, parameters: Parameters, period: float, lag: float, L: Array) -> None:
        self._plant = LatePlant(parameters, lag)
        self._period, self._L = period, L.tolist()
        self._effort: float | None = None  # applied from the last sample on

    def adopt(self, parameters: Parameters, L: Array) -> None:
        """Go on from the same state with other parameters."""
        self._plant.become(parameters)
        self._L = L.tolist()

    def update(self, q: Pair, effort: float, samples: int = 1) -> None:
        """Take positions [rad] and the torque applied from now on [N m], ``samples`` periods after the last ones."""
        if self._effort is None:
            self._plant.place(q, (0.0, 0.0))
            self._effort = effort
            return
        for _ in range(samples):
            self._plant.advance((self._effort, 0.0), self._period)
            self._effort = effort
        expected = self.state
        r1, r2 = q[0] - expected[0], q[1] - expected[1]
        gain = self._L if samples == 1 else self._gain_after(samples)
        q1, q2, v1, v2 = (x + by1 * r1 + by2 * r2 for x, (by1, by2) in zip(expected, gain, strict=True))
        self._plant.place((q1, q2), (v1, v2))

    @property
    def state(self) -> RigState:
        """The state at the last sample."""
        return (*self._plant.q, *self._plant.qd)

    def predict(self, pending: Iterable[float] = ()) -> RigState:
        """Return the state when a torque from now begins to act, after the ``pending`` ones [N m], a period each."""
        assert self._effort is not None, 'update() has to come first'
        q, qd = self._plant.ahead([(torque, 0.0) for torque in (self._effort, *pending)], self._period)
        return (*q, *qd)

    def _gain_after(self, samples: int) -> list[list[float]]:
        """Return the gain after lost samples: positions as measured, speeds corrected by at most innovation / time."""
        elapsed = samples * self._period
        bound = min(1.0, 1 / (elapsed * max(abs(value) for row in self._L[2:] for value in row)))
        return [[1.0, 0.0], [0.0, 1.0], *([bound * value for value in row] for row in self._L[2:])]


class CommandMonitor:
    """Compares the efforts that come with samples with the torques that were commanded; ``period``: of samples [s].

    Attributes:
        transport: a torque computed from a sample is applied so many samples later.
    """

    def __init__(self, period: float) -> None:
        self.transport = 1
        self._patience = max(SETTINGS.longest_transport + 1, round(SETTINGS.disobedience / period))
        self._commands: deque[float] = deque(maxlen=self._patience)
        self._seen: deque[int] = deque(maxlen=SETTINGS.transport_samples)
        self._unmatched = 0

    def command(self, torque: float) -> None:
        """Note the torque [N m] that was computed from the last sample."""
        self._commands.append(torque)

    def pending(self) -> list[float]:
        """Return the commanded torques [N m] that are still to be applied."""
        return list(self._commands)[len(self._commands) + 1 - self.transport :]

    def obeyed(self, effort: float) -> bool:
        """Take the effort of a sample [N m]; return whether commanded torques are applied at all."""
        recent = enumerate(reversed(self._commands), 1)
        matches = [j for j, torque in recent if abs(torque - effort) <= SETTINGS.same_torque]
        self._unmatched = 0 if matches or not self._commands else self._unmatched + 1
        if len(matches) == 1 and matches[0] <= SETTINGS.longest_transport:
            self._seen.append(matches[0])
            most, times = Counter(self._seen).most_common(1)[0]
            if times >= SETTINGS.transport_share * SETTINGS.transport_samples:
                self.transport = most
        return self._unmatched < self._patience
