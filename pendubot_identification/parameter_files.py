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


def addressed(content: Any, above: str = '') -> Iterator[tuple[str, dict[str, Any]]]:
    """Return the nodes that a file's content names, namespace and wildcards included, each with its parameters."""
    if isinstance(content, dict):
        for key, inner in content.items():
            if key == 'ros__parameters':
                yield above, inner if isinstance(inner, dict) else {}
            else:
                yield from addressed(inner, f'{above}/{str(key).lstrip("/")}')


def unheard(argv: Sequence[str], node: str) -> list[str]:
    """Say, in a sentence each, from which of the files in a program's arguments ROS takes nothing: it does not say so.

    Args:
        argv: the program's arguments.
        node: its fully qualified name, such as ``/lab1/bridge``.
    """
    sentences = []
    for path in (path for option, path in pairwise(argv) if option == '--params-file'):
        try:
            content = yaml.safe_load(Path(path).read_text(encoding='utf-8'))
        except (OSError, ValueError, yaml.YAMLError):
            content = None
        names = [name for name, parameters in addressed(content) if parameters]
        # As rclpy does it, with the same regular expression: * is one part of a name, ** are any number.
        if not any(re.fullmatch(name.replace('/*', r'(/\w+)'), node, re.ASCII) for name in names):
            held = f'parameters of {", ".join(names)}' if names else 'no parameters of any node'
            sentences.append(
                f'nothing is taken from {path}: it holds {held}, and none of {node}; name {node} in it, or '
                f'/**/{node.rpartition("/")[2]} for every namespace'
            )
    return sentences
