# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Files with columns: text, MATLAB, Excel and Parquet, each read as what its columns are called and hold."""

from __future__ import annotations

import csv
import datetime
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.errors import TableError

Array = NDArray[np.float64]
Cells = Sequence[Any] | NDArray[Any]

DECIMAL_COMMA = re.compile(r'\s*[-+]?\d*,\d+([eE][-+]?\d+)?\s*')
#: What MATLAB can always do.
WRITETABLE = "in MATLAB, writetable(table(t, q1, q2, tau1), 'run.csv') makes a text file of it"


@dataclass(frozen=True)
class Table:
    """Columns as they stand in a file."""

    path: Path
    names: list[str]  #: of the columns.
    cells: list[Cells]  #: of each column, texts, numbers or whatever the file holds.
    row: str = 'sample'  #: what the file calls a row ...
    rows: Sequence[int] = ()  #: ... and their numbers in it; by default from 1 on.

    def __post_init__(self) -> None:
        if not self.names:
            raise TableError(f'{self.path} holds no columns of numbers; export it again')

    def where(self, k: int) -> str:
        """Say where the row of number k stands."""
        return f'{self.path}, {self.row} {self.rows[k] if self.rows else k + 1}'

    def has(self, name: str) -> bool:
        """Tell whether there is such a column.

        Raises:
            TableError: there are several.
        """
        if (count := self.names.count(name)) > 1:
            raise TableError(f'{self.path} has {count} columns {name!r}; rename all but one of them')
        return count == 1

    def numbers(self, name: str, *, comma: bool = False, skip: bool = False) -> Array:
        """Return a column as numbers, shape (N,); times of day and durations in seconds.

        Args:
            name: of the column.
            comma: whether decimals are written with commas.
            skip: whether what is missing or no number is NaN, and not refused.

        Raises:
            TableError: a cell holds no finite number.
        """
        cells = self.cells[self.names.index(name)]
        if comma:
            cells = [cell.replace(',', '.') if isinstance(cell, str) else cell for cell in cells]
        try:
            numbers = _numbers(cells)
        except (ValueError, TypeError):
            numbers = np.array([_number(cell) for cell in cells])
        bad = np.flatnonzero(~np.isfinite(numbers))
        if bad.size and not skip:
            cell = str('' if cells[bad[0]] is None else cells[bad[0]]).strip()
            found = (
                f'{self.where(int(bad[0]))}, column {name!r}: {repr(cell) if cell else "nothing"} is no finite number'
            )
            if DECIMAL_COMMA.fullmatch(cell):
                raise TableError(f'{found}; decimals are written with commas: add --decimal comma', decimal='comma')
            if bad.size == len(numbers) > 1:
                raise TableError(f'{found}, nor is any other there; is it another column? name it with --columns')
            raise TableError(
                f'{found}, as of {bad.size} of {len(numbers)} rows; mend or remove them, or leave them out: add '
                '--skip-missing',
                skip_missing='true',
            )
        return numbers


def _numbers(cells: Cells) -> Array:
    """Return cells as numbers, NaN where there is none; times in seconds since the first.

    Raises:
        ValueError, TypeError: one of them is none.
    """
    first = next((cell for cell in cells if cell is not None), None)
    for kind, name in ((datetime.datetime, 'datetime64[us]'), (datetime.timedelta, 'timedelta64[us]')):
        if isinstance(first, kind):
            cells = np.array(cells, dtype=name)
    if isinstance(cells, np.ndarray) and cells.dtype.kind in 'mM':
        return np.asarray((cells - cells[0]) / np.timedelta64(1, 'ns') * 1e-9, dtype=float)
    return np.asarray(cells, dtype=float)


def _number(cell: object) -> float:
    try:
        return float(cell)  # type: ignore[arg-type]
    except (ValueError, TypeError):
        return math.nan


def read_table(path: Path) -> Table:
    """Read a file with columns, of the kind that its name's ending tells.

    Raises:
        TableError: it cannot be read, or holds no columns.
    """
    try:
        with path.open('rb'):
            return FORMATS[path.suffix.lower()](path)
    except OSError as error:
        why = error.strerror or str(error)
        raise TableError(f'{path} cannot be read: {why}; check its name and permissions') from error
    except ImportError as error:
        extra = (error.name or '').split('.')[0]
        raise TableError(
            f'{path} is read by {extra}, which is not installed: pip install {extra}; or without: {WRITETABLE}'
        ) from error


def is_table(path: Path) -> bool:
    """Tell whether a path names a file with columns by its ending; any folder is a bag."""
    return path.suffix.lower() in FORMATS and not path.is_dir()


