# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Write a pulse train to the parameter file of the exciter, and read it back."""

import re
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pendubot_identification.errors import ParameterError, ResultError
from pendubot_identification.excitation.excitation import PulseTrain
from pendubot_identification.files import read_yaml, write_atomically
from pendubot_identification.parameter_files import addressed
from pendubot_identification.resources import resource

NODE = 'exciter'
TEMPLATE = 'config/exciter.yaml'


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
