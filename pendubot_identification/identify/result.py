# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What an identification leaves behind: every answer, how far to trust it, and what it was made of.

One class for each part of a result file, its fields in the file's order and by the file's names. :func:`plain` makes of
them what YAML and JSON can hold, and :func:`structured` makes them of that again.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from enum import Enum
from types import UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np

from pendubot_identification.errors import ResultError
from pendubot_identification.level import NORMAL_95, Level
from pendubot_identification.model.parameters import Parameters

#: None stands for what is not known, or no finite number.
Number = float | None

SCHEMA = 1


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A parameter: its 95 % ``interval``, whether it lies on a bound, and whether the motion determines it.

    ``degrees_of_freedom``: of its standard error; None where it is normal.

    One that was ``held`` at its value does neither.
    """

    value: float
    std_error: Number = None
    degrees_of_freedom: Number = None
    interval: tuple[Number, Number] = (None, None)
    unit: str = ''
    on_bound: bool | None = None
    determined: bool | None = None
    held: bool = False

    @property
    def quantile(self) -> float:
        """Half-width of the 95 % interval in standard errors."""
        high = self.interval[1]
        return (high - self.value) / self.std_error if self.std_error and high is not None else NORMAL_95


@dataclass(frozen=True, kw_only=True)
class FaultFound:
    """A convention that the recordings break, see :class:`.diagnosis.Fault`; parts of the squared effort."""

    name: str
    found: str
    remedy: str
    unexplained: Number = None
    put_right: Number = None
    options: list[str] = field(default_factory=list)


@dataclass(frozen=True, kw_only=True)
class EffectFound:
    """An unmodelled effect, see :class:`.effects.FoundEffect`; ``moved``: P1 to P5 beside it, as fractions."""

    name: str
    where: str
    sizes: list[Number]
    gain: Number = None
    z: Number = None
    accepted: bool = False
    moved: list[Number] = field(default_factory=list)


@dataclass(frozen=True, kw_only=True)
class EffortTaken:
    """How the effort was taken [s]; ``linear_lag`` is the delay for who interpolates it linearly between samples."""

    hold: str = 'zero'
    delay: float = 0.0
    delay_std_error: Number = None
    linear_lag: float = 0.0
    unit: str = 's'


@dataclass(frozen=True, kw_only=True)
class ZeroFound:
    """How far off the zeros of one recording are: what was read minus what is true."""

    recording: str
    q1: Number
    q1_std_error: Number
    q2: Number
    q2_std_error: Number
    unit: str = 'degree'


@dataclass(frozen=True, kw_only=True)
class CriterionValue:
    """J, of each run where there are several, and its exact minimum where that is known."""

    unit: str
    training: Number
    training_runs: list[Number]
    least_squares: Number
    runs_at_least_squares: int | None
    residuals: int
    validation: Number
    validation_runs: list[Number]


@dataclass(frozen=True, kw_only=True)
class Predicted:
    """Simulation errors in standard deviations, and fits in per cent by state, by horizon [s]."""

    horizons: list[float]
    error: list[Number]
    persistence: list[Number]
    fit: dict[str, list[Number]]
    starts: list[int]


@dataclass(frozen=True, kw_only=True)
class _Method:
    method: str


@dataclass(frozen=True, kw_only=True)
class PublishedPrediction(Predicted, _Method):
    """The same of what is published, and what was predicted from what."""


@dataclass(frozen=True, kw_only=True)
class LinkLength:
    """P3 / P5 by the elbow's own equation, and what a ruler says."""

    value: Number
    std_error: Number
    expected: Number
    unit: str = 'm'


@dataclass(frozen=True, kw_only=True)
class Search:
    """How MDE searched, see :class:`.mde.MDESettings`."""

    runs: int
    population: int
    generations: int
    per_component: bool
    spread: Number


@dataclass(frozen=True, kw_only=True)
class Convergence:
    """Each run's best value, a row a run, after ever more generations."""

    generations: list[int]
    best: list[list[Number]]


