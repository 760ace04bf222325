# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What a fault trial says: each figure that was wanted, what was measured, and whether that is good enough."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Figure:
    """One figure of a trial; one of ``time`` is for a quiet machine, and no test depends on it."""

    wanted: str
    measured: str
    met: bool
    time: bool = False


@dataclass(frozen=True)
class Trial:
    """A fault and what shows how it is survived: ``run(folder, long)`` returns the figures."""

    name: str
    fault: str
    run: Callable[[Path, bool], list[Figure]]


HEADER = '| fault | wanted | measured | |\n|---|---|---|---|'


def row(fault, figure):
    """A row of the table."""
    return f'| {fault} | {figure.wanted} | {figure.measured} | {"met" if figure.met else "**missed**"} |'


def check(figures):
    """Fail where a figure that does not hang on the machine's speed is not met."""
    missed = [f'{figure.wanted}: {figure.measured}' for figure in figures if not (figure.met or figure.time)]
    assert not missed, '; '.join(missed)
