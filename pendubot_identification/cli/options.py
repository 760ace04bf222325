# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The values of the options for the conversion of recordings, from the command line and settings files."""

import argparse
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from pendubot_identification.errors import ParameterError
from pendubot_identification.files import read_yaml
from pendubot_identification.identification import APPLY_REMEDIES, OPTIONS
from pendubot_identification.setting import Setting
from pendubot_identification.trajectories.conventions import CONVERSION
from pendubot_identification.trajectories.conversion import Conversion


def given_options(args: argparse.Namespace, options: Iterable[Setting]) -> dict[str, Any]:
    """Return the values of options by name, from the command line or else the file of ``--settings``; none if empty.

    Raises:
        ParameterError: the file cannot be read, or contains unknown options.
    """
    values = {} if args.settings is None else _read_settings(args.settings)
    values |= {name: value for name, value in vars(args).items() if value is not None}
    return {option.name: values[option.name] for option in options if values.get(option.name) is not None}


def conversion_of(args: argparse.Namespace) -> Conversion:
    """Return the conversion of recordings according to the options.

    Raises:
        ParameterError: an option is invalid, or the file of ``--settings`` cannot be read.
    """
    return Conversion.of(given_options(args, CONVERSION))


def _read_settings(path: Path) -> dict[str, Any]:
    """Return the options in a YAML file; from a result, the options of its conversion of recordings."""
    content = read_yaml(path, 'name a file with options, or a result', ParameterError, texts=True)
    if isinstance(content, dict) and 'schema' in content:
        content = content.get('reading', {})
    if not isinstance(content, dict):
        raise ParameterError(f'{path} has no options; lines such as "degrees: true" are expected')
    named = {str(name).replace('-', '_'): value for name, value in content.items()}
    known = [option.name for option in (*OPTIONS, APPLY_REMEDIES, *CONVERSION)]
    if unknown := [name for name in named if name not in known]:
        raise ParameterError(f'{path}: there is no option {unknown[0]!r}; the options are {", ".join(known)}')
    return {name: value for name, value in named.items() if value}  # not the empty ones
