"""Parameter files that are addressed to other nodes: ROS ignores them in silence."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import yaml


def unheard(argv: Sequence[str], node: str) -> list[str]:
    """Return, in a sentence each, which of the parameter files in a program's arguments hold nothing for a node."""
    sentences = []
    for option, path in pairwise(argv):
        if option == '--params-file':
            names = list(_addressed(_content(path)))
            if not any('*' in name or name.strip('/').split('/')[-1] == node for name in names):
                held = f'parameters of {", ".join(names)}' if names else 'no parameters of any node'
                sentences.append(f'{path} holds {held}, and none of {node}: they are ignored; name {node} in it')
    return sentences


def _content(path: str) -> Any:
    try:
        return yaml.safe_load(Path(path).read_text(encoding='utf-8'))
    except (OSError, ValueError, yaml.YAMLError):
        return None


def _addressed(content: Any) -> Iterator[str]:
    """Return the names under which parameters stand, namespaces as they are written."""
    if isinstance(content, dict):
        for name, inner in content.items():
            if isinstance(inner, dict) and 'ros__parameters' in inner:
                yield str(name)
            else:
                yield from _addressed(inner)
