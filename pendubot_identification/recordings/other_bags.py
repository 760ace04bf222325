# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Bags of ROS 1 (.bag) and of ROS 2 with storage sqlite3 (.db3): their JointStates as MCAP."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from pendubot_identification.errors import BagError

from .joint_states import JOINT_STATE

#: Converted bags, which are deleted when the program ends.
_folders: list[TemporaryDirectory[str]] = []


@cache
def as_mcap(path: Path) -> Path:
    """Return a folder with the JointStates of such a bag in MCAP, which lasts as long as the program; or another path.

    Raises:
        BagError: the bag cannot be read, or holds none.
    """
    try:
        if path.is_dir():
            other = any(path.glob('*.db3')) and not any(path.glob('*.mcap*'))
        else:
            other = path.suffix in ('.bag', '.db3') and path.is_file()
    except OSError:  # it cannot be read, which the reader says
        other = False
    if not other:
        return path
    from rosbags.convert import ConverterError, convert
    from rosbags.highlevel import AnyReaderError
    from rosbags.typesys import Stores, get_typestore

    source = path.parent if path.suffix == '.db3' and (path.parent / 'metadata.yaml').exists() else path
    _folders.append(TemporaryDirectory(prefix='pendubot-'))
    target, jazzy = Path(_folders[-1].name, 'bag'), get_typestore(Stores.ROS2_JAZZY)
    try:
        convert([source], target, 'mcap', 9, None, 'none', jazzy, jazzy, [], [], [], [JOINT_STATE])
    except (ConverterError, AnyReaderError, OSError, ValueError) as error:
        raise BagError(
            f'{path} is no bag with messages of type {JOINT_STATE} that can be read ({error}); look at it with '
            'rosbag info or ros2 bag info'
        ) from error
    return target
