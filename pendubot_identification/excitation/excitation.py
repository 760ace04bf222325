# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The paper's pulse train (its Section 4.4), which makes the parameters identifiable, and its parameter file."""

import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pendubot_identification.arrays import Array
from pendubot_identification.errors import ParameterError, ResultError
from pendubot_identification.files import addressed, read_yaml, write_atomically
from pendubot_identification.resources import resource

NODE = 'exciter'
TEMPLATE = 'config/exciter.yaml'


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


def write_exciter(
    path: Path, train: PulseTrain, duration: float, comments: Sequence[str], *, overwrite: bool = False
) -> None:
    """Write a pulse train as the commented parameter file of the exciter; other parameters have their defaults.

    Raises:
        ResultError: the file exists already, or the system refuses to write it.
    """
    text = resource(TEMPLATE).read_text(encoding='utf-8')
    for name, value in {**asdict(train), 'duration': float(duration)}.items():
        text = re.sub(rf'^( *{name}:).*$', rf'\g<1> {value!r}', text, flags=re.MULTILINE)
    write_atomically(path, ''.join(f'# {line}\n' for line in comments) + text, overwrite=overwrite)


def read_exciter(path: Path) -> tuple[PulseTrain, float]:
    """Return the pulse train of a parameter file and its duration [s]; missing values have their defaults.

    Raises:
        ResultError: the file does not exist, or is no parameter file of the exciter.
        ParameterError: a value is out of range.
    """
    expected = f'expected is a file like {resource(TEMPLATE)}'
    data = read_yaml(path, expected)
    # Accept the node under any namespace.
    matching = [parameters for name, parameters in addressed(data) if name.rpartition('/')[2] in (NODE, '*', '**')]
    if not matching:
        raise ResultError(f'{path} holds no parameters of the node {NODE}; {expected}')
    values: dict[str, Any] = {'duration': 18.0} | {k: v for parameters in matching for k, v in parameters.items()}
    pulses: dict[str, Any] = asdict(PulseTrain())
    try:
        numbers = {name: type(default)(str(values.get(name, default))) for name, default in pulses.items()}
        return PulseTrain(**numbers), float(str(values['duration']))
    except ValueError as error:
        raise ParameterError(f'{path}: {error}; numbers are expected; {expected}') from error
