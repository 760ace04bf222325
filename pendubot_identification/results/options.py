# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The settings of an identification from options by name, as the command line, Python and the node give them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pendubot_identification.errors import ParameterError
from pendubot_identification.identify.options import CRITERION, DELAY, OPTIONS, START
from pendubot_identification.identify.settings import Settings
from pendubot_identification.model.parameters import Bounds, Parameters, default_bounds
from pendubot_identification.setting import Setting
from pendubot_identification.trajectories.conventions import CONVERSION
from pendubot_identification.trajectories.conversion import Conversion

from .result_file import read_parameters

#: From a text to a value, by the type of an option's default.
CONVERTERS: Mapping[type, Any] = {
    bool: lambda text: {'true': True, 'false': False}[text.lower()],
    int: int,
    float: float,
    str: str,
}


def settings_of(options: Mapping[str, Any], bounds: Bounds | None = None) -> Settings:
    """Return the settings of options of identification and conversion by name; None asks for the default.

    Raises:
        ParameterError: there is no such option, or its value is invalid.
        ResultError: the file of the option start cannot be read.
    """
    given = {name: value for name, value in options.items() if value is not None}
    known = {option.name: option for option in OPTIONS}
    conversion = {option.name: given.pop(option.name) for option in CONVERSION if option.name in given}
    if unknown := given.keys() - known.keys():
        names = ', '.join(option.name for option in (*OPTIONS, *CONVERSION))
        raise ParameterError(f'there is no option {min(unknown)!r}; the options are {names}')
    chosen = {name: _value(known[name], value) for name, value in given.items()}
    return Settings.of(bounds=bounds or default_bounds(), reading=Conversion.of(conversion), **chosen)


def bounds_of(intervals: Mapping[str, Any]) -> Bounds:
    """Return the default search box with other intervals of some parameters; a single number fixes a parameter.

    Raises:
        ParameterError: there is no such parameter, or its interval is invalid.
    """
    bounds = default_bounds()
    for name, interval in intervals.items():
        bounds = bounds.replaced(name, *interval_of(name, interval, 'P1=0:0.5 or b2=0'))
    return bounds


def interval_of(name: str, value: Any, example: str) -> tuple[float, float]:
    """Return the ends of an interval, which is a text LOW:HIGH, a pair of numbers, or one number for both.

    Raises:
        ParameterError: it is none of these.
    """
    ends = value.split(':') if isinstance(value, str) else value if isinstance(value, (list, tuple)) else [value]
    try:
        low, high = map(float, ends if len(ends) > 1 else [*ends, *ends])
    except (TypeError, ValueError):
        raise ParameterError(
            f'{name} {value!r} is not understood; LOW:HIGH or one number is expected, such as {example}'
        ) from None
    return low, high


def _value(option: Setting, value: Any) -> Any:
    """Return the value of an option as its type."""
    if option is CRITERION:
        names = value.split(',') if isinstance(value, str) else value
        return tuple(dict.fromkeys(name.strip() for name in names))
    if option is DELAY:
        return interval_of('delay', value, '0:0.02')
    if option is START:
        return value if isinstance(value, Parameters) else read_parameters(Path(value))
    try:
        return CONVERTERS[type(option.default)](str(value))
    except (KeyError, ValueError):
        raise option.refusal(value) from None
