# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Results as YAML files."""

from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from pendubot_identification.arrays import Array
from pendubot_identification.errors import ResultError
from pendubot_identification.files import read_yaml, yaml_text
from pendubot_identification.model.parameters import MODELS, NAMES, Parameters

from .result import SCHEMA, PartialResult, Result, plain

T = TypeVar('T')

REQUIRED = NAMES[: MODELS['viscous']]
EXPECTED = 'name a file that pendubot identify wrote'


def result_text(result: PartialResult) -> str:
    """Return a result as the YAML text of its file."""
    return yaml_text(plain(result))


def read_result(path: Path) -> PartialResult:
    """Return the result of a file: a :class:`.Result` if the file is complete, else a :class:`.PartialResult`.

    Raises:
        ResultError: the file does not exist or has another schema, or an entry is invalid.
    """
    data = _read(path)
    with suppress(ResultError):
        return structured(Result, data, path)
    return structured(PartialResult, data, path)


def read_complete_result(path: Path) -> Result:
    """Return the result of a file that an identification wrote. May raise ResultError."""
    return structured(Result, _read(path), path)


def read_estimate(path: Path) -> tuple[Parameters, Array | None]:
    """Return the parameters of a result file, 0 if absent, and all standard errors, shape (D,); None if one is missing.

    Raises:
        ResultError: as :func:`read_result`.
    """
    result = read_result(path)
    names = NAMES[: len(result.theta.vector())]
    errors = [result.parameters[name].std_error if name in result.parameters else 0.0 for name in names]
    return result.theta, None if None in errors else np.array(errors, dtype=float)


def structured(kind: type[T], data: Any, file: object) -> T:
    """Return the content of a file as a result; unknown entries are ignored. May raise ResultError."""
    import pydantic

    try:
        if hasattr(pydantic, 'TypeAdapter'):
            return pydantic.TypeAdapter(kind).validate_python(data)
        return pydantic.parse_obj_as(kind, data)  # pydantic 1, of Ubuntu 24.04
    except pydantic.ValidationError as error:
        problem: dict[str, Any] = dict(error.errors()[0])
    entry = '.'.join(str(key) for key in problem['loc'] if key != '__root__') or 'the result'
    if problem['type'].endswith('missing'):
        raise ResultError(f'{file} has no entry {entry}; {EXPECTED}, unchanged')
    value = problem.get('input', {})  # missing in pydantic 1
    found = '' if isinstance(value, dict) else f' is {value!r}'
    raise ResultError(f'{file}: {entry}{found}; {problem["msg"].removeprefix("Value error, ")}; {EXPECTED}, unchanged')


def _read(path: Path) -> dict[str, Any]:
    """Return the content of a result file, its parameters in the order of theta, or raise ResultError."""
    data = read_yaml(path, EXPECTED)
    if not isinstance(data, dict) or data.get('schema') != SCHEMA:
        raise ResultError(f'{path} is no result of schema {SCHEMA}; {EXPECTED}')
    entries = data.get('parameters')
    entries = entries if isinstance(entries, dict) else {}
    wrong = [str(name) for name in dict.fromkeys([*REQUIRED, *entries]) if name not in NAMES or name not in entries]
    if wrong:
        raise ResultError(
            f'{path} has no parameter vector: check {", ".join(wrong)}; one number each is expected for '
            f'{", ".join(REQUIRED)} and, if they are not 0, for {", ".join(NAMES[len(REQUIRED) :])}'
        )
    return {**data, 'parameters': {name: entries[name] for name in NAMES if name in entries}}
