"""The result of an identification as a YAML file, and as the plain data that ``--json`` prints."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import yaml

from pendubot_identification import __version__
from pendubot_identification.core.errors import ResultError
from pendubot_identification.core.identification import Identification
from pendubot_identification.core.parameters import NAMES, UNITS, Parameters

from .datasets import Source

SCHEMA = 1


def result_data(result: Identification, sources: Sequence[Source]) -> dict[str, Any]:
    """Return a result as plain numbers, strings, lists and dictionaries; what is not a number becomes None."""
    settings, validation = result.settings, result.validation
    return {
        'schema': SCHEMA,
        'parameters': {
            name: {'value': value, 'std_error': _number(error), 'unit': unit}
            for name, value, error, unit in zip(
                NAMES, result.parameters.vector().tolist(), result.std_error.tolist(), UNITS, strict=True
            )
        },
        'level': result.level.name,
        'warnings': list(result.warnings),
        'J': {
            'training': result.J,
            'training_runs': result.J_runs.tolist(),
            'least_squares': result.J_exact,
            'runs_at_least_squares': result.runs_at_minimum,
            'residuals': result.residuals,
            'validation': None if validation is None else validation.J,
            'validation_runs': None if validation is None else validation.J_runs.tolist(),
            'validation_method': None if validation is None else validation.method,
            'unit': 'J^2',
        },
        'condition_number': _number(result.condition_number),
        'covariance': [[_number(value) for value in row] for row in result.covariance.tolist()],
        'made_by': {
            'version': __version__,
            'criterion': settings.criterion,
            'sliding_window': settings.sliding,
            'smoothing': settings.smoothing,
            'model': settings.model,
            'optimizer': settings.optimizer,
            'runs': settings.runs,
            'population': settings.mde.population,
            'generations': settings.mde.generations,
            'seed': settings.seed,
            'lower_bounds': settings.bounds.lower.tolist(),
            'upper_bounds': settings.bounds.upper.tolist(),
        },
        'bags': [asdict(source) for source in sources],
    }


def refuse_existing(path: Path) -> None:
    """Refuse to write where something is; worth asking before a long computation too.

    Raises:
        ResultError: the file exists already.
    """
    if path.exists():
        raise ResultError(f'{path} exists already and was left as it is; choose another name or add --force')


def write_result(path: Path, data: Mapping[str, Any], *, overwrite: bool = False) -> None:
    """Write a result, whole or not at all.

    Raises:
        ResultError: the file exists already, or the system refuses to write it.
    """
    if not overwrite:
        refuse_existing(path)
    beside = path.with_name(path.name + '.partial')
    try:
        beside.write_text(yaml.safe_dump(dict(data), sort_keys=False, allow_unicode=True), encoding='utf-8')
        os.replace(beside, path)
    except OSError as error:
        beside.unlink(missing_ok=True)
        raise ResultError(f'{path} cannot be written ({error.strerror}); choose a folder that can be') from error


def read_result(path: Path) -> dict[str, Any]:
    """Return what a result file holds.

    Raises:
        ResultError: there is no such file, or it is no result of this schema.
    """
    try:
        data = yaml.safe_load(path.read_text(encoding='utf-8'))
    except OSError as error:
        raise ResultError(
            f'{path} cannot be read ({error.strerror}); name a file that pendubot identify wrote'
        ) from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ResultError(f'{path} is no YAML file; name a file that pendubot identify wrote') from error
    if not isinstance(data, dict) or data.get('schema') != SCHEMA:
        raise ResultError(f'{path} is no result of schema {SCHEMA}; name a file that pendubot identify wrote')
    return data


def read_parameters(path: Path) -> Parameters:
    """Return the parameters of a result file.

    Raises:
        ResultError: there is no such file, it is no result of this schema, or it lacks a parameter.
    """
    data = read_result(path)
    try:
        return Parameters(**{name: float(data['parameters'][name]['value']) for name in NAMES})
    except (KeyError, TypeError, ValueError) as error:
        raise ResultError(f'{path} lacks a number for one of {", ".join(NAMES)}; identify again') from error


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
