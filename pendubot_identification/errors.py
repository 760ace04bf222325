# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The errors that a user can cause. Each message contains the finding, the expectation and the correction."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager


class PendubotError(Exception):
    """Base class of every error that a user can cause; its text is one sentence for that user."""

    remedy: dict[str, str]  #: known data options that correct the error, by name.

    def __init__(self, text: str = '', **remedy: str) -> None:
        super().__init__(text)
        self.remedy = remedy


class ParameterError(PendubotError):
    """An invalid setting, bound or parameter vector."""


class TrajectoryError(PendubotError):
    """Unusable samples: not finite, out of order, too few, or an empty window."""


class LongRecordingError(TrajectoryError):
    """A recording that is too long for one identification."""

    first = ''  #: a window of sufficient length at its beginning, BAG@START:END.


class ExcitationError(PendubotError):
    """A motion from which some parameters are not identifiable."""


class BagError(PendubotError):
    """A bag that is missing or unreadable, or lacks the requested data."""


class TableError(PendubotError):
    """A file with columns that cannot be read as a motion."""


class ResultError(PendubotError):
    """A result file that cannot be read or written."""


class MissingFileError(BagError, TableError, ResultError, ParameterError, FileNotFoundError):
    """A missing file or bag; also an instance of the error classes of every kind of file."""


class LinkError(PendubotError):
    """A serial port that is missing, busy or forbidden."""


class ControlError(PendubotError):
    """A rig that cannot be controlled as requested."""


class UsageError(PendubotError):
    """Invalid options or arguments, alone or in combination; the exit status is 2."""


@contextmanager
def wrong_usage() -> Iterator[None]:
    """Convert each PendubotError within the context, where options are interpreted, to a UsageError.

    Raises:
        UsageError: an error with the same sentence.
    """
    try:
        yield
    except PendubotError as error:
        raise UsageError(str(error)) from error


@contextmanager
def noting(remarks: Iterable[str]) -> Iterator[None]:
    """Append remarks on the data, which may be the cause, to the sentence of each PendubotError within the context."""
    try:
        yield
    except PendubotError as error:
        error.args = ('; '.join([str(error), *remarks]),)
        raise


def sentence(error: Exception) -> str:
    """Return the message of an error for the user."""
    if isinstance(error, PendubotError):
        return str(error)
    if isinstance(error, OSError):
        return f'the system refused: {error}; correct that and try again'
    if isinstance(error, MemoryError):
        return f'not enough memory ({error}); use less data'
    return f'{type(error).__name__}: {error}; run again with --debug to see where'
