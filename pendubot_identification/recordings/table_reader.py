# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Reads a motion from a file with columns."""

import math
import re
import shlex
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from pendubot_identification.arrays import Array, Flags, Indices
from pendubot_identification.errors import TableError
from pendubot_identification.files import content_hash
from pendubot_identification.trajectories.conventions import REQUIRED, TIME_UNITS
from pendubot_identification.trajectories.conversion import Conversion, options
from pendubot_identification.trajectories.trajectory import Trajectory

from .columns import is_current, is_unit, option_of, quantity_of, split
from .tables import Table, read_table


@dataclass(frozen=True, slots=True)
class TableSettings:
    """Thresholds for the times of a file."""

    longest_interval: float = 0.1  #: Longest sampling interval [s]; above it the unit of time is wrong.
    usual_interval: float = 0.005  #: Usual sampling interval [s]; the unit of time nearest to it is proposed.
    since_1970: float = 1e8  #: A first time above this value [s] counts from 1970.
    most_repeated: float = 0.05  #: Largest fraction of repeated times; above it the times have too few digits.


SETTINGS = TableSettings()
#: A time of day, perhaps after a date, which is ignored: times decrease at midnight.
TIME_OF_DAY = re.compile(r'(?:\s*[\d./-]+[\sT,]+)?\s*(\d{1,2}):(\d\d):(\d\d(?:[.,]\d+)?)\s*')
THOUSANDS = re.compile(r'[-+]?\d{1,3}([.,]\d{3})+[.,]\d+')
DECIMAL_COMMA = re.compile(r'\s*[-+]?\d*,\d+([eE][-+]?\d+)?\s*')


