# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Readiness: collects the inputs of a design: parameters, their quality, and period and delay of the loop."""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pendubot_identification.errors import ControlError
from pendubot_identification.level import Level, number
from pendubot_identification.model.parameters import NAMES, Parameters

from .linear_control import Loop


@dataclass(frozen=True, slots=True)
class PeriodSettings:
    """The sampling period as a low quantile of the intervals, because a busy machine skips samples."""

    samples: int = 100  #: Number of intervals between samples.
    quantile: float = 0.1  #: Quantile of these intervals.
    tolerance: float = 0.05  #: Smallest relative change at which the period is updated.


SETTINGS = PeriodSettings()


class Readiness:
    """Collects the inputs of a design, which may arrive in any order.

    ``limit`` is the user's largest torque [N m]. ``motor_delay`` is the delay of the motor behind the board's report
    [s]; None: as identified.
    """

    def __init__(self, limit: float, motor_delay: float | None = None) -> None:
        self._limit = limit
        self._board_limit = math.inf
        self._motor_delay = motor_delay
        self._theta: tuple[float, ...] = ()
        self._assessments: deque[tuple[Level, str, Mapping[str, str]]] = deque(maxlen=8)
        self._last = math.nan
        self._steps: list[float] = []
        self._period: float | None = None

    def sample(self, t: float) -> None:
        """Update the sampling period with the stamp of a sample [s]."""
        if math.isfinite(self._last):
            self._steps.append(t - self._last)
        self._last = t
        if len(self._steps) == SETTINGS.samples:
            period = sorted(self._steps)[round(SETTINGS.quantile * SETTINGS.samples)]
            self._steps.clear()
            if period > 0 and (self._period is None or abs(period / self._period - 1) > SETTINGS.tolerance):
                self._period = round(period, 6)

    def board_limit(self, limit: float) -> None:
        """Set the torque limit of bridge and board [N m]."""
        self._board_limit = limit

    def offer(self, theta: Sequence[float]) -> Parameters:
        """Store a parameter vector; raise PendubotError if it is unphysical or has a wrong length."""
        parameters = Parameters.from_vector(theta)
        self._theta = tuple(theta)
        if problems := parameters.unphysical():
            raise ControlError(f'the parameters are unphysical: {problems[0]}; identify the rig again')
        return parameters

    def assess(self, level: Level, message: str, values: Mapping[str, str]) -> None:
        """Store the quality of identified parameters; ``values`` are the parameters by name, and ``effort.delay``."""
        self._assessments.append((level, message, values))

    def ready(self, accept_warn: bool) -> tuple[Parameters, Loop]:
        """Return the parameters and the loop; raise ControlError if an input is missing or its quality too low."""
        if not self._theta:
            raise ControlError('no parameters were received on pendubot/params; start the identifier')
        parameters = self.offer(self._theta)
        lag = self._assessed(accept_warn)
        if self._period is None:
            raise ControlError('too few samples were received on joint_states to know their rate; start the bridge')
        if not (limit := min(self._limit, self._board_limit)) > 0:
            raise ControlError(f'the bridge limits torques to {limit:g} N m; raise its torque_limit')
        return parameters, Loop(self._period, lag if self._motor_delay is None else self._motor_delay, limit)

    def _assessed(self, accept_warn: bool) -> float:
        """Return the motor delay [s], 0 if unknown; raise ControlError if the quality is too low or unknown."""
        how = 'set the parameter accept_warn to true to use them nevertheless'
        for level, message, values in reversed(self._assessments):
            if tuple(number(values.get(name)) for name in NAMES[: len(self._theta)]) != self._theta:
                continue
            if level is Level.ERROR:
                raise ControlError(f'the parameters are of level ERROR ({message}); record and identify again')
            if level is Level.WARN and not accept_warn:
                raise ControlError(f'the parameters are of level WARN ({message}); {how}')
            delay = number(values.get('effort.delay'))
            return max(0.0, delay) if math.isfinite(delay) else 0.0
        if not accept_warn:
            raise ControlError(
                f'the quality of the parameters on pendubot/params is not on pendubot/identification; {how}'
            )
        return 0.0
