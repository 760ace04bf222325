# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Reads names and cells of the columns of text, MATLAB, Excel and Parquet files."""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.errors import TableError

#: Every version of MATLAB can do this.
WRITETABLE = "in MATLAB, writetable(table(t, q1, q2, tau1), 'run.csv') makes a text file of it"


class Table(NamedTuple):
    """The columns of a file."""

    names: list[str]  #: of the columns.
    cells: list[Any]  #: of each column: a tuple of texts, an array of numbers, or a pandas Series.
    row: str = 'sample'  #: the file's word for a row ...
    rows: Sequence[int] = ()  #: ... and the number of each; by default from 1 on.


def read_table(path: Path) -> Table:
    """Read a file with columns; the ending of its name gives its format.

    Raises:
        TableError: it cannot be read, or holds no columns.
    """
    read, packages = FORMATS[path.suffix.lower()]
    try:
        with path.open('rb'):
            table = read(path)
    except OSError as error:
        why = error.strerror or str(error)
        raise TableError(f'{path} cannot be read: {why}; check its name and permissions') from error
    except ImportError as error:
        raise TableError(f'reading {path} needs {packages}: pip install {packages}; or {WRITETABLE}') from error
    if not table.names:
        raise TableError(f'{path} holds no columns of numbers; export it again')
    return table


def is_table(path: Path) -> bool:
    """Tell whether a path names a file with columns by its ending; any folder is a bag."""
    return path.suffix.lower() in FORMATS and not path.is_dir()


def _text(path: Path) -> Table:
    """Read a line of column names and rows, separated by commas, semicolons, tabs or spaces."""
    data = path.read_bytes()
    utf16 = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    try:
        lines = [line.strip(' ') for line in data.decode('utf-16' if utf16 else 'utf-8-sig').splitlines()]
    except UnicodeDecodeError as error:
        raise TableError(f'{path} is no text in UTF-8 or UTF-16; export it as CSV in UTF-8') from error
    if not any(map(str.strip, lines)):
        raise TableError(f'{path} is empty; a line of column names and rows of numbers are expected: export it again')
    # Excel may write the separator in a line of its own, and numpy a # before the names.
    separator = re.fullmatch(r'"?sep=(.)"?', lines[0], re.IGNORECASE)
    first = 1 if separator else 0
    title = lines[first].lstrip('# ') if len(lines) > first else ''
    likely = [each for each in ',;\t' if each in title] or [' ' if ' ' in title else ',']
    delimiter = separator[1] if separator else max(likely, key=title.count)
    reader = csv.reader([title, *lines[first + 1 :]], delimiter=delimiter, skipinitialspace=True)
    names = [name.strip() for name in next(reader)]
    numbers, rows = list[int](), list[list[str]]()
    for row in reader:
        # Some programs end a row with a separator.
        if len(row) == len(names) + 1 and not row[-1].strip():
            row.pop()
        if not any(map(str.strip, row)):
            continue
        numbers.append(first + reader.line_num)
        rows.append(row)
        if len(row) != len(names):
            comma = delimiter == ',' and len(row) > len(names)
            why = 'decimals may be written with commas: write them with points, or ' if comma else ''
            raise TableError(
                f'{path}, line {numbers[-1]} has {len(row)} cells; {len(names)} are expected, one for each column '
                f'name; {why}correct or remove that row'
            )
    return Table(names, list(zip(*rows, strict=True)) or [()] * len(names), 'line', numbers)


def _excel(path: Path) -> Table:
    """Read the first sheet: a row of column names, and rows."""
    import pandas

    try:
        frame = pandas.read_excel(path, header=None, engine='openpyxl').dropna(how='all')
    except (BadZipFile, ValueError, KeyError, TypeError) as error:
        raise TableError(f'{path} is no Excel file ({error}); save it as .xlsx or .csv') from error
    if frame.empty:
        return Table([], [])
    names, rows = ['' if name != name else str(name).strip() for name in frame.iloc[0]], frame.iloc[1:]
    return Table(names, [rows[k] for k in rows], 'row', list(rows.index + 1))


def _parquet(path: Path) -> Table:
    import pandas
    import pyarrow

    try:
        frame = pandas.read_parquet(path, engine='pyarrow')
    except pyarrow.ArrowException as error:
        raise TableError(f'{path} is no Parquet file ({error}); export it again') from error
    return Table(list(frame.columns), [frame.iloc[:, k] for k in range(frame.shape[1])])


def _matlab(path: Path) -> Table:
    """Read variables, or the fields of structs, of version 5 to 7.3."""
    from scipy.io import loadmat
    from scipy.io.matlab import MatlabOpaque, MatReadError

    try:
        found = loadmat(path, simplify_cells=True)
        variables = {name: value for name, value in found.items() if not name.startswith('__')}
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
    return Table(names, [cells for _, cells in leaves])


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


def _leaves(variables: Mapping[str, Any], *at: str) -> Iterator[tuple[tuple[str, ...], NDArray[Any]]]:
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
