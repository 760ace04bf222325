# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Message types by name: definition and hash for a bag's schema, and serialization."""

import os
import sys
from functools import cache
from pathlib import Path

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from pendubot_identification.errors import BagError


@cache
def typestore() -> Typestore:
    """Return the known message types: ROS 2 Jazzy's, and further ones that :func:`message_definition` read."""
    return get_typestore(Stores.ROS2_JAZZY)


@cache
def message_definition(type_name: str) -> tuple[str, str]:
    """Return the ``.msg`` texts of a type and of every type it uses (``ros2msg``), and its hash ``RIHS01_...``.

    Types outside ROS 2 Jazzy are read from ``share/<package>/msg`` of the sourced workspaces.

    Raises:
        BagError: the type is not installed, or its definition cannot be read.
    """
    store = typestore()
    try:
        _register(store, type_name)
        text, _ = store.generate_msgdef(type_name, ros_version=2)
        return text, store.hash_rihs01(type_name)
    except (TypesysError, UnicodeDecodeError) as error:
        raise BagError(
            f'the definition of {type_name} cannot be read ({str(error).splitlines()[0]}); correct its .msg file'
        ) from error


def _register(store: Typestore, type_name: str) -> None:
    """Add a type and the types that it uses from the sourced workspaces to the store."""
    if type_name in store.fielddefs:
        return
    package, _, name = type_name.partition('/msg/')
    if not name or '/' in package + name:
        raise BagError(f'{type_name!r} is no message type; a name such as sensor_msgs/msg/JointState is expected')
    prefixes = [*os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep), sys.prefix]
    paths = [Path(prefix, 'share', package, 'msg', f'{name}.msg') for prefix in prefixes if prefix]
    if (path := next(filter(Path.is_file, paths), None)) is None:
        raise BagError(f'share/{package}/msg/{name}.msg is not installed; install {package} or source its workspace')
    definitions = get_types_from_msg(path.read_text(encoding='utf-8'), type_name)
    for _, fields in definitions.values():
        for _, (kind, detail) in fields:
            if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
                kind, detail = detail[0]
            if kind == Nodetype.NAME:
                _register(store, detail)
    store.register(definitions)
