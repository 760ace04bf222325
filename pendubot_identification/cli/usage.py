"""Wrong usage: what can be told from the command line alone, whatever the files hold."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from pendubot_identification.core.errors import PendubotError


class UsageError(PendubotError):
    """Options or arguments that make no sense, alone or together; the exit status is 2."""


@contextmanager
def wrong_usage() -> Iterator[None]:
    """Take each error that is raised within as one of usage: for where options are interpreted.

    Raises:
        UsageError: with the same sentence.
    """
    try:
        yield
    except PendubotError as error:
        raise UsageError(str(error)) from error


def sentence(error: Exception) -> str:
    """Return what a user is told of an error."""
    if isinstance(error, PendubotError):
        return str(error)
    if isinstance(error, OSError):
        return f'the system refused: {error}; mend that and try again'
    if isinstance(error, MemoryError):
        return f'not enough memory ({error}); ask for less'
    return f'{type(error).__name__}: {error}; run again with --debug to see where'
