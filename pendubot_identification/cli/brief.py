# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The short text of a result for a terminal: parameters, level, warnings and advice."""

from __future__ import annotations

import textwrap

from pendubot_identification.level import Level
from pendubot_identification.report.tables import J_sentence, own_warnings, parameter_table, remarks
from pendubot_identification.results.result import Result

from .terminal import columns, paint

#: Most lines, including those about files.
LINES = 30
COLOURS = {Level.OK: 'green', Level.WARN: 'yellow', Level.ERROR: 'red'}


def brief(result: Result, files: int) -> str:
    """Return at most :data:`LINES` lines, less ``files``; the last line counts the remarks that are left out."""
    head = [*_sources(result), '', *_parameters(result), '', *_prediction(result), '']
    design = ['pendubot excite --design proposes a more informative motion'] if result.advice else []
    shown = [(remark, COLOURS[result.level]) for remark in remarks(result)]
    shown += [(f'to do: {sentence}', 'bold') for sentence in (*result.advice, *design)]
    room, lines = LINES - files - len(head), list[str]()
    left_out = len(own_warnings(result))
    for remark, colour in shown:
        paragraph = textwrap.wrap(remark, columns(), subsequent_indent='  ', break_on_hyphens=False)
        # The first remark is always shown, and one line is kept for the last line.
        if lines and len(lines) + len(paragraph) >= room:
            left_out += 1
        else:
            lines += [paint(paragraph[0], colour, of=f'{remark.partition(":")[0]}:'), *paragraph[1:]]
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
    return [f'{result.model} model, by the criterion {result.criterion}', *lines, J_sentence(result)]


def _prediction(result: Result) -> list[str]:
    found = result.prediction
    errors = [f'{e:.3f} after {h:g} s' for h, e in zip(found.horizons, found.error, strict=True) if e is not None]
    if not errors:
        return ['no data are left for a prediction: the prediction errors are not known']
    return textwrap.wrap(f'prediction errors in standard deviations of the state: {", ".join(errors)}', columns())
