"""Writing a file whole or not at all, and never over another one unasked."""

from __future__ import annotations

import os
from pathlib import Path

from pendubot_identification.core.errors import ResultError


def refuse_existing(path: Path) -> None:
    """Refuse to write where something is; worth asking before a long computation too.

    Raises:
        ResultError: the file exists already.
    """
    if path.exists():
        raise ResultError(f'{path} exists already and was left as it is; choose another name or add --force')


def write_text(path: Path, text: str, *, overwrite: bool = False) -> None:
    """Write a text file, whole or not at all.

    Raises:
        ResultError: the file exists already, or the system refuses to write it.
    """
    if not overwrite:
        refuse_existing(path)
    beside = path.with_name(path.name + '.partial')
    try:
        beside.write_text(text, encoding='utf-8')
        os.replace(beside, path)
    except OSError as error:
        beside.unlink(missing_ok=True)
        raise ResultError(f'{path} cannot be written ({error.strerror}); choose a folder that can be') from error
