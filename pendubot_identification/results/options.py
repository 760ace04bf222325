# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Makes the settings of an identification from options by name, from the command line, Python or the node."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pendubot_identification.errors import ParameterError
from pendubot_identification.identification import OPTIONS, START
from pendubot_identification.identification.settings import FIELDS, Settings
from pendubot_identification.model.parameters import Bounds, Parameters, default_bounds
from pendubot_identification.setting import interval
from pendubot_identification.trajectories.conventions import CONVERSION
from pendubot_identification.trajectories.conversion import Conversion

from .result import read_result


def settings_of(options: Mapping[str, Any], bounds: Bounds | None = None) -> Settings:
    """Return the settings for options of identification and conversion by name; None selects the default.

    Raises:
        PendubotError: an option is unknown, its value is invalid, or the start file cannot be read.
    """
    given = {name: value for name, value in options.items() if value is not None}
    known = {option.name: option for option in OPTIONS}
    conversion = {option.name: given.pop(option.name) for option in CONVERSION if option.name in given}
    if unknown := given.keys() - known.keys():
        names = ', '.join(option.name for option in (*OPTIONS, *CONVERSION))
        raise ParameterError(f'there is no option {min(unknown)!r}; the options are {names}')
    start = given.pop(START.name, None)
    chosen = {FIELDS.get(name, name): known[name].parse(value) for name, value in given.items()}
    if start is not None:
        if not isinstance(start, (str, Path, Parameters)):
            found = f'start is of type {type(start).__name__}'
            raise ParameterError(f'{found}; a result file or a Pendubot, such as found.pendubot, is expected')
        chosen[START.name] = start if isinstance(start, Parameters) else read_result(Path(start)).theta
    return Settings(bounds=bounds or default_bounds(), reading=Conversion.of(conversion), **chosen)


def bounds_of(given: Mapping[str, Any] | Sequence[str]) -> Bounds:
    """Return the default search box with the given intervals, by parameter or as texts NAME=LOW:HIGH.

    A single number fixes a parameter.

    Raises:
        ParameterError: a parameter is unknown or repeated, or its interval is invalid.
    """
    bounds, seen = default_bounds(), set[str]()
    pairs = given.items() if isinstance(given, Mapping) else (each.partition('=')[::2] for each in given)
    for name, ends in pairs:
        if name in seen:
            raise ParameterError(f'the interval of {name} was given twice; give one of both')
        seen.add(name)
        bounds = bounds.replaced(name, *interval(name, ends, 'P1=0:0.5 or b2=0'))
    return bounds
