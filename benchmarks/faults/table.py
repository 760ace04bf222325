# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The results of fault trials: each target, the measured figure, and whether it meets the target."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple


class Figure(NamedTuple):
    """One figure of a trial; with ``time``, it needs a quiet machine, and no test depends on it."""

    wanted: str
    measured: str
    met: bool
    time: bool = False


class Trial(NamedTuple):
    """A fault and its measurement: ``measure(folder, long)`` yields the fields of figures.

    ``board``: whether the trial starts a virtual board.
    """

    name: str
    fault: str
    measure: Callable[[Path, bool], Iterable[tuple]]
    board: bool = False

    def run(self, folder, long):
        """Return the figures of the trial."""
        return [Figure(*fields) for fields in self.measure(folder, long)]
