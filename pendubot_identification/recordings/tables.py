# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Reads the columns of text, MATLAB, numpy, Excel and Parquet files: their names and cells."""

import codecs
import csv
import gzip
import re
import shlex
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from io import StringIO, TextIOWrapper
from itertools import chain, islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.errors import MissingFileError, TableError
from pendubot_identification.trajectories.conventions import REQUIRED
from pendubot_identification.trajectories.conversion import Conversion

from .columns import is_unit

WRITETABLE = "in MATLAB, writetable(table(t, q1, q2, tau1), 'run.csv') makes a text file of it"
#: Number of rows of text in memory at once, before their conversion to numbers.
BLOCK = 1 << 14


class Table(NamedTuple):
    """The columns of a file."""

    names: list[str]  #: names of the columns.
    cells: list[Any]  #: columns, each a tuple of texts, an array of numbers, or a pandas Series.
    row: str = 'sample'  #: word for a row in messages.
    rows: Sequence[int] = ()  #: number of each row in the file; empty: from 1 on.
    units: Sequence[str] = ()  #: units of the columns, from a row below their names; empty if there is none.


def read_table(path: Path, conversion: Conversion) -> Table:
    """Read a file with columns in the format of its suffix. May raise TableError."""
    read, packages = FORMATS[path.suffix.lower()]
    try:
        with path.open('rb'):
            return read(path, conversion)
    except FileNotFoundError as error:
        raise MissingFileError(f'there is no file {path}; check its name and folder') from error
    except OSError as error:
        why = error.strerror or str(error)
        raise TableError(f'{path} cannot be read: {why}; check its name and permissions') from error
    except ImportError as error:
        raise TableError(f'reading {path} needs {packages}: pip install {packages}; or {WRITETABLE}') from error
    except (TableError, MemoryError):
        raise
    except Exception as error:  # the libraries raise many types for damaged files
        raise TableError(f'{path} is not a readable {path.suffix} file ({error}); export it again') from error


def is_table(path: Path) -> bool:
    """Return whether a path has the suffix of a file with columns; a folder is always a bag."""
    return path.suffix.lower() in FORMATS and not path.is_dir()


def _text(path: Path, conversion: Conversion) -> Table:
    """Read text in the given encoding, or else in UTF-8, UTF-16 or Windows-1252 (Latin-1)."""
    with gzip.open(path) if path.suffix.lower() == '.gz' else path.open('rb') as file:
        start = file.read(200)
        utf16 = start.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        encodings = ['utf-16' if utf16 else 'utf-16-le' if b'\0' in start[1::2] else 'utf-8', 'cp1252']
        if b'\0' in start or b'\x80' <= start[:1] < b'\xa0':  # cp1252 also decodes binary files
            encodings.pop()
        for encoding in [conversion.encoding] if conversion.encoding else encodings:
            file.seek(0)
            try:
                text = TextIOWrapper(file, encoding)
            except LookupError:  # the name of no encoding
                break
            with suppress(UnicodeDecodeError):
                return _separated(path, text, conversion)
            text.detach()  # or else it closes the file
    known = conversion.encoding or 'UTF-8 or UTF-16'
    raise TableError(f'{path} is no text in {known}; export it in UTF-8, or add --encoding NAME')


