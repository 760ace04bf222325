# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The options of all subcommands that read recordings: what their numbers mean."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pendubot_identification.errors import ParameterError
from pendubot_identification.setting import Setting
from pendubot_identification.trajectories.conventions import CONVERSION

if TYPE_CHECKING:
    from pendubot_identification.trajectories.conversion import Conversion


def add_reading(parser: Any) -> None:
    """Add options that say how recordings are read; one that is not given is None."""
    group = parser.add_argument_group('how recordings are read', 'applied in this order, to all of them alike')
    names = {'columns': 't=NAME,...', 'torque_constant': 'K', 'negate': 'q1,...', 'offset': 'q1=ANGLE,...'}
    for option in CONVERSION:
        add_option(group, option, **({'metavar': names[option.name]} if option.name in names else {}))
    group.add_argument(
        '--map', type=Path, metavar='FILE', help='take these options from a file of --save-map, or from a result'
    )
    group.add_argument('--save-map', type=Path, metavar='FILE', help='keep them in a file, to be given again')


def add_joints(group: Any) -> None:
    """Add options that say where in a bag both joints are."""
    group.add_argument('--topic', default='/joint_states', help='topic with the joint states (default %(default)s)')
    group.add_argument(
        '--joints', default='shoulder,elbow', metavar='SHOULDER,ELBOW', help='their joint names (default %(default)s)'
    )


def add_option(group: Any, option: Setting, **spelled: Any) -> None:
    """Add an option that is None where it is not given."""
    words = option.help()
    if isinstance(option.default, bool):
        group.add_argument(flag(option.name), action='store_const', const=True, help=words)
        return
    if not option.optional:
        default = option.default
        words += f' (default {":".join(map(str, default)) if isinstance(default, tuple) else default})'
    how = {'type': type(option.default), 'choices': option.choices or None, 'metavar': option.unit.upper() or None}
    group.add_argument(flag(option.name), help=words, **(how | spelled))


def flag(name: str) -> str:
    """Return how an option is written."""
    return f'--{name.replace("_", "-")}'


def reading_of(args: argparse.Namespace) -> Conversion:
    """Return how recordings are to be read, and keep that where it is asked for.

    Raises:
        ParameterError: an option makes no sense, or there is no such file.
        ResultError: the file cannot be written, or is there already.
    """
    from pendubot_identification.trajectories.conversion import Conversion

    given = {option.name: value for option in CONVERSION if (value := getattr(args, option.name)) is not None}
    return Conversion.of((read_map(args.map) if args.map else {}) | given)


def save_map(args: argparse.Namespace, reading: Conversion) -> None:
    """Keep how recordings were read, where that is asked for.

    Raises:
        ResultError: the file cannot be written, or is there already.
    """
    if args.save_map is not None:
        import yaml

        from pendubot_identification.files import write_atomically

        write_atomically(
            args.save_map, yaml.safe_dump(reading.words(), sort_keys=False), overwrite=getattr(args, 'force', False)
        )


def read_map(path: Path) -> dict[str, Any]:
    """Return what a file says of how recordings are read: options by name, or what a result was made with.

    Raises:
        ParameterError: there is no such file, or it says nothing of the kind.
    """
    from pendubot_identification.files import read_yaml

    said = read_yaml(path, 'name a file of --save-map', ParameterError)
    if isinstance(said, dict) and 'schema' in said:
        said = said.get('reading', {})
    if not isinstance(said, dict):
        raise ParameterError(f'{path} names no options; such as "degrees: true" in a line each is expected')
    return said
