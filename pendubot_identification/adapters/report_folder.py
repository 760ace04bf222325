"""The folder of a report: made before anything is computed, never overwritten, each file whole or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from pathlib import Path

from pendubot_identification.core.errors import ResultError

from .result_file import write_whole

#: The page itself.
PAGE = 'report.html'


def make_report_folder(folder: Path, *, overwrite: bool = False) -> None:
    """Make the folder of a report, and see that it can be written.

    Raises:
        ResultError: it holds something already, or the system refuses it.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        held = any(folder.iterdir())
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise ResultError(
            f'no report can be written to {folder} ({error.strerror}); name another folder, or one that can be made'
        ) from error
    if held and not overwrite:
        raise ResultError(
            f'{folder} exists already and holds something, and was left as it is; choose another name or add --force'
        )


def write_report(folder: Path, files: Mapping[str, bytes]) -> Path:
    """Write the files of a report into its folder, the page last, and return where the page is.

    Raises:
        ResultError: the system refuses to write.
    """
    for name in sorted(files, key=lambda name: name == PAGE):
        write_whole(folder / name, files[name])
    return Path(os.path.abspath(folder / PAGE))