def _separated(path: Path, file: Iterable[str], conversion: Conversion, word: str = 'line') -> Table:
    """Read a line of column names, and rows; commas, semicolons, tabs or spaces separate the cells.

    ``word`` is the word for a line in messages.
    """
    above = conversion.skip_rows
    lines = (line.rstrip('\n').strip(' \ufeff') for line in file)  # also a byte order mark
    head = list(islice(lines, above + 50))
    if not any(map(str.strip, head)):
        raise TableError(f'{path} is empty; a line of column names and rows of numbers are expected: export it again')
    if any(line.startswith('# name: ') for line in head[:10]):
        raise TableError(f"{path} is in Octave's text format; export it from Octave by save -v7 run.mat")
    title = head[above].lstrip('# ') if len(head) > above else ''  # numpy writes a # before the names
    likely = [each for each in ',;\t' if each in title] or [' ' if ' ' in title else ',']
    delimiter = max(likely, key=title.count)
    names = [name.strip() for name in next(csv.reader([title], delimiter=delimiter, skipinitialspace=True))]
    higher = _lines_above(head)
    if len([*filter(None, names)]) < len(REQUIRED) and higher > above:
        raise _names_below(path, word, higher)
    numbered = _numbered(names)
    names, above = numbered or names, above if numbered else above + 1
    reader = csv.reader(chain(head[above:], lines), delimiter=delimiter, skipinitialspace=True)
    numbers = array('q')

    def complete() -> Iterator[list[str]]:
        for row in reader:
            # Some programs end a row with a separator.
            if len(row) == len(names) + 1 and not row[-1].strip():
                row.pop()
            if not any(map(str.strip, row)):
                continue
            numbers.append(above + reader.line_num)
            if len(row) != len(names):
                if not conversion.skip_missing:
                    comma, where = delimiter == ',' and len(row) > len(names), f'{path}, {word} {numbers[-1]}'
                    below = higher >= above > 0 and _names_below(path, word, higher)
                    raise below or _other_length(where, len(row), len(names), comma=comma)
                row = [''] * len(names)
            yield row

    rows, parts = complete(), [list[Any]() for _ in names]
    first = list(islice(rows, 1))
    units = _units(first[0]) if first else ()
    rows = chain([] if units else first, rows)
    while block := list(islice(rows, BLOCK)):
        for column, cells in zip(parts, zip(*block, strict=True), strict=True):
            column.append(_as_numbers(cells, comma=conversion.decimal == 'comma'))
    return Table(names, [_joined(column) for column in parts], word, numbers[1:] if units else numbers, units)


def _as_numbers(cells: tuple[str, ...], *, comma: bool) -> Any:
    """Return cells as an array, which takes a tenth of the memory, or unchanged if one is not a finite number."""
    with suppress(ValueError):
        numbers = np.array([float(cell.replace(',', '.') if comma else cell) for cell in cells])
        if np.isfinite(numbers).all():
            return numbers
    return cells


def _joined(parts: Sequence[Any]) -> Any:
    if parts and all(isinstance(part, np.ndarray) for part in parts):
        return np.concatenate(parts)
    return tuple(str(cell) for part in parts for cell in (part if isinstance(part, tuple) else part.tolist()))


def _names_below(path: Path, row: str, above: int) -> TableError:
    return TableError(
        f'{path} has its column names in {row} {above + 1}, {row} 1 is expected: add --skip-rows {above}',
        skip_rows=str(above),
    )


def _other_length(where: str, cells: int, names: int, *, comma: bool) -> TableError:
    why = 'decimals may be written with commas: write them with points, or ' if comma else ''
    return TableError(
        f'{where} has {cells} cells; {names} are expected, one for each column name; {why}correct or remove that row, '
        'or leave such rows out: add --skip-missing',
        **({} if comma else {'skip_missing': 'true'}),
    )


def _is_number(text: str) -> bool:
    return re.fullmatch(r'[-+]?(\d+([.,]\d*)?|[.,]\d+)([eE][-+]?\d+)?', text) is not None


def _numbered(names: Sequence[str]) -> list[str]:
    """Return the names 1, 2, ... if a row holds numbers in the place of names; else an empty list."""
    return [str(k + 1) for k in range(len(names))] if len(names) > 1 and all(map(_is_number, names)) else []


def _lines_above(lines: Sequence[str]) -> int:
    """Return the number of lines above the first line with the usual number of cells, the names; 0 if unclear."""
    for separator in ';\t,':  # beside the others, a comma may be of decimals
        counts = [line.rstrip(separator).count(separator) for line in lines[:50]]
        usual = max(set(counts), key=counts.count)
        if usual and counts.count(usual) > len(counts) / 2:
            return counts.index(usual)
    return 0


def _units(cells: Sequence[str]) -> Sequence[str]:
    """Return the units of a row of texts without numbers, at least one a unit; empty for another row."""
    words = [cell.strip().strip('[]()') for cell in cells]
    return words if any(map(is_unit, words)) and not any(map(_is_number, words)) else ()