@dataclass(frozen=True, kw_only=True)
class CriterionAnswer:
    """What one criterion said, see :class:`.estimate.Estimate`."""

    parameters: dict[str, Parameter]
    level: Level
    warnings: list[str]
    consequences: list[str] = field(default_factory=list)
    effort: EffortTaken
    J: CriterionValue
    prediction: Predicted
    condition_number: Number
    unexplained: Number
    zeros: list[ZeroFound]
    exact: bool
    converged: bool
    steps: list[str]
    mde: Search | None
    convergence: Convergence | None = None
    uncertainty: str
    correlation: list[list[Number]]


@dataclass(frozen=True, kw_only=True)
class MadeBy:
    """With what it was made, see :class:`.settings.Settings`.

    ``applied``: options of reading the recordings that they asked for themselves.
    """

    version: str
    criteria: list[str]
    model: str
    optimizer: str
    sliding_window: Number
    smoothing: Number
    hold: str
    delays: tuple[float, float]
    start: list[float] | None
    link_length: Number
    seed: int
    lower_bounds: list[float]
    upper_bounds: list[float]
    applied: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Source:
    """A bag that was used, or a part of it."""

    bag: str
    role: str
    samples: int
    duration: float
    sha256: str
    closed: bool
    topic: str = '/joint_states'
    joint_names: list[str] = field(default_factory=lambda: ['shoulder', 'elbow'])


def theta_of(parameters: Mapping[str, Parameter]) -> Parameters:
    """Return the parameter vector; what is absent is 0."""
    return Parameters(**{name: entry.value for name, entry in parameters.items()})


class _Vector:
    """What can be asked of parameters by name."""

    parameters: dict[str, Parameter]

    @property
    def theta(self) -> Parameters:
        """The parameter vector; what is absent is 0."""
        return theta_of(self.parameters)

    def unphysical(self) -> list[str]:
        """Return why no rig can have these parameters, in the words of an identification's warnings."""
        return [f'not physical: {problem}' for problem in self.theta.unphysical()]


@dataclass(frozen=True, kw_only=True)
class Result(_Vector):
    """All of it. The published parameters come first: who looks for a name takes the first that stands there.

    Attributes:
        not_covered: by name, parameters of which the level says nothing, and why; None in results of earlier versions.
        consequences: what follows from a grave fault.
        unmodelled: fraction of the innovations' variance at shoulder and elbow that nothing known explains.
        not_in_model: the parameters that the rig cannot have, and why.
        reading: how the recordings were read, see :class:`.conversion.Conversion`.
        covariance_rank: below the number of parameters where it comes from few recordings; None in earlier results.
    """

    schema: int = SCHEMA
    parameters: dict[str, Parameter]
    level: Level
    not_covered: dict[str, str] | None = None
    warnings: list[str]
    consequences: list[str] = field(default_factory=list)
    faults: list[FaultFound] = field(default_factory=list)
    effects: list[EffectFound] = field(default_factory=list)
    unmodelled: list[Number] | None = None
    advice: list[str] = field(default_factory=list)
    criterion: str
    model: str
    not_in_model: list[str] = field(default_factory=list)
    effort: EffortTaken
    zeros: list[ZeroFound]
    smoothing: float
    J: CriterionValue
    prediction: PublishedPrediction
    link_length: LinkLength
    condition_number: Number
    criteria: dict[str, CriterionAnswer]
    covariance: list[list[Number]]
    covariance_rank: int | None = None
    made_by: MadeBy
    reading: dict[str, str] = field(default_factory=dict)
    bags: list[Source]


@dataclass(frozen=True, kw_only=True)
class Software:
    """The version that made a result."""

    version: str = 'of an unknown version'


