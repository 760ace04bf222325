# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Reading a motion from a CSV file."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.errors import CsvError
from pendubot_identification.trajectories.trajectory import Trajectory

REQUIRED = ('t', 'q1', 'q2', 'tau1')
OPTIONAL = ('tau2', 'dq1', 'dq2')

#: Rows further apart [s] have a time in some other unit.
LONGEST_INTERVAL = 1.0

Zero = Literal['horizontal', 'hanging']
Elbow = Literal['relative', 'absolute']


def import_csv(
    path: Path,
    columns: Mapping[str, str] | None = None,
    *,
    degrees: bool = False,
    zero: Zero = 'horizontal',
    elbow: Elbow = 'relative',
) -> Trajectory:
    """Read a motion from a CSV file with a line of column names; separated by commas, semicolons or tabs.

    Args:
        path: the file.
        columns: the file's name for any of t [s], q1, q2, dq1, dq2, tau1, tau2 [N m] that it calls otherwise. Where
            tau2 is absent the elbow is not driven; where dq1 or dq2 is absent there are no velocities.
        degrees: angles and velocities are in degrees, not radians.
        zero: where the file's angles are zero: with link 1 horizontal or hanging.
        elbow: whether the file's q2 and dq2 are relative to link 1 or, like q1, to the world.

    Raises:
        CsvError: the file cannot be read, a column is missing, a value is not a number, a stamp repeats or runs back.
    """
    values = _read(Path(path), columns or {})
    unit = math.pi / 180 if degrees else 1.0
    t = values['t']
    q = unit * np.column_stack([values['q1'], values['q2']])
    tau = np.column_stack([values['tau1'], values.get('tau2', np.zeros_like(t))])
    qd = unit * np.column_stack([values['dq1'], values['dq2']]) if {'dq1', 'dq2'} <= values.keys() else None
    if elbow == 'absolute':
        # Both angles are from the same zero, so it must not be shifted first.
        q[:, 1] -= q[:, 0]
        if qd is not None:
            qd[:, 1] -= qd[:, 0]
    if zero == 'hanging':
        q[:, 0] -= math.pi / 2
    trajectory = Trajectory(t=t - t[0], q=q, tau=tau, qd=qd, name=str(path))
    if len(t) > 1 and trajectory.interval > LONGEST_INTERVAL:
        raise CsvError(
            f'{path}: its rows are {trajectory.interval:g} s apart, which no recording of a pendubot is; t must be in '
            'seconds: divide milliseconds by 1000'
        )
    return trajectory


def wanted(columns: Mapping[str, str]) -> dict[str, str]:
    """Return for every quantity its column's name, given some of the names.

    Raises:
        CsvError: there is no such quantity, or one column is named for two.
    """
    if unknown := [name for name in columns if name not in REQUIRED + OPTIONAL]:
        raise CsvError(
            f'{unknown[0]!r} is no quantity of a motion; columns can be named for {", ".join(REQUIRED + OPTIONAL)}'
        )
    named = {name: columns.get(name, name) for name in REQUIRED + OPTIONAL}
    for name, column in columns.items():
        if other := next((other for other in named if other != name and named[other] == column), None):
            raise CsvError(
                f'column {column!r} stands for both {name} and {other}; name one column for each quantity, '
                f'such as {other}=NAME'
            )
    return named


def _read(path: Path, columns: Mapping[str, str]) -> dict[str, NDArray[np.float64]]:
    """Return the wanted columns that are there, each of shape (N,)."""
    try:
        text = path.read_text(encoding='utf-8-sig')
    except OSError as error:
        raise CsvError(f'{path} cannot be read: {error.strerror}; check its name and permissions') from error
    except UnicodeDecodeError as error:
        raise CsvError(f'{path} is no text in UTF-8; export it as CSV in that encoding') from error
    lines = text.splitlines()
    if not any(map(str.strip, lines)):
        raise CsvError(f'{path} is empty; a line of column names and rows of numbers are expected: export it again')
    # Excel may be told the separator, and tells it, by a line of its own.
    told = re.fullmatch(r'"?sep=(.)"?', lines[0].strip(' '), re.IGNORECASE)
    delimiter = told[1] if told else max(',;\t', key=lines[0].count)
    reader = csv.reader(lines, delimiter=delimiter)
    if told:
        next(reader)
    names = [name.strip() for name in next(reader, [])]
    there = _places(path, names, columns)
    rows: list[list[float]] = []
    before = -math.inf
    try:
        for row in reader:
            if not any(cell.strip() for cell in row):
                continue
            where = f'{path}, line {reader.line_num}'
            # Some programs end a row with a separator; anything else means that cells are not where they belong.
            if len(row) < len(names) or any(cell.strip() for cell in row[len(names) :]):
                comma = delimiter == ',' and len(row) > len(names)
                why = 'decimals may be written with commas: write them with points, or ' if comma else ''
                raise CsvError(
                    f'{where} has {len(row)} cells; {len(names)} are expected, one for each column name; '
                    f'{why}mend or remove that row'
                )
            rows.append([_number(row[k], f'{where}, column {names[k]!r}') for k in there.values()])
            time = rows[-1][0]
            if not time > before:
                raise CsvError(
                    f'{where}: the time {time:.12g} {"repeats" if time == before else "runs back"}, after '
                    f'{before:.12g}; every row needs a later one: export more digits, or mend or remove that row'
                )
            before = time
    except csv.Error as error:
        raise CsvError(f'{path}, line {reader.line_num}: {error}; mend or remove that row') from error
    if not rows:
        raise CsvError(f'{path} holds no row of numbers; export the recording again')
    return dict(zip(there, np.array(rows).T, strict=True))


def _places(path: Path, names: list[str], columns: Mapping[str, str]) -> dict[str, int]:
    """Return in which cell of a row each quantity stands that the file has; t is the first."""
    there = {}
    for quantity, column in wanted(columns).items():
        if names.count(column) > 1:
            raise CsvError(
                f'{path} has {names.count(column)} columns {column!r}; rename all but the one for {quantity}'
            )
        if column in names:
            there[quantity] = names.index(column)
        elif quantity in REQUIRED or quantity in columns:
            raise CsvError(
                f'{path} has no column {column!r} for {quantity}; its columns are {", ".join(names) or "none"}: '
                f'name the right one with --columns {quantity}=NAME'
            )
    return there


def _number(cell: str, where: str) -> float:
    try:
        number = float(cell)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        what = repr(cell.strip()) if cell.strip() else 'nothing'
        do = 'write decimals with a point' if ',' in cell else 'mend or remove that row'
        raise CsvError(f'{where}: {what} is no finite number; {do}')
    return number