def _text(path: Path) -> Table:
    """Read a line of column names and rows, separated by commas, semicolons, tabs or spaces."""
    try:
        text = path.read_text(encoding='utf-8-sig')
    except UnicodeDecodeError as error:
        raise TableError(f'{path} is no text in UTF-8; export it as CSV in that encoding') from error
    lines = text.splitlines()
    if not any(map(str.strip, lines)):
        raise TableError(f'{path} is empty; a line of column names and rows of numbers are expected: export it again')
    # Excel may be told the separator, and tells it, by a line of its own.
    told = re.fullmatch(r'"?sep=(.)"?', lines[0].strip(' '), re.IGNORECASE)
    # numpy writes a # before the names.
    lines[0] = lines[0].lstrip('# ')
    separators = [each for each in ',;\t' if each in lines[0]] or [' ' if ' ' in lines[0] else ',']
    delimiter = told[1] if told else max(separators, key=lines[0].count)
    reader = csv.reader(lines, delimiter=delimiter, skipinitialspace=delimiter == ' ')
    if told:
        next(reader)
    names = [name.strip() for name in next(reader, [])]
    body, first = lines[reader.line_num :], reader.line_num + 1
    with suppress(ValueError):
        # Ten times as quick, where there are numbers and nothing else; and nothing to be said of any line.
        held = np.loadtxt(body or ['-'], delimiter=None if delimiter == ' ' else delimiter, comments=None, ndmin=2)
        if held.shape == (len(body), len(names)):
            return Table(path, names, list(held.T), 'line', range(first, first + len(body)))
    rows, numbers = list[list[str]](), list[int]()
    try:
        for row in reader:
            if not any(cell.strip() for cell in row):
                continue
            # Some programs end a row with a separator; anything else means that cells are not where they belong.
            if len(row) < len(names) or any(cell.strip() for cell in row[len(names) :]):
                comma = delimiter == ',' and len(row) > len(names)
                why = 'decimals may be written with commas: write them with points, or ' if comma else ''
                raise TableError(
                    f'{path}, line {reader.line_num} has {len(row)} cells; {len(names)} are expected, one for each '
                    f'column name; {why}mend or remove that row'
                )
            rows.append(row[: len(names)])
            numbers.append(reader.line_num)
    except csv.Error as error:
        raise TableError(f'{path}, line {reader.line_num}: {error}; mend or remove that row') from error
    return Table(path, names, list(zip(*rows, strict=True)) or [()] * len(names), 'line', numbers)


def _excel(path: Path) -> Table:
    """Read the first sheet: a row of column names, and rows."""
    import openpyxl

    try:
        book = openpyxl.load_workbook(path, read_only=True, data_only=True)
    except (BadZipFile, ValueError, KeyError, TypeError) as error:
        raise TableError(f'{path} is no Excel file ({error}); save it as .xlsx or .csv') from error
    with closing(book):
        rows = list(book.worksheets[0].iter_rows(values_only=True))
    filled = [k for k, row in enumerate(rows) if any(cell is not None for cell in row)]
    if not filled:
        return Table(path, [], [])
    names = ['' if cell is None else str(cell).strip() for cell in rows[filled[0]]]
    return Table(
        path,
        names,
        [[rows[k][place] for k in filled[1:]] for place in range(len(names))],
        'row',
        [k + 1 for k in filled[1:]],
    )


def _parquet(path: Path) -> Table:
    import pyarrow
    from pyarrow import parquet

    try:
        table = parquet.read_table(path)
    except pyarrow.ArrowException as error:
        raise TableError(f'{path} is no Parquet file ({error}); export it again') from error
    return Table(path, list(table.column_names), [column.to_numpy() for column in table.columns])


def _matlab(path: Path) -> Table:
    """Read variables, or the fields of a struct, of version 5 to 7.3."""
    from scipy.io import loadmat
    from scipy.io.matlab import MatlabOpaque, MatReadError

    try:
        held = {n: v for n, v in loadmat(path, simplify_cells=True).items() if not re.fullmatch('__.*__', n)}
        if any(isinstance(value, MatlabOpaque) for value in held.values()):
            raise _opaque(path)
    except NotImplementedError:
        held = _matlab_73(path)
    except (MatReadError, ValueError, TypeError, KeyError, EOFError, IndexError) as error:
        raise TableError(f'{path} is no MATLAB file that can be read ({error}); save it again') from error
    leaves = list(_leaves(held))
    # Others are settings and remarks.
    size = max((len(cells) for _, cells in leaves), default=0)
    leaves = [(at, cells) for at, cells in leaves if len(cells) == size]
    last = [at[-1] for at, _ in leaves]
    names = [at[-1] if last.count(at[-1]) == 1 else '.'.join(at) for at, _ in leaves]
    return Table(path, names, [cells for _, cells in leaves])


def _matlab_73(path: Path) -> dict[str, Any]:
    """Return the variables of a file that is HDF5; arrays stand the other way round in it."""
    import h5py

    def value(item: Any) -> Any:
        kind = item.attrs.get('MATLAB_class', b'')
        if 'MATLAB_object_decode' in item.attrs or kind in (b'table', b'timetable'):
            raise _opaque(path)
        if isinstance(item, h5py.Group):
            return {name: value(part) for name, part in item.items()}
        return np.squeeze(item[()].T) if item.dtype.kind in 'fiu' and kind != b'char' else None

    with h5py.File(path) as file:
        return {name: value(item) for name, item in file.items() if not name.startswith('#')}


def _leaves(held: Mapping[str, Any], *at: str) -> Iterator[tuple[tuple[str, ...], Array]]:
    """Return columns by where they stand; of q with two columns q1 and q2."""
    for name, value in held.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, *at, name)
        elif isinstance(value, np.ndarray) and value.dtype.kind in 'fiu' and value.ndim == 1:
            yield (*at, name), value
        elif isinstance(value, np.ndarray) and value.dtype.kind in 'fiu' and value.ndim == 2:
            # The longer side is time.
            columns = value.T if len(value) >= len(value.T) else value
            yield from (((*at, f'{name}{k + 1}'), column) for k, column in enumerate(columns))


def _opaque(path: Path) -> TableError:
    return TableError(
        f'{path} holds a table, timetable or other object, which MATLAB alone can read; in MATLAB, '
        "writetable(timetable2table(T), 'run.csv') makes a text file of a timetable T, and writetable(T, 'run.csv') of "
        'a table'
    )


FORMATS = {
    '.csv': _text,
    '.txt': _text,
    '.tsv': _text,
    '.mat': _matlab,
    '.xlsx': _excel,
    '.xlsm': _excel,
    '.parquet': _parquet,
}