class TableReader:
    """A reader of a file with columns, with the attributes of :class:`.bag_reader.BagReader` that a result needs.

    ``table`` has columns in memory; the path is then a name for messages. ``given`` is the conversion by the user's
    options.
    """

    closed = True

    def __init__(self, path: Path, conversion: Conversion, table: Table | None = None) -> None:
        self.path, self.given, self.note, self._table = path, conversion, '', table

    @cached_property
    def content_hash(self) -> str:
        """The SHA-256 of the file in hexadecimal."""
        return content_hash([self.path])

    @cached_property
    def table(self) -> Table:
        """The columns of the file, or in memory."""
        table = self._table or read_table(self.path, self.given)
        if not table.names:
            raise TableError(f'{self.path} holds no columns of numbers; export it again')
        return table

    @cached_property
    def conversion(self) -> Conversion:
        """The conversion, completed by columns with usual names and by the units of their headers.

        Raises:
            TableError: as ``taken``.
        """
        given, names = self.given, self.table.names
        wanted = [name for name in REQUIRED if given.names[name] not in names and name not in given.columns]
        named = {quantity: [c for c in names if quantity_of(c) == quantity] for quantity in wanted}
        usual = {quantity: _only(columns) for quantity, columns in named.items()}
        columns = {**given.columns, **{quantity: column for quantity, column in usual.items() if column}}
        words, found = given.words(), dict[str, tuple[str, str]]()
        words.pop('columns', None)
        for quantity, column in replace(given, columns=columns).names.items():
            if column not in names or quantity not in (*REQUIRED, 'tau2') or not (read := option_of(self.unit(column))):
                continue
            option, value = read
            other, before = found.setdefault(option, (column, value))
            if before != value:
                raise TableError(f'{self.path}: {other!r} and {column!r} have different units; convert one of them')
            words.setdefault(option, value)
        return replace(Conversion.of(words), columns=columns)

    @property
    def taken_as(self) -> str:
        """The options inferred from the names and units of the columns; empty if there are none."""
        before, now = self.given.words(), self.conversion.words()
        return ' '.join(options({name: now[name] for name in now if now[name] != before.get(name)}))

    def unit(self, column: str) -> str:
        """Return the unit of a column, from its name or from a row of units."""
        _, unit = split(column)
        return unit or (self.table.units[self.table.names.index(column)] if self.table.units else '')

    def _unknown_unit(self, column: str, expected: str) -> str:
        """Return the begin of a sentence on a column whose unit is not known; '' if it is known or there is none."""
        unit = self.unit(column)
        found = f'{self.path}: the unit {unit!r} of the column {column!r} is not known, and {expected} are expected'
        return found if unit and not is_unit(unit) else ''

    def _amperes(self, column: str) -> float:
        """Return the size of the unit of a current [A]."""
        return 1e-3 if 'mA' in (self.unit(column), column) else 1.0

    @cached_property
    def taken(self) -> dict[str, str]:
        """The columns to use, by quantity. May raise TableError."""
        names, conversion = self.table.names, self.conversion
        taken = {name: column for name, column in conversion.names.items() if column in names}
        if several := [column for column in taken.values() if names.count(column) > 1]:
            column = several[0]
            raise TableError(f'{self.path} has {names.count(column)} columns {column!r}; rename all but one of them')
        if missing := [name for name in (*REQUIRED, *conversion.columns) if name not in taken]:
            raise self._missing(missing)
        for name, expected in (('t', 'seconds'), ('q1', 'rad or deg'), ('q2', 'rad or deg')):
            unknown = self._unknown_unit(taken[name], expected)
            if unknown and name not in self.given.columns and not (name == 't' and are_dates(self._cells(taken[name]))):
                raise TableError(
                    f'{unknown}: convert the column or, if that is no unit, name it with '
                    f'--columns {shlex.quote(f"{name}={taken[name]}")}'
                )
        torque = taken['tau1']
        if conversion.torque_constant:
            return taken
        if is_current(torque, self.unit(torque)):
            raise TableError(
                f'{self.path}: the column {torque!r} seems to hold a motor current, and a torque is expected: '
                "give the motor's constant with --torque-constant K [N m/A], and --gear N where a gear follows, or "
                f'--torque-constant {1 / self._amperes(torque):g} if it is a torque'
            )
        if unknown := self._unknown_unit(torque, 'N m'):
            raise TableError(
                f'{unknown}: give its size with --torque-constant K [N m], 1 if it is no unit, or convert the column'
            )
        return taken

    def _missing(self, quantities: list[str]) -> TableError:
        """Return the error of missing columns; it proposes a column of currents, or the usual order."""
        names = self.table.names
        likely = {name: _only([c for c in names if quantity_of(c) == name]) for name in quantities}
        if len(quantities) == len(REQUIRED) == len(names) and not any(likely.values()):
            likely = dict(zip(REQUIRED, names, strict=True))
        current = ''
        if likely.get('tau1') == '':
            current = likely['tau1'] = _only([c for c in names if is_current(c, self.unit(c))])
        named = {**self.conversion.columns, **{name: column or 'NAME' for name, column in likely.items()}}
        columns = ','.join(f'{name}={column}' for name, column in named.items())
        known = all(likely.values()) and not current
        listing = 'are numbered, without a line of names' if names[0] == '1' else f'are {", ".join(names)}'
        return TableError(
            f'{self.path} has no column {self.conversion.names[quantities[0]]!r} for {quantities[0]}; its columns '
            f'{listing}: name the right one with --columns {shlex.quote(columns)}'
            + (' --torque-constant K [N m/A], and --gear N where a gear follows' if current else ''),
            **({'columns': columns} if known else {}),
        )

    @cached_property
    def motion(self) -> Trajectory:
        """The complete motion, t from the first sample. May raise TableError."""
        conversion = self.conversion
        given = {name: self._numbers(column) for name, column in self.taken.items()}
        kept = np.logical_and.reduce([np.isfinite(numbers) for numbers in given.values()])
        if not kept.any():
            raise TableError(f'{self.path} holds no row of numbers; export the recording again')
        dated = are_dates(self._cells(self.taken['t']))
        second = 1.0 if dated else conversion.seconds
        t = given['t'][kept] * second
        if t[0] > SETTINGS.since_1970:
            t = np.round(t - t[0], 6)  # a float has no more digits of such a time
        new, self.note = without_repeats(t, str(self.path))
        kept[kept], t = new, t[new]
        wrong = np.flatnonzero(np.diff(t) <= 0)
        if wrong.size:
            rows = np.flatnonzero(kept)[wrong[0] : wrong[0] + 2]
            before, time = given['t'][rows]
            finding, remedy = 'decreases', 'keep one run in each file, in order, without a restart of the clock'
            if time == before:
                finding, remedy = 'repeats', 'export more digits, or correct or remove that row'
            raise TableError(
                f'{self._where(rows[1])}: the time {time:.15g} {finding}, after {before:.15g}; every row '
                f'needs a later one: {remedy}'
            )
        t -= t[0]
        zeros = np.zeros_like(t)

        def pair(*names: str) -> Array:
            return np.column_stack([given[name][kept] if name in given else zeros for name in names])

        q, tau, qd = pair('q1', 'q2'), pair('tau1', 'tau2'), None
        if {'dq1', 'dq2'} <= given.keys():
            qd = pair('dq1', 'dq2')
        if conversion.torque_constant:
            tau[:, 0] *= self._amperes(self.taken['tau1'])
        motion = conversion.motion(t, q, tau, qd, str(self.path))
        if len(t) > 1 and motion.interval > SETTINGS.longest_interval * (1 + 1e-6):
            apart = f'{self.path}: its rows are {motion.interval:g} s apart, above {SETTINGS.longest_interval:g} s'
            units = {unit: motion.interval / second * size for unit, size in TIME_UNITS.items()}
            unit = min(units, key=lambda each: abs(math.log(units[each] / SETTINGS.usual_interval)))
            if dated or unit == conversion.time_unit:
                raise TableError(f'{apart}: record at a higher rate')
            raise TableError(f'{apart}: its times may be in {unit}: add --time-unit {unit}', time_unit=unit)
        return motion

    def _numbers(self, column: str) -> Array:
        """Return a column as numbers, shape (N,); with ``skip_missing``, NaN for other cells, else TableError."""
        cells = self._cells(column)
        numbers = numbers_of(cells, comma=self.given.decimal == 'comma')
        bad = np.flatnonzero(~np.isfinite(numbers))
        if self.given.skip_missing or not bad.size:
            return numbers
        texts = [str(cell).strip() for cell in np.asarray(cells, dtype=object)[bad]]
        cell = texts[0]
        found = f'{self._where(bad[0])}, column {column!r}: {repr(cell) if cell else "nothing"} is no finite number'
        if grouped := next(filter(THOUSANDS.fullmatch, texts), ''):
            raise TableError(f'{found}; {grouped!r} has separators of thousands: export the numbers without them')
        if DECIMAL_COMMA.fullmatch(cell):
            raise TableError(f'{found}; decimals are written with commas: add --decimal comma', decimal='comma')
        if bad.size == len(numbers) > 1:
            raise TableError(f'{found}, nor is any other there; is it another column? name it with --columns')
        raise TableError(
            f'{found}, as of {bad.size} of {len(numbers)} rows; correct or remove them, or leave them out: add '
            '--skip-missing',
            skip_missing='true',
        )

    def _cells(self, column: str) -> Any:
        return self.table.cells[self.table.names.index(column)]

    def _where(self, k: int) -> str:
        """Return the place of row k in the file."""
        return f'{self.path}, {self.table.row} {self.table.rows[k] if self.table.rows else k + 1}'


