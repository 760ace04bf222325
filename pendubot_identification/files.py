"""Writing files whole or not at all, alone or in a folder of their own, and never over others unasked."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable
from pathlib import Path

from pendubot_identification.errors import ResultError


def refuse_unwritable(path: Path, *, overwrite: bool = False, force: str = '--force') -> None:
    """Refuse a file that could not be written: worth asking before a long computation.

    ``force`` is what a user adds to have an existing one overwritten.

    Raises:
        ResultError: the file exists already, or is a folder, or its folder is missing or cannot be written to.
    """
    try:
        if path.is_dir():
            raise ResultError(f'{path} is a folder; name a file in it')
        if not overwrite:
            _refuse_existing(path, force)
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise _refused(path, error) from error


def refuse_input(output: Path, inputs: Iterable[Path | None]) -> None:
    """Refuse to write over what is read, whatever ``--force`` says, and over a file of a bag that is read.

    Args:
        output: the file to be written.
        inputs: the files and folders of bags that are read; None for those that were not named.

    Raises:
        ResultError: the output is one of these.
    """
    for given in inputs:
        if given is None or not os.path.exists(output):
            continue
        for read in (given, *given.glob('*.mcap'), given / 'metadata.yaml'):
            if os.path.exists(read) and os.path.samefile(read, output):
                raise ResultError(f'{output} is read, so it cannot be written as well; give another name')


def write_whole(path: Path, content: str | bytes, *, overwrite: bool = False, force: str = '--force') -> None:
    """Write a file, whole or not at all; ``force`` is what a user adds to have an existing one overwritten.

    Raises:
        ResultError: the file exists already, or the system refuses to write it.
    """
    if not overwrite:
        _refuse_existing(path, force)
    beside = path.with_name(path.name + '.partial')
    try:
        beside.write_bytes(content.encode() if isinstance(content, str) else content)
        os.replace(beside, path)
    except OSError as error:
        beside.unlink(missing_ok=True)
        raise _refused(path, error) from error


class OutputFolder:
    """A folder for the files of one result: made, and seen to be writable, before anything is computed.

    Args:
        path: the folder; with those above it, it is made.
        overwrite: whether it may hold something. Files of the same names are then replaced, others stay.

    Raises:
        ResultError: it holds something already, or the system refuses it.
    """

    def __init__(self, path: Path, *, overwrite: bool = False) -> None:
        self.path = path
        try:
            path.mkdir(parents=True, exist_ok=True)
            held = any(path.iterdir())
            with tempfile.TemporaryFile(dir=path):
                pass
        except OSError as error:
            raise _refused(path, error) from error
        if held and not overwrite:
            raise ResultError(
                f'{path} exists already and holds something, and was left as it is; choose another name or add --force'
            )

    def write(self, name: str, content: str | bytes) -> Path:
        """Write a file, in a folder of its own where its name has one, and return where it is.

        Raises:
            ResultError: the system refuses.
        """
        path = self.path / name
        try:
            path.parent.mkdir(exist_ok=True)
        except OSError as error:
            raise _refused(path, error) from error
        write_whole(path, content, overwrite=True)
        return Path(os.path.abspath(path))


def _refuse_existing(path: Path, force: str) -> None:
    if path.exists():
        raise ResultError(f'{path} exists already and was left as it is; choose another name or add {force}')


def _refused(path: Path, error: OSError) -> ResultError:
    return ResultError(f'{path} cannot be written ({error.strerror}); choose a folder that can be')
