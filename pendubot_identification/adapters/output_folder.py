"""A folder of results: made anew, never written over unless that is asked for."""

from __future__ import annotations

import os
from pathlib import Path

from pendubot_identification.core.errors import ResultError

from .result_file import refuse_existing


class OutputFolder:
    """Write files of one result.

    Args:
        path: the folder; with those above it, it is made.
        overwrite: whether it may exist. Files of the same names are then replaced, others stay.

    Raises:
        ResultError: it exists already, or the system refuses to make it.
    """

    def __init__(self, path: Path, *, overwrite: bool = False) -> None:
        self.path = path
        if not overwrite:
            refuse_existing(path)
        try:
            path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise self._refused(path, error) from error
        if not os.access(path, os.W_OK | os.X_OK):
            raise ResultError(f'{path} cannot be written (Permission denied); choose a folder that can be')

    def write(self, name: str, content: str | bytes) -> None:
        """Write a file, whole or not at all, in a folder of its own where its name has one.

        Raises:
            ResultError: the system refuses.
        """
        path = self.path / name
        beside = path.with_name(path.name + '.partial')
        try:
            path.parent.mkdir(exist_ok=True)
            beside.write_bytes(content.encode() if isinstance(content, str) else content)
            os.replace(beside, path)
        except OSError as error:
            raise self._refused(path, error) from error

    @staticmethod
    def _refused(path: Path, error: OSError) -> ResultError:
        return ResultError(f'{path} cannot be written ({error.strerror}); choose a folder that can be')