def without_repeats(t: Array | Indices, name: str) -> tuple[Flags, str]:
    """Return a mask of the samples to keep, shape (N,), without few repeated times, and a note on the others."""
    repeated = np.append(False, np.diff(t) == 0)[: len(t)]
    if not 0 < repeated.sum() <= SETTINGS.most_repeated * len(t):
        return np.ones(len(t), dtype=bool), ''
    return ~repeated, f'{name}: {repeated.sum()} of {len(t)} samples repeat the time before; they were left out'


def _only(found: list[str]) -> str:
    return found[0] if len(found) == 1 else ''


def numbers_of(cells: Any, *, comma: bool = False) -> Array:
    """Return cells as numbers; NaN for other texts; dates and durations of numpy in seconds from the earliest."""
    if not isinstance(cells, tuple):
        cells = np.asarray(cells)
        if cells.dtype.kind in 'mM':
            missing = np.array('NaT', cells.dtype)
            return np.asarray((cells - np.fmin.reduce(cells, axis=None, initial=missing)) / np.timedelta64(1, 's'))
        if cells.dtype.kind in 'biuf':
            return np.asarray(cells, dtype=float)
    return np.array([_number(str(cell).replace(',', '.') if comma else str(cell)) for cell in cells])


def are_dates(cells: Any) -> bool:
    """Return whether cells hold dates, durations or times of day, which are in seconds with any unit of time."""
    if not isinstance(cells, tuple):
        cells = np.asarray(cells)
        if cells.dtype.kind in 'biufmM':
            return cells.dtype.kind in 'mM'
    first = next((text for text in map(str, cells) if math.isfinite(_number(text))), '')
    return _number(first) == _date(first)


def _number(cell: str) -> float:
    """Return a cell as a number, or as :func:`_date`."""
    with suppress(ValueError):
        return float(cell)
    return _date(cell)


def _date(cell: str) -> float:
    """Return a date in ISO 8601 in seconds since 1970, or a time of day in seconds; NaN for another text."""
    with suppress(ValueError):
        # Python 3.10 needs six decimals.
        text = re.sub(r'[.,](\d+)', lambda decimals: f'.{decimals[1]:0<6.6}', cell.strip().replace('Z', '+00:00'))
        date = datetime.fromisoformat(text)
        return (date if date.tzinfo else date.replace(tzinfo=timezone.utc)).timestamp()
    clock = TIME_OF_DAY.fullmatch(cell)
    return 3600 * int(clock[1]) + 60 * int(clock[2]) + float(clock[3].replace(',', '.')) if clock else math.nan
