# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The paper's pulse train (its Section 4.4), which makes the parameters identifiable, and its parameter file."""

import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from pendubot_identification.arrays import Array
from pendubot_identification.errors import ParameterError, ResultError
from pendubot_identification.files import addressed, parameter_names, read_yaml, write_atomically
from pendubot_identification.resources import resource
from pendubot_identification.setting import Setting, meant

NODE = 'exciter'
TEMPLATE = 'config/exciter.yaml'
#: Parameters that ROS declares for every node.
OF_ROS = ('qos_overrides', 'start_type_description_service', 'use_sim_time')


@dataclass(frozen=True)
class PulseTrain:
    """Pulses at a fixed period; within a pulse the torque takes a new random value every ``hold`` seconds.

    The paper's period and torque range are not known; the defaults excite the virtual rig well. :data:`SETTINGS` has
    the meanings and ranges.

    Raises:
        ParameterError: a value is out of range.
    """

    period: float = 1.0
    width: float = 0.05
    amplitude_min: float = -1.0
    amplitude_max: float = 1.0
    hold: float = 0.01
    seed: int = 1

    def __post_init__(self) -> None:
        for setting in SETTINGS:
            setting.check(getattr(self, setting.name))
        if self.amplitude_min >= self.amplitude_max:
            raise ParameterError(
                f'amplitude_min {self.amplitude_min:g} is not below amplitude_max {self.amplitude_max:g}; give the '
                'smaller torque first'
            )

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


#: The parameters of a pulse train.
SETTINGS = (
    Setting('period', PulseTrain.period, 'time from one pulse to the next', 's', 0.01, 3600.0),
    Setting('width', PulseTrain.width, 'length of a pulse as a fraction of the period (the paper: 0.05)', '', 1e-3, 1),
    Setting('amplitude_min', PulseTrain.amplitude_min, 'smallest torque within a pulse', 'N m', -1000.0, 1000.0),
    Setting('amplitude_max', PulseTrain.amplitude_max, 'largest torque within a pulse', 'N m', -1000.0, 1000.0),
    Setting('hold', PulseTrain.hold, 'duration of each random torque', 's', 1e-4, 60.0),
    Setting('seed', PulseTrain.seed, 'seed of the torques', '', 0, 2**31 - 1),
)
DURATION = Setting('duration', 18.0, 'length of the excitation; 0: until stopped', 's', 0.0, 86400.0)


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
    matching = [parameters for node, parameters in addressed(data) if node.rpartition('/')[2] in (NODE, '*', '**')]
    values = {name: value for parameters in matching for name, value in parameters.items()}
    if not values:
        raise ResultError(f'{path} holds no parameters of the node {NODE}; {expected}')
    known = parameter_names([resource(TEMPLATE)])
    # A section for all nodes may have parameters of other nodes.
    for name in sorted(parameter_names([path], f'/{NODE}') - known):
        if not name.startswith(OF_ROS):
            raise ParameterError(f'{path}: {NODE} has no parameter {name}; {meant(name, sorted(known))}?')
    try:
        *pulses, duration = (each.parse(values.get(each.name, each.default)) for each in (*SETTINGS, DURATION))
        return PulseTrain(*pulses), duration
    except ParameterError as error:
        raise ParameterError(f'{path}: {error}; {expected}') from error
