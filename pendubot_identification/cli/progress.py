# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A bar on a terminal, and nowhere else, that shows how far long work has come."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager

#: Told what is being done, how much of it is done, of how much (0: not known), and the best J so far or NaN.
Progress = Callable[[str, int, int, float], None]

#: Of a step with an end, and of one whose end nobody knows.
LAYOUT = '{desc} {bar:20} {n_fmt}/{total_fmt}{postfix} [{elapsed}, {remaining} left]'
ENDLESS = '{desc} {n_fmt}{postfix} [{elapsed}]'


@contextmanager
def progress_bar(*, hidden: bool = False) -> Iterator[Progress]:
    """Show what is being done, how long that step will still take, and the best J; nothing in a pipe or a file."""
    from tqdm import tqdm

    doing = 'preparing'
    with tqdm(desc=doing, disable=True if hidden else None, leave=False, bar_format=ENDLESS) as bar:

        def progress(what: str, done: int, of: int, best: float) -> None:
            nonlocal doing
            if bar.disable:
                return
            bar.set_postfix_str('' if math.isnan(best) else f'J = {best:.4e}', refresh=False)
            if what != doing:
                doing = what
                bar.bar_format = LAYOUT if of else ENDLESS
                bar.set_description_str(what, refresh=False)
                # The time left is that of this step.
                bar.reset(of or None)
            bar.update(done - bar.n)

        yield progress
