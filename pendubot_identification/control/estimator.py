# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The state estimator and the monitor of the command delay, from encoder positions and applied torques.

The estimator is a Kalman filter with constant gain and the nonlinear model. It needs no differences of positions, which
have a lag, and it predicts over the loop's dead time at any speed.
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
    """Thresholds of the comparison of commanded and applied torques."""

    same_torque: float = 2e-6  #: Largest difference of equal torques [N m]: the board's resolution is 1e-6 N m.
    longest_transport: int = 10  #: Largest delay of a command [samples].
    transport_samples: int = 40  #: Number of last unambiguous samples from which the delay is estimated.
    transport_share: float = 0.8  #: Fraction of these samples that has to agree on the delay.
    disobedience: float = 0.1  #: Time without any commanded torque after which the motor ignores commands [s].


SETTINGS = MonitorSettings()


class Estimator:
    """Estimates the state with the Kalman gain ``L``, shape (4, 2), of the positions' innovation.

    ``period`` and ``lag`` [s] belong to the loop.
    """

    def __init__(self, parameters: Parameters, period: float, lag: float, L: Array) -> None:
        self._plant = LatePlant(parameters, lag)
        self._period, self._L = period, L.tolist()
        self._effort: float | None = None  # applied from the last sample on

    def adopt(self, parameters: Parameters, L: Array) -> None:
        """Change the parameters and the gain, and keep the state."""
        self._plant.become(parameters)
        self._L = L.tolist()

    def update(self, q: Pair, effort: float, samples: int = 1) -> None:
        """Update with positions [rad] and present torque [N m], ``samples`` periods after the last update."""
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
        """Return the state at the effect of the next torque, after ``pending`` torques [N m] of a period each."""
        assert self._effort is not None, 'update() has to come first'
        q, qd = self._plant.ahead([(torque, 0.0) for torque in (self._effort, *pending)], self._period)
        return (*q, *qd)

    def _gain_after(self, samples: int) -> list[list[float]]:
        """Return the gain after lost samples: positions are reset, speed corrections limited to innovation / time."""
        elapsed = samples * self._period
        bound = min(1.0, 1 / (elapsed * max(abs(value) for row in self._L[2:] for value in row)))
        return [[1.0, 0.0], [0.0, 1.0], *([bound * value for value in row] for row in self._L[2:])]


class CommandMonitor:
    """Compares the efforts in the samples with the commanded torques; ``period`` is the sampling period [s]."""

    def __init__(self, period: float) -> None:
        self.transport = 1  #: delay from a sample to the application of its torque [samples].
        self._patience = max(SETTINGS.longest_transport + 1, round(SETTINGS.disobedience / period))
        self._commands: deque[float] = deque(maxlen=self._patience)
        self._seen: deque[int] = deque(maxlen=SETTINGS.transport_samples)
        self._unmatched = 0

    def command(self, torque: float) -> None:
        """Store the torque [N m] that was computed from the last sample."""
        self._commands.append(torque)

    def pending(self) -> list[float]:
        """Return the commanded torques [N m] that are not applied yet."""
        return list(self._commands)[len(self._commands) + 1 - self.transport :]

    def obeyed(self, effort: float) -> bool:
        """Update the delay with the effort of a sample [N m]; return whether the motor applies commanded torques."""
        recent = enumerate(reversed(self._commands), 1)
        matches = [j for j, torque in recent if abs(torque - effort) <= SETTINGS.same_torque]
        self._unmatched = 0 if matches or not self._commands else self._unmatched + 1
        if len(matches) == 1 and matches[0] <= SETTINGS.longest_transport:
            self._seen.append(matches[0])
            most, times = Counter(self._seen).most_common(1)[0]
            if times >= SETTINGS.transport_share * SETTINGS.transport_samples:
                self.transport = most
        return self._unmatched < self._patience
