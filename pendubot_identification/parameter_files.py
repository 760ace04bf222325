# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""ROS parameter files: for which nodes they hold parameters."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import yaml

from pendubot_identification.errors import ParameterError


def addressed(content: Any, above: str = '') -> Iterator[tuple[str, dict[str, Any]]]:
    """Return the nodes that a file's content names, namespace and wildcards included, each with its parameters."""
    if isinstance(content, dict):
        for key, inner in content.items():
            if key == 'ros__parameters':
                yield above, inner if isinstance(inner, dict) else {}
            else:
                yield from addressed(inner, f'{above}/{str(key).lstrip("/")}')


def refuse_untaken(path: str, node: str) -> None:
    """Refuse a parameter file that holds no parameter of a node: ROS would ignore it and use the defaults.

    Args:
        path: the file.
        node: the node's fully qualified name, such as ``/lab1/bridge``.

    Raises:
        ParameterError: ROS takes nothing from the file.
    """
    try:
        content = yaml.safe_load(Path(path).read_text(encoding='utf-8'))
    except (OSError, ValueError, yaml.YAMLError):
        content = None
    names = [name for name, parameters in addressed(content) if parameters]
    # rclpy uses the same regular expression: * is one part of a name, ** is any number of parts.
    if not any(re.fullmatch(name.replace('/*', r'(/\w+)'), node, re.ASCII) for name in names):
        held = f'parameters of {", ".join(names)}' if names else 'no parameters of any node'
        raise ParameterError(
            f'nothing is taken from {path}: it holds {held}, and none of {node}; name {node} in it, or '
            f'/**/{node.rpartition("/")[2]} for every namespace'
        )


def parameter_files(argv: Sequence[str]) -> list[str]:
    """Return the parameter files that a program's arguments name."""
    return [path for option, path in pairwise(argv) if option == '--params-file']
