# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The result of an identification: one class for each part of a result file, with the file's names, and its YAML file.

All values are plain YAML and JSON, so that file, ``--json``, report, messages and Python share them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from pendubot_identification import __version__
from pendubot_identification.arrays import Array
from pendubot_identification.errors import ResultError
from pendubot_identification.files import read_yaml, yaml_text
from pendubot_identification.level import NORMAL_95, Level
from pendubot_identification.model.parameters import MODELS, NAMES, Parameters
from pendubot_identification.trajectories.trajectory import Source

T = TypeVar('T')
SCHEMA = 1
#: The parameters of every result file; the name of such a file in messages.
REQUIRED = NAMES[: MODELS['viscous']]
EXPECTED = 'name a file that pendubot identify wrote'


def _read_by(read: Callable[[Any], Any]) -> Any:
    """Return the type of entries that a function validates, for pydantic 1 (of Ubuntu 24.04) and 2."""

    class Entry:
        @classmethod
        def __get_validators__(cls) -> Iterator[Callable[[Any], Any]]:
            yield read

        @classmethod
        def __get_pydantic_core_schema__(cls, _: object, handler: Any) -> Any:
            from pydantic import PlainValidator

            return PlainValidator(read).__get_pydantic_core_schema__(Any, handler)

    return Entry


def _number(value: Any) -> float | None:
    if isinstance(value, (int, float, str)) and not isinstance(value, bool):
        with suppress(ValueError, OverflowError):
            return known(float(value))  # YAML reads 4e-4 as a text
    raise ValueError('a number is expected')


def _finite(value: Any) -> float:
    if (number := _number(value)) is None:
        raise ValueError('a number is expected')
    return number


def _size(value: Any) -> float | None:
    if (number := _number(value)) is not None and number < 0:
        raise ValueError('a number of at least 0 is expected')
    return number


def _level(value: Any) -> Level:
    if not isinstance(value, str) or value not in Level.__members__:
        raise ValueError(f'one of {", ".join(Level.__members__)} is expected')
    return Level[value]


if TYPE_CHECKING:
    Finite = float
    Number = float | None
    Size = float | None
    LevelByName = Level
else:
    Finite = _read_by(_finite)
    Number = _read_by(_number) | None  #: None if unknown.
    Size = _read_by(_size) | None  #: the same, of at least 0.
    LevelByName = _read_by(_level)


def known(value: Any) -> Any:
    """Return a value as built-in numbers, lists and dictionaries, with None for numbers that are not finite."""
    if isinstance(value, (np.ndarray, np.generic)):
        return known(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: known(entry) for key, entry in value.items()}
    return [known(entry) for entry in value] if isinstance(value, (list, tuple)) else value


def plain(result: PartialResult) -> dict[str, Any]:
    """Return a result as a dictionary that YAML and JSON can hold, with the keys and the order of its file."""

    def named(entries: list[tuple[str, Any]]) -> dict[str, Any]:
        return {key: value.name if isinstance(value, Level) else value for key, value in entries}

    return {'schema': SCHEMA, **asdict(result, dict_factory=named)}


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """An estimated parameter."""

    value: Finite
    std_error: Size = None
    degrees_of_freedom: Number = None  #: of the standard error; None for a normal distribution.
    interval: tuple[Number, Number] = (None, None)  #: 95 % confidence interval.
    unit: str = ''
    on_bound: bool | None = None  #: whether the value lies on a bound of its search interval.
    determined: bool | None = None  #: whether the motion determines the parameter; None if it was fixed.
    fixed: bool = False

    @property
    def quantile(self) -> float:
        """Half-width of the 95 % interval in standard errors."""
        high = self.interval[1]
        return (high - self.value) / self.std_error if self.std_error and high is not None else NORMAL_95


@dataclass(frozen=True, kw_only=True)
class DataFault:
    """A convention that the recordings violate, see :class:`.conventions.Fault`."""

    name: str
    found: str
    remedy: str
    unexplained: Number
    corrected: Number
    options: list[str]


@dataclass(frozen=True, kw_only=True)
class ReportedEffect:
    """An unmodelled effect, see :class:`.effects.DetectedEffect`."""

    name: str
    where: str
    sizes: list[Number]
    gain: Number
    z: Number
    accepted: bool


@dataclass(frozen=True, kw_only=True)
class EffortTiming:
    """Hold and delay [s] of the effort; ``linear_lag`` is the delay for linear interpolation between samples."""

    hold: str = 'zero'
    delay: Finite = 0.0
    delay_std_error: Number = None
    linear_lag: Finite = 0.0
    unit: str = 's'


@dataclass(frozen=True, kw_only=True)
class ZeroError:
    """The errors of a recording's zeros: recorded minus true angles."""

    recording: str
    q1: Number
    q1_std_error: Number
    q2: Number
    q2_std_error: Number
    unit: str = 'degree'


@dataclass(frozen=True, kw_only=True)
class CriterionValue:
    """Value J of a criterion for the estimate and for each run of MDE, and its exact minimum if known."""

    unit: str
    training: Number
    training_runs: list[Number]
    least_squares: Number
    residuals: int
    validation: Number


