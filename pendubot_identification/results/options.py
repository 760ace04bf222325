# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Makes the settings of an identification from options by name, from the command line, Python or the node."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pendubot_identification.errors import ParameterError
from pendubot_identification.identification.options import APPLY_REMEDIES, OPTIONS, START
from pendubot_identification.identification.settings import Settings
from pendubot_identification.model.parameters import Bounds, Parameters, default_bounds
from pendubot_identification.setting import interval
from pendubot_identification.trajectories.conventions import CONVERSION
from pendubot_identification.trajectories.conversion import Conversion

from .result import read_result

#: Options with another name in Python.
RENAMED = {'joints': 'joint_names', 'force': 'overwrite=True'}


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
    chosen = {name: known[name].parse(value) for name, value in given.items()}
    if start is not None:
        chosen[START.name] = start if isinstance(start, Parameters) else read_result(Path(start)).theta
    return Settings.of(bounds=bounds or default_bounds(), reading=Conversion.of(conversion), **chosen)


def bounds_of(given: Mapping[str, Any] | Sequence[str]) -> Bounds:
    """Return the default search box with the given intervals, by parameter or as texts NAME=LOW:HIGH.

    A single number fixes a parameter.

    Raises:
        ParameterError: a parameter is unknown, or its interval is invalid.
    """
    bounds = default_bounds()
    named = given if isinstance(given, Mapping) else dict(each.partition('=')[::2] for each in given)
    for name, ends in named.items():
        bounds = bounds.replaced(name, *interval(name, ends, 'P1=0:0.5 or b2=0'))
    return bounds


def as_arguments(text: str) -> str:
    """Return a message with its options as Python arguments: ``--zero hanging`` becomes ``zero='hanging'``.

    Options without such an argument, for example of other subcommands, stay as they are.
    """
    return re.sub(r"--([a-z]+(?:-[a-z]+)*)([ =](?:'[^']*'|\S*[^\s.,;:?)\]]))?", _argument, text)


def _argument(found: re.Match[str]) -> str:
    """Return an option, and the next word if it is the option's value, as a Python argument."""
    name, after = found[1].replace('-', '_'), found[2] or ''
    option = next((option for option in (*OPTIONS, APPLY_REMEDIES, *CONVERSION) if option.name == name), None)
    name = RENAMED.get(name, name)
    if option is None:
        return name + after if found[1] in RENAMED else found[0]
    if isinstance(option.default, bool):
        return f'{name}=True{after}'
    word = after[1:].strip("'")
    if not word or option is START:
        return name + after
    try:
        value = dict(pair.split('=', 1) for pair in word.split(',')) if '=' in word else option.parse(word)
        option.check(value)
    except (ParameterError, ValueError):
        return f'{name}={word}' if word.isupper() else name + after  # a placeholder, or the next word
    return f'{name}={list(value) if isinstance(value, tuple) else value!r}'
