# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A table that is described once and shown in a terminal, on the page and in a notebook."""

import math
import re
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

from markupsafe import Markup, escape

#: Width of a terminal [characters].
WIDTH = 120
SUPERSCRIPTS = str.maketrans('-0123456789', '⁻⁰¹²³⁴⁵⁶⁷⁸⁹')


@dataclass(frozen=True, slots=True)
class Table:
    """A table: a head above the columns, rows with their names in the first cells, and paragraphs below."""

    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    notes: Sequence[str] = ()

    def text(self) -> str:
        """Return the first column left-aligned, the others right-aligned, and the notes below them."""
        lines = [self.head, *self.rows]
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        aligned = (
            '  '.join([first.ljust(widths[0]), *map(str.rjust, others, widths[1:])]).rstrip()
            for first, *others in lines
        )
        return '\n'.join([*aligned, *map(wrapped, self.notes)])

    def html(self) -> Markup:
        """Return the table as HTML, and the notes below it, each a paragraph."""
        head = ''.join(f'<th scope="col">{_cell(cell)}</th>' for cell in self.head)
        rows = ''
        for first, *others in self.rows:
            cells = ''.join(f'<td>{_cell(cell)}</td>' for cell in others)
            rows += f'<tr><th scope="row">{_cell(first)}</th>{cells}</tr>\n'
        notes = ''.join(f'<p class="note">{escape(note)}</p>' for note in self.notes)
        return Markup(f'<table><thead><tr>{head}</tr></thead>\n<tbody>{rows}</tbody></table>{notes}')

    def latex(self) -> str:
        """Return the table as a LaTeX tabular, its first column left-aligned, without the notes."""
        head, *rows = (' & '.join(map(_latex, line)) + r' \\' for line in [self.head, *self.rows])
        columns = 'l' + 'r' * (len(self.head) - 1)
        return '\n'.join([rf'\begin{{tabular}}{{{columns}}}', head, r'\hline', *rows, r'\end{tabular}', ''])


def _latex(text: str) -> str:
    """Return a cell in LaTeX: names with their index, powers and signs as mathematics."""
    text = re.sub(r'[%&#_]', lambda found: f'\\{found[0]}', text)
    text = re.sub(r'^([PJbk]|F[cs])(\d)(?!\d)', lambda found: f'${found[1][0]}_{{{found[1][1:]}{found[2]}}}$', text)
    text = re.sub(r'\^(-?\d)', r'$^{\1}$', text)
    return re.sub(r'(?<![\w$^{])-(?=\d)', '$-$', text.replace('±', r'$\pm$'))


def _cell(text: str) -> Markup:
    """Return the HTML of a cell; a browser may break a line after a hyphen, but not after a minus sign."""
    return escape(re.sub(r'(?<!\w)-(?=\d)|(?<=\de)-(?=\d)', '−', typeset(text)))


def number(value: float | None, format: str = '') -> str:
    """Return a number as text, a rounded zero without sign, or a dash if it is unknown."""
    return re.sub('^-(?=[0.]+$)', '', f'{value:{format}}') if value is not None and math.isfinite(value) else '-'


def typeset(text: str) -> str:
    """Return text with powers as superscripts: ``kg m²``."""
    return re.sub(r'\^(-?\d)', lambda found: found[1].translate(SUPERSCRIPTS), text)


def wrapped(text: str) -> str:
    """Return a paragraph wrapped to the width of a terminal; names of files stay complete."""
    return textwrap.fill(text, WIDTH, subsequent_indent='  ', break_long_words=False, break_on_hyphens=False)