@dataclass(frozen=True, kw_only=True)
class Predicted:
    """Simulation errors in standard deviations, and the fit of each state in per cent, by horizon [s]."""

    method: str = ''  #: validation method.
    horizons: list[Finite]
    error: list[Number]
    persistence: list[Number]
    fit: dict[str, list[Number]]
    starts: list[int]


@dataclass(frozen=True, kw_only=True)
class LinkLength:
    """Length of link 1: P3 / P5 by the elbow's equation of motion, and the measured value."""

    value: Number
    std_error: Number
    expected: Number
    unit: str = 'm'


@dataclass(frozen=True, kw_only=True)
class Search:
    """Settings of MDE, see :class:`.mde.MDESettings`."""

    runs: int
    population: int
    generations: int
    per_component: bool
    spread: Number


@dataclass(frozen=True, kw_only=True)
class CriterionAnswer:
    """The estimate by one criterion, see :class:`.estimate.Estimate`."""

    parameters: dict[str, Parameter]
    level: LevelByName
    warnings: list[str]
    consequences: list[str]
    effort: EffortTiming
    J: CriterionValue
    prediction: Predicted
    condition_number: Number
    unexplained: Number
    zeros: list[ZeroError]
    steps: list[str]
    mde: Search | None
    uncertainty: str
    correlation: list[list[Number]]


@dataclass(frozen=True, kw_only=True)
class Software:
    """The software version that made a result."""

    version: str = 'of an unknown version'


@dataclass(frozen=True, kw_only=True)
class Provenance(Software):
    """The settings of an identification, see :class:`.settings.Settings`."""

    criteria: list[str]
    model: str
    optimizer: str
    sliding_window: Number
    smoothing: Number
    hold: str
    delays: list[Finite]
    start: list[Finite] | None
    link_length: Number
    link_mass: Number = None
    seed: int
    lower_bounds: list[Finite]
    upper_bounds: list[Finite]
    applied: list[str]  #: conversion options that the program applied as corrections.


def theta_of(parameters: Mapping[str, Parameter]) -> Parameters:
    """Return the parameter vector; absent parameters are 0."""
    return Parameters(**{name: entry.value for name, entry in parameters.items()})


@dataclass(frozen=True, kw_only=True)
class PartialResult:
    """Parameters, and further entries for other programs; a file written by hand has parameters alone."""

    parameters: dict[str, Parameter]  #: in the order of theta; zero parameters may be absent.
    level: LevelByName | None = None  #: None if the parameters were not assessed.
    not_covered: dict[str, str] = field(default_factory=dict)  #: reason by parameter that the level does not cover.
    warnings: list[str] = field(default_factory=list)
    criterion: str | None = None
    model: str | None = None
    effort: EffortTiming = field(default_factory=EffortTiming)
    effects: list[ReportedEffect] = field(default_factory=list)
    made_by: Software = field(default_factory=Software)
    bags: list[Source] = field(default_factory=list)

    @property
    def theta(self) -> Parameters:
        """The parameter vector; absent parameters are 0."""
        return theta_of(self.parameters)

    def unphysical(self) -> list[str]:
        """Return warnings about physically impossible parameters, worded as in an identification."""
        return [f'not physical: {problem}' for problem in self.theta.unphysical()]


@dataclass(frozen=True, kw_only=True)
class Result(PartialResult):
    """The result of an identification; ``field()`` requires entries that may be absent from a partial result."""

    level: LevelByName = field()
    warnings: list[str] = field()
    criterion: str = field()
    model: str = field()
    effort: EffortTiming = field()
    made_by: Provenance = field()
    bags: list[Source] = field()
    consequences: list[str]  #: further findings that follow from a severe fault.
    faults: list[DataFault]
    unmodelled: list[Number] | None  #: unexplained fraction of the innovation variance of shoulder and elbow.
    advice: list[str]
    not_in_model: list[str]  #: parameters without influence on this rig, and the reason.
    zeros: list[ZeroError]
    smoothing: Finite
    J: CriterionValue
    prediction: Predicted
    link_length: LinkLength
    condition_number: Number
    criteria: dict[str, CriterionAnswer]
    covariance: list[list[Number]]
    reading: dict[str, str]  #: conversion options of the recordings, see :class:`.conversion.Conversion`.


@dataclass(frozen=True, kw_only=True)
class Tracked:
    """The history of tracked parameters."""

    bags: list[str]
    until: Finite  #: the last time [s].
    notes: dict[str, int]  #: number of occurrences by remark.
    windows: list[str]  #: informative windows, BAG@START:END.
    events: list[dict[str, Any]]  #: changes, disturbances and losses, each with its kind, times [s] and text.
    t: list[Finite]  #: times of the following histories [s].
    unexplained: list[Number]  #: unexplained torque [N m].
    values: dict[str, list[Finite]]
    std_errors: dict[str, list[Number]]


@dataclass(frozen=True, kw_only=True)
class TrackedResult(PartialResult):
    """The newest parameters of a tracked rig, and their history."""

    made_by: Software = field(default_factory=lambda: Software(version=__version__))
    tracked: Tracked


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


def estimate_of(result: PartialResult) -> tuple[Parameters, Array | None]:
    """Return the parameters of a result, 0 if absent, and all standard errors, shape (D,); None if one is missing."""
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
