# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The terminal: its width, colours, and a progress bar."""

from __future__ import annotations

import math
import os
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from tqdm import tqdm

from pendubot_identification.identify.estimate import Progress

CODES = {'bold': '1', 'red': '1;31', 'green': '1;32', 'yellow': '1;33'}
#: Widest text that is easy to read, in columns.
WIDEST = 120
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
