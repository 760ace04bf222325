# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The torque that makes the parameters identifiable: the paper's pulse train (its Section 4.4)."""

from dataclasses import dataclass

import numpy as np

from pendubot_identification.arrays import Array
from pendubot_identification.errors import ParameterError


@dataclass(frozen=True, slots=True)
class PulseTrain:
    """Pulses at a fixed period; within a pulse the torque takes a new random value every ``hold`` seconds.

    The paper's period and torque range are not known; the defaults excite the virtual rig well.

    Raises:
        ParameterError: a value is out of range.
    """

    period: float = 1.0  #: Time from one pulse to the next [s].
    width: float = 0.05  #: Duration of a pulse as a fraction of the period (5 % in the paper).
    amplitude_min: float = -1.0  #: Least torque within a pulse [N m].
    amplitude_max: float = 1.0  #: Greatest torque within a pulse [N m].
    hold: float = 0.01  #: Hold time of each random torque [s].
    seed: int = 1  #: Same seed, same torque.

    def __post_init__(self) -> None:
        for name, time in (('period', self.period), ('hold', self.hold)):
            if not 0 < time < np.inf:
                raise ParameterError(f'{name} is {time:g} s; a time above 0 is expected')
        if not 0 < self.width <= 1:
            raise ParameterError(
                f'width is {self.width:g}; a fraction of the period, above 0 and at most 1, is expected'
            )
        if not (np.isfinite(self.amplitude_min) and np.isfinite(self.amplitude_max)):
            raise ParameterError('amplitude_min or amplitude_max is not finite; torques in N m are expected')
        if self.amplitude_min >= self.amplitude_max:
            raise ParameterError(
                f'amplitude_min {self.amplitude_min:g} is not below amplitude_max {self.amplitude_max:g}; give the '
                'smaller torque first'
            )
        if self.seed < 0:
            raise ParameterError(f'seed is {self.seed}; a whole number of at least 0 is expected')

    def torque(self, t: float) -> float:
        """Return the torque [N m] at ``t`` [s] after the start; 0 before it and between pulses."""
        return float(self.torques(np.array([t]))[0])

    def torques(self, t: Array) -> Array:
        """Return :meth:`torque` at many times [s], shape (N,)."""
        # Sampling times may coincide with edges of pulses: an offset of 0.5 us prevents effects of rounding errors.
        pulse, phase = np.divmod(t + 5e-7, self.period)
        within = (t >= 0) & (phase < self.width * self.period)
        number = (phase / self.hold).astype(np.intp)
        result = np.zeros(len(t))
        for index in np.unique(pulse[within]):
            here = within & (pulse == index)
            rng = np.random.default_rng([self.seed, int(index)])
            values = rng.uniform(self.amplitude_min, self.amplitude_max, int(number[here].max()) + 1)
            result[here] = values[number[here]]
        return result
