# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Output on a terminal: its width, a progress bar, and the brief text of a result."""

import math
import shutil
import sys
import textwrap
from collections.abc import Iterator
from contextlib import contextmanager

from tqdm import tqdm

from pendubot_identification.identification.estimate import Progress
from pendubot_identification.report.tables import parameter_table, remarks, wrapped
from pendubot_identification.results.result import PartialResult, Result

#: Largest readable width of text [columns]; largest number of lines of a brief text, including lines about files.
WIDEST, LINES = 120, 30
#: Formats of the progress bar for a step with a known end, and with an unknown end.
LAYOUT = '{desc} {bar:20} {n_fmt}/{total_fmt}{postfix} [{elapsed}, {remaining} left]'
ENDLESS = '{desc} {n_fmt}{postfix} [{elapsed}]'


def columns() -> int:
    """Return the width of text [columns], also for a pipe or a file."""
    return max(20, min(shutil.get_terminal_size((WIDEST, 24)).columns, WIDEST))


def print_level(result: PartialResult) -> None:
    """Print the level of a result below OK, and its warnings, to stderr."""
    if result.level:
        print(f'level {result.level.name}: {"; ".join(result.warnings)}', file=sys.stderr)


@contextmanager
def progress_bar(*, hidden: bool = False) -> Iterator[Progress]:
    """Show the present step, its remaining time and the best J on a terminal; nothing in a pipe or a file."""
    with tqdm(desc='preparing', disable=hidden or sys.stderr is None or None, leave=False, bar_format=ENDLESS) as bar:
        step = ''

        def progress(name: str, done: int, of: int, best: float) -> None:
            nonlocal step
            if bar.disable:
                return
            bar.set_postfix_str('' if math.isnan(best) else f'J = {best:.4e}', refresh=False)
            if name != step:
                step = name
                bar.bar_format = LAYOUT if of else ENDLESS
                bar.set_description_str(name, refresh=False)
                bar.reset(of or None)  # the remaining time refers to this step
            bar.update(done - bar.n)

        yield progress


def brief(result: Result, files: int) -> str:
    """Return a result in at most :data:`LINES` - ``files`` lines, with as many complete remarks as fit."""
    table, title = parameter_table(result), f'{result.model} model, by the criterion {result.criterion}'
    rows = table.text().splitlines()[: 1 + len(table.rows)]  # without notes
    # With a fault of the recordings, its causes need the room.
    prediction = [] if result.consequences else [*_prediction(result), '']
    head = [*_sources(result), '', title, *rows, '', *prediction]
    design = ['pendubot excite --design proposes a more informative motion'] if result.advice else []
    shown = [*remarks(result), *(f'to do: {sentence}' for sentence in (*result.advice, *design))]
    room, lines = LINES - files - len(head) - 1, list[str]()
    for paragraph in (wrapped(remark, columns()).splitlines() for remark in shown):
        if lines and len(lines) + len(paragraph) > room:
            break
        lines += paragraph
    return '\n'.join([*head, *lines[:room], 'all remarks and tables: add --verbose'])


def _sources(result: Result) -> list[str]:
    """Return lines on the training data, the validation data, and the options of their conversion."""
    lines = []
    for role in dict.fromkeys(bag.role for bag in result.bags):
        bags = [bag for bag in result.bags if bag.role == role]
        name = bags[0].bag if len(bags) == 1 else f'{len(bags)} recordings'
        samples, duration = sum(bag.samples for bag in bags), sum(bag.duration for bag in bags)
        lines.append(f'{role}: {name}, {samples} samples, {duration:.2f} s')
        lines += dict.fromkeys(f'taken as: {bag.taken_as}' for bag in bags if bag.taken_as and role == 'training')
    return lines


def _prediction(result: Result) -> list[str]:
    p = result.prediction
    errors = [f'{e:.3f} after {h:g} s' for h, e in zip(p.horizons, p.error, strict=True) if e is not None]
    if not errors:
        return ['no data remain for a prediction: the prediction errors are unknown']
    return textwrap.wrap(f'prediction errors in standard deviations of the state: {", ".join(errors)}', columns())
