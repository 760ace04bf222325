# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What a terminal can show: its width, colours, and curves."""

from __future__ import annotations

import os
import shutil
import sys
from itertools import pairwise
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

CODES = {'bold': '1', 'red': '1;31', 'green': '1;32', 'yellow': '1;33'}
WIDEST = 120
#: The dots of a Braille sign, by row and column, and the sign without any.
DOTS, BLANK = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80)), 0x2800


def columns() -> int:
    """Return how many columns there are to write in; in a pipe or a file as many as are read well."""
    return max(20, min(shutil.get_terminal_size((WIDEST, 24)).columns, WIDEST))


def paint(line: str, colour: str, *, of: str) -> str:
    """Return a line, the first ``of`` in it in a colour where stdout is a terminal that has colours."""
    plain = not sys.stdout.isatty() or os.environ.get('NO_COLOR') or os.environ.get('TERM') == 'dumb'
    return line if plain else line.replace(of, f'\033[{CODES[colour]}m{of}\033[0m', 1)


def shows_curves() -> bool:
    """Tell whether stdout is a terminal that has the signs of :func:`curve`."""
    return sys.stdout.isatty() and 'utf' in (sys.stdout.encoding or '').lower()


def curve(x: NDArray[np.float64], width: int, height: int) -> list[str]:
    """Return lines of Braille, of so many signs and so many of them, from the least to the greatest of the numbers.

    Every column of dots reaches over all numbers of its part, shape (N,), so nothing that is short is lost.
    """
    import numpy as np

    low, high, rows = float(x.min()), float(x.max()), 4 * height
    level = np.rint((x - low) / ((high - low) or 1.0) * (rows - 1)).astype(int)
    # Parts share their ends, so that what is steep hangs together.
    ends = np.linspace(0, len(x) - 1, 2 * width + 1).astype(int)
    signs = np.full((height, width), BLANK)
    for k, (first, last) in enumerate(pairwise(ends)):
        part = level[first : last + 1]
        for row in range(rows - 1 - part.max(), rows - part.min()):
            signs[row // 4, k // 2] |= DOTS[row % 4][k % 2]
    return [''.join(map(chr, line)) for line in signs.tolist()]
