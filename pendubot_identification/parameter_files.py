# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""ROS parameter files: the nodes and parameters in them."""

import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import yaml

from pendubot_identification.errors import ParameterError


def addressed(content: Any, above: str = '') -> Iterator[tuple[str, dict[str, Any]]]:
    """Return the nodes in the content of a file, namespace and wildcards included, each with its parameters."""
    if isinstance(content, dict):
        for key, inner in content.items():
            if key == 'ros__parameters':
                yield above, inner if isinstance(inner, dict) else {}
            else:
                yield from addressed(inner, f'{above}/{str(key).lstrip("/")}')


def parameter_names(paths: Iterable[str | Path], ending: str = '') -> set[str]:
    """Return the names of the parameters in files, for nodes whose names end with ``ending``."""
    nodes = (node for path in paths for node in addressed(_content(path)))
    return {name for node, parameters in nodes if node.endswith(ending) for name in parameters}


def refuse_untaken(path: str, node: str) -> None:
    """Refuse a parameter file without parameters of a node, because ROS would ignore it and use the defaults.

    Args:
        path: the file.
        node: the node's fully qualified name, such as ``/lab1/bridge``.

    Raises:
        ParameterError: the file has no parameter of the node.
    """
    names = [name for name, parameters in addressed(_content(path)) if parameters]
    # rclpy uses the same regular expression: * is one part of a name, ** is any number of parts.
    if not any(re.fullmatch(name.replace('/*', r'(/\w+)'), node, re.ASCII) for name in names):
        content = f'parameters of {", ".join(names)}' if names else 'no parameters of any node'
        raise ParameterError(
            f'{path} has no effect: it contains {content}, and none of {node}; name {node} in it, or '
            f'/**/{node.rpartition("/")[2]} for every namespace'
        )


def _content(path: str | Path) -> Any:
    try:
        return yaml.safe_load(Path(path).read_text(encoding='utf-8'))
    except (OSError, ValueError, yaml.YAMLError):
        return None
