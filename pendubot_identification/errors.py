# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What a user can do wrong. Each message says what was found, what was expected and what to do."""

from collections.abc import Iterator
from contextlib import contextmanager


class PendubotError(Exception):
    """Base of every error that a user can cause; its text is one sentence for that user."""

    remedy: dict[str, str]  #: options of reading data that correct it, by name, where the program knows them.
    for_shell: str  #: the sentence with options as on the command line; the text may name arguments of Python.

    def __init__(self, text: str = '', **remedy: str) -> None:
        super().__init__(text)
        self.remedy, self.for_shell = remedy, text


class ParameterError(PendubotError):
    """A setting, bound or parameter vector that makes no sense."""


class TrajectoryError(PendubotError):
    """Samples that cannot be used: not finite, out of order, too few, a window that holds nothing."""


class LongRecordingError(TrajectoryError):
    """A recording that is too long to be taken at once."""

    found: str  #: that and how long it is, as a part of a sentence.
    window: str  #: what was to be read, BAG@START:END.
    first: str  #: its beginning, as much as is usually enough, likewise.

    def __init__(self, found: str, window: str, first: str) -> None:
        bag = window.rpartition('@')[0] or window
        super().__init__(f'{found}; take windows of it, such as {first}: pendubot track {bag} names good ones')
        self.found, self.window, self.first = found, window, first


class ExcitationError(PendubotError):
    """A motion from which some parameters are not identifiable."""


class BagError(PendubotError):
    """A bag that is missing, unreadable, or lacks what is asked of it."""


class TableError(PendubotError):
    """A file with columns that cannot be read as a motion."""


class ResultError(PendubotError):
    """A result file that cannot be read or written."""


class MissingFileError(BagError, TableError, ResultError, ParameterError, FileNotFoundError):
    """A file or bag that is not there; it is also the error of whatever was expected there."""


class LinkError(PendubotError):
    """A serial port that is missing, busy or forbidden."""


class ControlError(PendubotError):
    """A rig that cannot be controlled as asked for."""


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
    """Return the sentence about an error for a user."""
    if isinstance(error, PendubotError):
        return error.for_shell or str(error)
    if isinstance(error, OSError):
        return f'the system refused: {error}; correct that and try again'
    if isinstance(error, MemoryError):
        return f'not enough memory ({error}); ask for less'
    return f'{type(error).__name__}: {error}; run again with --debug to see where'
