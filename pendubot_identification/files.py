# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Reads YAML and ROS parameter files, hashes files, and writes files completely or not at all.

Existing files are overwritten only on request.
"""

from __future__ import annotations

import hashlib
import os
import re
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from pendubot_identification.errors import MissingFileError, ParameterError, PendubotError, ResultError

#: The option that replaces existing files, as the last words of a message.
OVERWRITE = 'overwrite it by --force (in Python overwrite=True, in ROS force:=true)'


def read_yaml(path: Path, expected: str, refusal: type[PendubotError] = ResultError, *, texts: bool = False) -> Any:
    """Return the content of a YAML file, with ``texts`` all values as texts: to YAML 0:0.02 is a number of base 60.

    Raises:
        MissingFileError: there is no such file.
        PendubotError: it cannot be read, or is no YAML; of class ``refusal``, with ``expected`` as its last clause.
    """
    import yaml

    try:
        # The libyaml loader, if it is available, is seven times as fast.
        loader = 'BaseLoader' if texts else 'SafeLoader'
        return yaml.load(path.read_text(encoding='utf-8'), Loader=getattr(yaml, f'C{loader}', getattr(yaml, loader)))
    except FileNotFoundError as error:
        raise MissingFileError(f'there is no file {path}; {expected}') from error
    except OSError as error:
        raise refusal(f'{path} cannot be read ({error.strerror}); {expected}') from error
    except (yaml.YAMLError, ValueError) as error:  # of the encoding, or of a date
        raise refusal(f'{path} is no YAML file; {expected}') from error


def content_hash(paths: Iterable[Path]) -> str:
    """Return the SHA-256 of files, one after the other, in hexadecimal."""
    digest = hashlib.sha256()
    for path in paths:
        with path.open('rb') as stream:
            while block := stream.read(1 << 20):
                digest.update(block)
    return digest.hexdigest()


def yaml_text(document: Any) -> str:
    """Return a document as YAML: lists of numbers in one line, and no anchors, which some readers do not support."""
    import yaml

    # The libyaml dumper, if it is available, is five times as fast.
    fast: Any = getattr(yaml, 'CSafeDumper', yaml.SafeDumper)

    class Dumper(fast):
        def ignore_aliases(self, data: Any) -> bool:
            return True

        def represent_scalar(self, tag: str, value: str, style: str | None = None) -> yaml.ScalarNode:
            # A file name may be no valid text, which libyaml refuses.
            return super().represent_scalar(tag, value.encode(errors='backslashreplace').decode(), style)

        def represent_sequence(self, tag: str, sequence: Any, flow_style: bool | None = None) -> yaml.SequenceNode:
            numbers = not any(isinstance(entry, (str, Mapping, list)) for entry in sequence)
            return super().represent_sequence(tag, sequence, flow_style=numbers)

    return yaml.dump(document, Dumper=Dumper, sort_keys=False, allow_unicode=True, width=100)


def refuse_unwritable(path: Path, *, overwrite: bool = False) -> None:
    """Refuse an unwritable file before a long computation.

    Raises:
        ResultError: the file exists already, or is a folder or device, or its folder is missing or read-only.
    """
    with writing(path):
        _require_regular(path)
        if path.exists() and not overwrite:
            raise ResultError(f'{path} exists already and was left as it is; choose another name or {OVERWRITE}')
        with tempfile.TemporaryFile(dir=path.parent):
            pass


def refuse_input(output: Path, inputs: Iterable[Path | None]) -> None:
    """Refuse to overwrite an input file or a file of an input bag, with or without ``--force``.

    Raises:
        ResultError: the output is an input.
    """
    for path in inputs:
        if path is None or not os.path.exists(output):
            continue
        for read in (path, *path.glob('*.mcap'), path / 'metadata.yaml'):
            if os.path.exists(read) and os.path.samefile(read, output):
                raise ResultError(f'{output} is read, so it cannot be written as well; give another name')


def write_atomically(path: Path, content: str | bytes, *, overwrite: bool = False) -> None:
    """Write a file completely or not at all. May raise ResultError."""
    refuse_unwritable(path, overwrite=overwrite)
    _write_together({path: content})


class OutputFolder:
    """A folder for the files of one result, created and checked before a long computation.

    At the end of its context an empty folder is removed, with the created folders above it. With ``overwrite``, files
    of the same names are replaced, and other files remain.

    Raises:
        ResultError: it is not empty, or cannot be written.
    """

    def __init__(self, path: Path, *, overwrite: bool = False) -> None:
        self.path = path
        self._created: list[Path] = []
        with writing(path):
            try:
                self._created = [folder for folder in (path, *path.parents) if not folder.exists()]
                path.mkdir(parents=True, exist_ok=True)
                used = any(path.iterdir())
                with tempfile.TemporaryFile(dir=path):
                    pass
            except OSError:
                self.__exit__()
                raise
        if used and not overwrite:
            raise ResultError(f'{path} exists already and is not empty; choose another name or {OVERWRITE}')

    def __enter__(self) -> OutputFolder:
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(OSError):  # a folder with files remains
            for folder in self._created:
                folder.rmdir()

    def write(self, files: Mapping[str, str | bytes]) -> None:
        """Write all files or none, by names that may include a folder. May raise ResultError."""
        targets = {self.path / name: content for name, content in files.items()}
        for path in targets:
            with writing(path):
                path.parent.mkdir(exist_ok=True)
        _write_together(targets)


def _write_together(files: Mapping[Path, str | bytes]) -> None:
    """Write all files or, after a failure, none, so that existing files are unchanged."""
    partials = {path: path.with_name(path.name + '.partial') for path in files}
    try:
        for path, content in files.items():
            # The content may include a file name that is no valid text; it is escaped.
            data = content.encode(errors='backslashreplace') if isinstance(content, str) else content
            with writing(path):
                _require_regular(path)
                partials[path].write_bytes(data)
        for path, partial in partials.items():
            with writing(path):
                os.replace(partial, path)
    finally:
        for partial in partials.values():
            with suppress(OSError):
                partial.unlink(missing_ok=True)


def _require_regular(path: Path) -> None:
    if path.is_dir():
        raise ResultError(f'{path} is a folder; name a file in it')
    if path.exists() and not path.is_file():  # a device, which a file would replace
        raise ResultError(f'{path} is no regular file; choose another name')


@contextmanager
def writing(path: Path | str) -> Iterator[None]:
    """Convert an OSError within the context to a ResultError that names the file."""
    try:
        yield
    except OSError as error:
        raise ResultError(f'{path} cannot be written ({error.strerror}); choose another folder') from error


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
        ParameterError: the file is no YAML, or has no parameter of the node.
    """
    content = read_yaml(Path(path), f'a parameter file of {node} is expected', ParameterError)
    names = [name for name, parameters in addressed(content) if parameters]
    # rclpy uses the same regular expression: * is one part of a name, ** is any number of parts.
    if not any(re.fullmatch(name.replace('/*', r'(/\w+)'), node, re.ASCII) for name in names):
        found = f'parameters of {", ".join(names)}' if names else 'no parameters of any node'
        raise ParameterError(
            f'{path} has no effect: it contains {found}, and none of {node}; name {node} in it, or '
            f'/**/{node.rpartition("/")[2]} for every namespace'
        )


def _content(path: str | Path) -> Any:
    with suppress(PendubotError):
        return read_yaml(Path(path), '')
    return None
