# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The terminal: its width, colours, curves, and a progress bar."""

from __future__ import annotations

import math
import os
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from pendubot_identification.identify.estimate import Progress

CODES = {'bold': '1', 'red': '1;31', 'green': '1;32', 'yellow': '1;33'}
#: Widest text that is easy to read, in columns.
WIDEST = 120
#: The dots of a Braille character, by row and column, and the character without dots.
DOTS, BLANK = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]]), 0x2800
#: The bar of a step whose end is known, and of another one.
LAYOUT = '{desc} {bar:20} {n_fmt}/{total_fmt}{postfix} [{elapsed}, {remaining} left]'
ENDLESS = '{desc} {n_fmt}{postfix} [{elapsed}]'


def columns() -> int:
    """Return the number of columns for text, also in a pipe or a file."""
    return max(20, min(shutil.get_terminal_size((WIDEST, 24)).columns, WIDEST))


def paint(line: str, colour: str, *, of: str) -> str:
    """Return a line with the first ``of`` in it in a colour, if stdout is a terminal with colours."""
    plain = not sys.stdout.isatty() or os.environ.get('NO_COLOR') or os.environ.get('TERM') == 'dumb'
    return line if plain else line.replace(of, f'\033[{CODES[colour]}m{of}\033[0m', 1)


def shows_curves() -> bool:
    """Tell whether stdout is a terminal that can show a :func:`curve`."""
    return sys.stdout.isatty() and 'utf' in (sys.stdout.encoding or '').lower()


def curve(x: NDArray[np.float64], width: int, height: int) -> list[str]:
    """Return a curve of numbers, shape (N,), as ``height`` lines of ``width`` Braille characters.

    Every column of dots reaches over all numbers of its part, so that no peak is lost.
    """
    rows = 4 * height
    level = np.rint((x - x.min()) / (np.ptp(x) or 1.0) * (rows - 1)).astype(int)
    dots = np.zeros((rows, 2 * width), dtype=int)
    # Parts share their ends, so that steep parts of the curve are connected.
    for column, (first, last) in enumerate(pairwise(np.linspace(0, len(x) - 1, 2 * width + 1).astype(int))):
        part = level[first : last + 1]
        dots[rows - 1 - part.max() : rows - part.min(), column] = 1
    characters = BLANK + np.einsum('hrwc,rc->hw', dots.reshape(height, 4, width, 2), DOTS)
    return [''.join(map(chr, line)) for line in characters.tolist()]


@contextmanager
def progress_bar(*, hidden: bool = False) -> Iterator[Progress]:
    """Show the present step, its remaining time and the best J on a terminal; nothing in a pipe or a file."""
    with tqdm(desc='preparing', disable=True if hidden else None, leave=False, bar_format=ENDLESS) as bar:
        step = ''

        def progress(what: str, done: int, of: int, best: float) -> None:
            nonlocal step
            if bar.disable:
                return
            bar.set_postfix_str('' if math.isnan(best) else f'J = {best:.4e}', refresh=False)
            if what != step:
                step = what
                bar.bar_format = LAYOUT if of else ENDLESS
                bar.set_description_str(what, refresh=False)
                bar.reset(of or None)  # the remaining time is that of this step
            bar.update(done - bar.n)

        yield progress
