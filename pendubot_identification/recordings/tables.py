# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Reads names and cells of the columns of text, MATLAB, Excel and Parquet files."""

from __future__ import annotations

import codecs
import csv
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.errors import TableError

Array = NDArray[np.float64]

DECIMAL_COMMA = re.compile(r'\s*[-+]?\d*,\d+([eE][-+]?\d+)?\s*')
#: Every version of MATLAB can do this.
WRITETABLE = "in MATLAB, writetable(table(t, q1, q2, tau1), 'run.csv') makes a text file of it"


@dataclass(frozen=True)
class Table:
    """The columns of a file."""

    path: Path
    names: list[str]  #: of the columns.
    cells: list[Any]  #: of each column: an array of numbers, or a pandas Series.
    row: str = 'sample'  #: the file's word for a row ...
    rows: Sequence[int] = ()  #: ... and the number of each; by default from 1 on.

    def __post_init__(self) -> None:
        if not self.names:
            raise TableError(f'{self.path} holds no columns of numbers; export it again')

    def where(self, k: int) -> str:
        """Return the place of row k in the file."""
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
            skip: whether a cell without a finite number becomes NaN instead of an error.

        Raises:
            TableError: a cell holds no finite number.
        """
        cells = self.cells[self.names.index(name)]
        numbers = _numbers(cells, comma)
        bad = np.flatnonzero(~np.isfinite(numbers))
        if bad.size and not skip:
            cell = np.asarray(cells, dtype=object)[bad[0]]
            cell = '' if self.row == 'row' and cell != cell else str(cell).strip()
            found = (
                f'{self.where(int(bad[0]))}, column {name!r}: {repr(cell) if cell else "nothing"} is no finite number'
            )
            if DECIMAL_COMMA.fullmatch(cell):
                raise TableError(f'{found}; decimals are written with commas: add --decimal comma', decimal='comma')
            if bad.size == len(numbers) > 1:
                raise TableError(f'{found}, nor is any other there; is it another column? name it with --columns')
            raise TableError(
                f'{found}, as of {bad.size} of {len(numbers)} rows; correct or remove them, or leave them out: add '
                '--skip-missing',
                skip_missing='true',
            )
        return numbers


def _numbers(cells: Any, comma: bool) -> Array:
    """Return cells as numbers, NaN where there is none; times in seconds since the first."""
    if isinstance(cells, np.ndarray) and cells.dtype.kind == 'U':
        return np.array([_number(cell.replace(',', '.') if comma else cell) for cell in cells])
    if isinstance(cells, np.ndarray):
        return np.asarray(cells, dtype=float)
    import pandas

    cells = cells.infer_objects()
    if cells.dtype.kind in 'mM':
        return np.asarray((cells - cells.iloc[0]).dt.total_seconds(), dtype=float)
    return np.asarray(pandas.to_numeric(cells, errors='coerce'), dtype=float)


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return math.nan


def read_table(path: Path) -> Table:
    """Read a file with columns; the ending of its name gives its format.

    Raises:
        TableError: it cannot be read, or holds no columns.
    """
    read, packages = FORMATS[path.suffix.lower()]
    try:
        with path.open('rb'):
            return read(path)
    except OSError as error:
        why = error.strerror or str(error)
        raise TableError(f'{path} cannot be read: {why}; check its name and permissions') from error
    except ImportError as error:
        raise TableError(f'reading {path} needs {packages}: pip install {packages}; or {WRITETABLE}') from error


def is_table(path: Path) -> bool:
    """Tell whether a path names a file with columns by its ending; any folder is a bag."""
    return path.suffix.lower() in FORMATS and not path.is_dir()


def _text(path: Path) -> Table:
    """Read a line of column names and rows, separated by commas, semicolons, tabs or spaces."""
    data = path.read_bytes()
    utf16 = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    try:
        text = data.decode('utf-16' if utf16 else 'utf-8-sig')
    except UnicodeDecodeError as error:
        raise TableError(f'{path} is no text in UTF-8 or UTF-16; export it as CSV in UTF-8') from error
    lines = text.splitlines()
    if not any(map(str.strip, lines)):
        raise TableError(f'{path} is empty; a line of column names and rows of numbers are expected: export it again')
    # Excel may write the separator in a line of its own.
    separator = re.fullmatch(r'"?sep=(.)"?', lines[0].strip(' '), re.IGNORECASE)
    header = 1 if separator else 0
    # numpy writes a # before the names.
    line = lines[header].lstrip('# ') if len(lines) > header else ''
    likely = [each for each in ',;\t' if each in line] or [' ' if ' ' in line else ',']
    delimiter = separator[1] if separator else max(likely, key=line.count)

    def split(line: str) -> list[str]:
        cells = next(csv.reader([line], delimiter=delimiter, skipinitialspace=delimiter == ' '), [])
        return cells[:-1] if delimiter == ' ' and cells and not cells[-1] else cells

    names = [name.strip() for name in split(line)]
    rows = [k for k in range(header + 1, len(lines)) if lines[k].strip(delimiter + ' ')]
    # Some programs end a row with a separator.
    body = [lines[k].removesuffix(delimiter) if lines[k].count(delimiter) == len(names) else lines[k] for k in rows]
    numbers = [k + 1 for k in rows]
    for kind in (float, str) if body else ():
        with suppress(ValueError):
            cells = np.loadtxt(
                body,
                kind,
                delimiter=None if delimiter == ' ' else delimiter,
                comments=None,
                quotechar='"',
                ndmin=2,
            )
            if cells.shape[1] == len(names):
                return Table(path, names, list(cells.T), 'line', numbers)
    for row, number in zip(map(split, body), numbers, strict=True):
        if len(row) != len(names):
            comma = delimiter == ',' and len(row) > len(names)
            why = 'decimals may be written with commas: write them with points, or ' if comma else ''
            raise TableError(
                f'{path}, line {number} has {len(row)} cells; {len(names)} are expected, one for each column name; '
                f'{why}correct or remove that row'
            )
    return Table(path, names, [np.empty(0)] * len(names), 'line')


def _excel(path: Path) -> Table:
    """Read the first sheet: a row of column names, and rows."""
    import pandas

    try:
        frame = pandas.read_excel(path, header=None, engine='openpyxl').dropna(how='all')
    except (BadZipFile, ValueError, KeyError, TypeError) as error:
        raise TableError(f'{path} is no Excel file ({error}); save it as .xlsx or .csv') from error
    if frame.empty:
        return Table(path, [], [])
    names, rows = ['' if name != name else str(name).strip() for name in frame.iloc[0]], frame.iloc[1:]
    return Table(path, names, [rows[k] for k in rows], 'row', list(rows.index + 1))


def _parquet(path: Path) -> Table:
    import pandas
    import pyarrow

    try:
        frame = pandas.read_parquet(path, engine='pyarrow')
    except pyarrow.ArrowException as error:
        raise TableError(f'{path} is no Parquet file ({error}); export it again') from error
    return Table(path, list(frame.columns), [frame.iloc[:, k] for k in range(frame.shape[1])])


def _matlab(path: Path) -> Table:
    """Read variables, or the fields of structs, of version 5 to 7.3."""
    from scipy.io import loadmat
    from scipy.io.matlab import MatlabOpaque, MatReadError

    try:
        variables = {n: v for n, v in loadmat(path, simplify_cells=True).items() if not re.fullmatch('__.*__', n)}
        if any(isinstance(value, MatlabOpaque) for value in variables.values()):
            raise _opaque(path)
    except NotImplementedError:
        variables = _matlab_73(path)
    except (MatReadError, ValueError, TypeError, KeyError, EOFError, IndexError) as error:
        raise TableError(f'{path} is no MATLAB file that can be read ({error}); save it again') from error
    leaves = list(_leaves(variables))
    # Shorter variables are settings.
    size = max((len(cells) for _, cells in leaves), default=0)
    leaves = [(at, cells) for at, cells in leaves if len(cells) == size]
    last = [at[-1] for at, _ in leaves]
    names = [at[-1] if last.count(at[-1]) == 1 else '.'.join(at) for at, _ in leaves]
    return Table(path, names, [cells for _, cells in leaves])


def _matlab_73(path: Path) -> dict[str, Any]:
    """Return the variables of an HDF5 file, whose arrays are transposed."""
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


def _leaves(variables: Mapping[str, Any], *at: str) -> Iterator[tuple[tuple[str, ...], Array]]:
    """Return columns by their path; q with two columns gives q1 and q2."""
    for name, value in variables.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, *at, name)
        elif isinstance(value, np.ndarray) and value.dtype.kind in 'fiu' and value.ndim == 1:
            yield (*at, name), value
        elif isinstance(value, np.ndarray) and value.dtype.kind in 'fiu' and value.ndim == 2:
            # The longer dimension is time.
            columns = value.T if len(value) >= len(value.T) else value
            yield from (((*at, f'{name}{k + 1}'), column) for k, column in enumerate(columns))


def _opaque(path: Path) -> TableError:
    return TableError(
        f'{path} holds a table, timetable or other object, which MATLAB alone can read; in MATLAB, '
        "writetable(timetable2table(T), 'run.csv') makes a text file of a timetable T, and writetable(T, 'run.csv') of "
        'a table'
    )


#: The reader of each format, and the packages that it may need.
FORMATS = {
    **dict.fromkeys(('.csv', '.txt', '.tsv'), (_text, '')),
    '.mat': (_matlab, 'h5py'),
    **dict.fromkeys(('.xlsx', '.xlsm'), (_excel, 'pandas openpyxl')),
    '.parquet': (_parquet, 'pandas pyarrow'),
}
