# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A result in the formats of who uses it: ROS parameters, JSON, MATLAB, C. Numbers keep every digit."""

from __future__ import annotations

import json
from collections.abc import Callable

import yaml

from pendubot_identification.identify.result import Given, Parameter, Result, plain
from pendubot_identification.model.parameters import MODELS, NAMES, SPECIFICATIONS

Exported = Result | Given

MEANINGS = {s.name: (s.unit, s.meaning) for s in SPECIFICATIONS}


def provenance(result: Exported) -> list[str]:
    """Return, line by line, where the numbers come from and how far to trust them; never an empty list."""
    criterion, model = result.criterion or 'not known', result.model or 'not known'
    lines = [
        'Parameters of a pendubot, SI units; q1 is measured from the horizontal, q2 relative to link 1',
        f'made by pendubot_identification {result.made_by.version}; criterion {criterion}, model {model}',
        *(f'{bag.role}: {bag.bag}, sha256 {bag.sha256}' for bag in result.bags),
        f'level: {"not known" if result.level is None else result.level.name}',
        *(f'warning: {warning}' for warning in result.warnings),
        *(f'{name} is not covered by the level: {why}' for name, why in (result.not_covered or {}).items()),
    ]
    return [' '.join(str(line).split()) for line in lines]


def as_yaml(result: Exported) -> str:
    """Return parameters for ``--params-file`` of any node: P1, P2, ... under ``/**``."""
    parameters = _vector(result)
    comments = [*provenance(result), *(f'{name}: {_described(name, entry)}' for name, entry in parameters.items())]
    values = {name: entry.value for name, entry in parameters.items()}
    content = yaml.safe_dump({'/**': {'ros__parameters': values}}, sort_keys=False)
    return ''.join(f'# {line}\n' for line in comments) + content


def as_json(result: Exported) -> str:
    """Return the whole result."""
    return json.dumps(plain(result), indent=2) + '\n'


def as_matlab(result: Exported) -> str:
    """Return a script that makes a struct ``pendubot``: parameters by name, ``theta``, ``names``, ``std_error``."""
    parameters = _vector(result)
    lines = [
        *(f'% {line}' for line in provenance(result)),
        *(f'pendubot.{name} = {_number(e.value)};  % {_described(name, e)}' for name, e in parameters.items()),
        f'pendubot.theta = [{" ".join(_number(entry.value) for entry in parameters.values())}];',
        f'pendubot.std_error = [{" ".join(_number(entry.std_error) for entry in parameters.values())}];',
        f'pendubot.names = {{{", ".join(repr(name) for name in parameters)}}};',
    ]
    return '\n'.join(lines) + '\n'


def as_c(result: Exported) -> str:
    """Return a header of macros: ``PENDUBOT_P1`` ..., ``PENDUBOT_THETA``, an initialiser, ``PENDUBOT_COUNT``."""
    parameters = _vector(result)
    lines = [
        '/*',
        *(f' * {line.replace("*/", "* /").replace("/*", "/ *")}' for line in provenance(result)),
        ' */',
        '#ifndef PENDUBOT_PARAMETERS_H',
        '#define PENDUBOT_PARAMETERS_H',
        '',
        *(
            f'#define PENDUBOT_{name} ({_number(e.value)})  /* {_described(name, e)} */'
            for name, e in parameters.items()
        ),
        '',
        f'#define PENDUBOT_COUNT {len(parameters)}',
        f'#define PENDUBOT_THETA {{{", ".join(f"PENDUBOT_{name}" for name in parameters)}}}',
        '',
        '#endif',
    ]
    return '\n'.join(lines) + '\n'


FORMATS: dict[str, Callable[[Exported], str]] = {'yaml': as_yaml, 'json': as_json, 'matlab': as_matlab, 'c': as_c}
SUFFIXES = {'.yaml': 'yaml', '.yml': 'yaml', '.json': 'json', '.m': 'matlab', '.h': 'c'}


def _vector(result: Exported) -> dict[str, Parameter]:
    """Return the entries in the order of theta; 0 for those that a hand left out, as far as the model goes."""
    last = max(NAMES.index(name) for name in result.parameters)
    size = min(size for size in MODELS.values() if size > last)
    return {name: result.parameters.get(name, Parameter(value=0.0)) for name in NAMES[:size]}


def _described(name: str, entry: Parameter) -> str:
    """Return unit, meaning, and how certain."""
    unit, meaning = MEANINGS[name]
    error = entry.std_error
    return f'{unit}; {meaning}' + ('' if error is None else f'; standard error {error:.2g}')


def _number(value: float | None) -> str:
    return 'NaN' if value is None else repr(float(value))