def _excel(path: Path, conversion: Conversion) -> Table:
    """Read a sheet like text."""
    import pandas

    with pandas.ExcelFile(path, engine='openpyxl') as book:
        sheets = book.sheet_names
        sheet = conversion.sheet or sheets[0]
        if sheet not in sheets:
            raise TableError(f'{path} has no sheet {sheet}; its sheets are {", ".join(sheets)}: add --sheet NAME')
        frame = pandas.read_excel(book, sheet, header=None)
        if frame.shape[1] < len(REQUIRED) and not conversion.sheet:
            sizes = {name: pandas.read_excel(book, name, header=None).shape[1] for name in sheets[1:]}
            if other := next((name for name, size in sizes.items() if size >= len(REQUIRED)), ''):
                found = f'the sheet {sheet} of {path} holds no recording'
                raise TableError(f'{found}: add --sheet {shlex.quote(other)}', sheet=other)
    filled = frame.notna().any(axis=1)
    if not filled[conversion.skip_rows :].any():
        return Table([], [])
    text = frame.replace(r'\s*\n\s*', ' ', regex=True).to_csv(index=False, header=False)
    above = conversion.skip_rows + int(filled[conversion.skip_rows :].argmax())
    return _separated(path, StringIO(text), replace(conversion, skip_rows=above), 'row')


def _numpy(path: Path, _: Conversion) -> Table:
    with np.load(path) as found:
        return _of_variables({name: np.squeeze(value) for name, value in found.items()})


def _parquet(path: Path, _: Conversion) -> Table:
    import pandas

    return of_frame(pandas.read_parquet(path, engine='pyarrow'))


def of_frame(frame: Any) -> Table:
    """Return the columns of a pandas DataFrame; an index with a name is a column, too; else dates or decimals are t."""
    if frame.index.name is None and frame.index.dtype.kind in 'fmM':
        frame = frame.rename_axis(index='t')
    named = frame if frame.index.name in (None, *frame.columns) else frame.reset_index()
    return Table([str(name) for name in named.columns], [named.iloc[:, k] for k in range(named.shape[1])])


def _matlab(path: Path, _: Conversion) -> Table:
    """Read variables, or the fields of structs, of version 5 to 7."""
    from scipy.io import loadmat
    from scipy.io.matlab import MatlabOpaque

    try:
        found = loadmat(path, simplify_cells=True)
    except NotImplementedError as error:
        raise TableError(f"{path} is of MATLAB's version 7.3; save it with -v7, or {WRITETABLE}") from error
    variables = {name: value for name, value in found.items() if not name.startswith('__')}
    if any(isinstance(value, MatlabOpaque) for value in variables.values()):
        raise TableError(
            f'{path} holds a table or timetable T, which only MATLAB can read; in MATLAB, '
            "writetable(timetable2table(T), 'run.csv') makes a text file of it"
        )
    return _of_variables(variables)


def _of_variables(variables: Mapping[str, Any]) -> Table:
    leaves = list(_leaves(variables))
    # Shorter variables are settings.
    size = max((len(cells) for _, cells in leaves), default=0)
    leaves = [(path, cells) for path, cells in leaves if len(cells) == size]
    last = [path[-1] for path, _ in leaves]
    names = [path[-1] if last.count(path[-1]) == 1 else '.'.join(path) for path, _ in leaves]
    return Table(names, [cells for _, cells in leaves])


def _leaves(variables: Mapping[str, Any], *path: str) -> Iterator[tuple[tuple[str, ...], NDArray[Any]]]:
    """Yield columns with their paths of names; q with two columns gives q1 and q2."""
    for name, value in variables.items():
        if isinstance(value, list):  # an array of structs, such as the signals of a scope of Simulink
            value = {f'{name}{k + 1}': each for k, each in enumerate(value)}
            yield from _leaves(value, *path)
        elif isinstance(value, Mapping):
            yield from _leaves(value, *path, name)
        elif isinstance(value, np.ndarray) and value.dtype.kind in 'fiumM':  # also dates
            if value.ndim == 1:
                yield (*path, name), value
            if value.ndim == 2:
                # The longer dimension is time.
                columns = value.T if len(value) >= len(value.T) else value
                yield from (((*path, f'{name}{k + 1}'), column) for k, column in enumerate(columns))


#: The reader of each format, and the packages that it may need.
FORMATS = {
    **dict.fromkeys(('.csv', '.txt', '.tsv', '.gz'), (_text, '')),
    '.npz': (_numpy, ''),
    '.mat': (_matlab, ''),
    **dict.fromkeys(('.xlsx', '.xlsm'), (_excel, 'pandas openpyxl')),
    '.parquet': (_parquet, 'pandas pyarrow'),
}
