# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The terminal: its width, a progress bar, and the short text of a result."""

import math
import shutil
import textwrap
from collections.abc import Iterator
from contextlib import contextmanager

from tqdm import tqdm

from pendubot_identification.identification.estimate import Progress
from pendubot_identification.report.tables import own_warnings, parameter_table, remarks
from pendubot_identification.results.result import Result

#: Widest text that is easy to read, in columns; most lines of a short text, including those about files.
WIDEST, LINES = 120, 30
#: The bar of a step whose end is known, and of another one.
LAYOUT = '{desc} {bar:20} {n_fmt}/{total_fmt}{postfix} [{elapsed}, {remaining} left]'
ENDLESS = '{desc} {n_fmt}{postfix} [{elapsed}]'


def columns() -> int:
    """Return the number of columns for text, also in a pipe or a file."""
    return max(20, min(shutil.get_terminal_size((WIDEST, 24)).columns, WIDEST))


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


def brief(result: Result, files: int) -> str:
    """Return at most :data:`LINES` lines, less ``files``; the last line counts the remarks that are left out."""
    head = [*_sources(result), '', *_parameters(result), '', *_prediction(result), '']
    design = ['pendubot excite --design proposes a more informative motion'] if result.advice else []
    shown = [*remarks(result), *(f'to do: {sentence}' for sentence in (*result.advice, *design))]
    room, lines = LINES - files - len(head), list[str]()
    left_out = len(own_warnings(result))
    for remark in shown:
        paragraph = textwrap.wrap(remark, columns(), subsequent_indent='  ', break_on_hyphens=False)
        # The first remark is always shown, and one line is kept for the last line.
        if lines and len(lines) + len(paragraph) >= room:
            left_out += 1
        else:
            lines += paragraph
    more = f'{left_out} more remark{"s"[: left_out != 1]}, and all tables' if left_out else 'all tables'
    return '\n'.join([*head, *lines[: room - 1], f'{more}: add --verbose'])


def _sources(result: Result) -> list[str]:
    """Return a line for training, one for validation, and the options for which names and units of files stand."""
    lines = []
    for role in dict.fromkeys(bag.role for bag in result.bags):
        bags = [bag for bag in result.bags if bag.role == role]
        name = bags[0].bag if len(bags) == 1 else f'{len(bags)} recordings'
        samples, duration = sum(bag.samples for bag in bags), sum(bag.duration for bag in bags)
        lines.append(f'{role}: {name}, {samples} samples, {duration:.2f} s')
        lines += dict.fromkeys(f'taken as: {bag.taken_as}' for bag in bags if bag.taken_as and role == 'training')
    return lines


def _parameters(result: Result) -> list[str]:
    table = parameter_table(result)
    lines = table.text().splitlines()[: 1 + len(table.rows)]  # without notes
    return [f'{result.model} model, by the criterion {result.criterion}', *lines]


def _prediction(result: Result) -> list[str]:
    found = result.prediction
    errors = [f'{e:.3f} after {h:g} s' for h, e in zip(found.horizons, found.error, strict=True) if e is not None]
    if not errors:
        return ['no data are left for a prediction: the prediction errors are not known']
    return textwrap.wrap(f'prediction errors in standard deviations of the state: {", ".join(errors)}', columns())