@dataclass(frozen=True, kw_only=True)
class Given(_Vector):
    """What is taken of any result, also of one that a hand wrote: parameters, and what else it says.

    Attributes:
        parameters: in the order of theta; those that are 0 may be absent.
        level: None where nobody judged them; likewise criterion and model.
    """

    parameters: dict[str, Parameter]
    level: Level | None = None
    not_covered: dict[str, str] | None = None
    warnings: list[str] = field(default_factory=list)
    effects: list[EffectFound] = field(default_factory=list)
    criterion: str | None = None
    model: str | None = None
    effort: EffortTaken = field(default_factory=EffortTaken)
    made_by: Software = field(default_factory=Software)
    bags: list[Source] = field(default_factory=list)


def plain(value: Any) -> Any:
    """Return a value as what YAML and JSON can hold: None, bool, int, float, str, list and dict, and nothing derived.

    Numbers and arrays of numpy become Python's, an enumeration its name, an object of a dataclass a dictionary; a
    number that is not finite becomes None.

    Raises:
        TypeError: something else is in it.
    """
    if isinstance(value, (np.ndarray, np.generic)):
        value = value.tolist()
    if value is None or isinstance(value, bool):
        return value
    if isinstance(value, Enum):
        return value.name
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, (int, str)):
        return int(value) if isinstance(value, int) else str(value)
    if is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(entry) for entry in value]
    raise TypeError(f'a result cannot hold {value!r}')


def structured(kind: Any, data: Any, file: object, *at: str) -> Any:
    """Return plain data as an object of a class of this module, or as what the type of one of its fields says.

    What a class does not know is left out; what is missing, or None, takes its default. A number may be a word: YAML
    takes 4e-4 for one.

    Args:
        kind: the class or type.
        data: what YAML or JSON hold.
        file: from which they come, for the user.
        at: the entry in it.

    Raises:
        ResultError: something is missing, or is not what is expected.
    """
    origin, inner = get_origin(kind), get_args(kind)
    if origin in (Union, UnionType):
        unknown = data is None or (isinstance(data, float) and not math.isfinite(data))
        return None if unknown else structured(inner[0], data, file, *at)
    if isinstance(kind, type) and is_dataclass(kind) and isinstance(data, Mapping):
        needed = [f.name for f in fields(kind) if f.default is MISSING and f.default_factory is MISSING]
        if missing := [name for name in needed if name not in data]:
            where = f'{file}: {".".join(at)}' if at else file
            raise ResultError(
                f'{where} does not say {", ".join(missing)}; name a file that pendubot identify wrote, as it wrote it'
            )
        types = get_type_hints(kind)
        names = [f.name for f in fields(kind) if f.name in needed or data.get(f.name) is not None]
        return kind(**{name: structured(types[name], data[name], file, *at, name) for name in names})
    if origin is dict and isinstance(data, Mapping):
        return {str(key): structured(inner[1], value, file, *at, str(key)) for key, value in data.items()}
    if origin is list and isinstance(data, list):
        return [structured(inner[0], value, file, *at, str(k)) for k, value in enumerate(data)]
    if origin is tuple and isinstance(data, list) and len(data) == len(inner):
        return tuple(structured(inner[k], value, file, *at, str(k)) for k, value in enumerate(data))
    if kind is Level and isinstance(data, str) and data in Level.__members__:
        return Level[data]
    if kind is float and type(data) in (int, float, str):
        with suppress(ValueError, OverflowError):
            if math.isfinite(number := float(data)):
                return number
    if kind in (bool, int, str) and type(data) is kind:
        return data
    expected = EXPECTED.get(origin or kind, 'entries by name are')
    raise ResultError(f'{file}: {".".join(at)} is {data!r}; {expected} expected in its place')


#: What stands for which type, for the user.
EXPECTED: dict[Any, str] = {
    float: 'a number is',
    int: 'a whole number is',
    bool: 'true or false is',
    str: 'a text is',
    list: 'a list is',
    tuple: 'two numbers are',
    Level: 'OK, WARN or ERROR is',
}
