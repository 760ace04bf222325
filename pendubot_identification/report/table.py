# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A table that is made once and shown as text for a terminal, on the page, in a notebook, and in Markdown."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import TypeAlias

#: Columns of a terminal.
WIDTH = 120


@dataclass(frozen=True, slots=True)
class Number:
    """A number as its reader sees it, None as a dash, and which entry of a result file it is.

    Attributes:
        format: how it is rounded, as Python's ``format`` takes it; empty: in full.
        entry: the path of its entry, such as ``parameters.P1.interval.0``.
        of: whose result file that is: empty for the one that is shown, else ``reference``.
        times: what the value is multiplied by before it is shown.
    """

    value: float | None
    format: str = ''
    entry: str = ''
    of: str = ''
    times: float = 1

    def __str__(self) -> str:
        return '-' if self.value is None else f'{self.value * self.times:{self.format}}'


#: Text, a number, or several cells that stand one after the other in a place.
Cell: TypeAlias = 'str | Number | tuple[Cell, ...]'


@dataclass(frozen=True, slots=True)
class Table:
    """A head above columns, rows whose first cells name them, and paragraphs below."""

    head: Sequence[Cell]
    rows: Sequence[Sequence[Cell]]
    notes: Sequence[Cell] = ()

    def text(self) -> str:
        """Return aligned columns, the first to the left and the others to the right, and the notes below them."""
        lines = [[text(cell) for cell in row] for row in (self.head, *self.rows)]
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        aligned = (
            '  '.join([first.ljust(widths[0]), *map(str.rjust, others, widths[1:])]).rstrip()
            for first, *others in lines
        )
        return '\n'.join([*aligned, *map(wrapped, self.notes)])

    def html(self) -> str:
        """Return a table, and the notes below it, each a paragraph."""
        lines = [[escape(text(cell)) for cell in row] for row in (self.head, *self.rows)]
        tags = ['th'] + ['td'] * (len(lines) - 1)
        rows = (''.join(f'<{tag}>{cell}</{tag}>' for cell in line) for tag, line in zip(tags, lines, strict=True))
        notes = ''.join(f'<p>{escape(text(note))}</p>' for note in self.notes)
        return f'<table>{"".join(f"<tr>{row}</tr>" for row in rows)}</table>{notes}'

    def markdown(self) -> str:
        """Return a table of GitHub's Markdown, and the notes below it, each a paragraph."""
        lines = [[text(cell).replace('|', r'\|') for cell in row] for row in (self.head, *self.rows)]
        lines.insert(1, ['---'] + ['---:'] * (len(self.head) - 1))
        table = '\n'.join(f'| {" | ".join(line)} |' for line in lines)
        return '\n\n'.join([table, *map(text, self.notes)]) + '\n'


def parts(cell: Cell) -> list[str | Number]:
    """Return the texts and numbers that stand one after the other in a cell."""
    return [part for inner in cell for part in parts(inner)] if isinstance(cell, tuple) else [cell]


def text(cell: Cell) -> str:
    """Return a cell as text."""
    return ''.join(map(str, parts(cell)))


def wrapped(cell: Cell) -> str:
    """Return a paragraph in lines that a terminal need not break; names of files stay whole."""
    return textwrap.fill(text(cell), WIDTH, subsequent_indent='  ', break_long_words=False, break_on_hyphens=False)
