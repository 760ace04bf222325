# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What a terminal shows of a result unless it is asked for more: parameters, how far to trust them, what to do."""

from __future__ import annotations

import textwrap

from pendubot_identification.level import Level
from pendubot_identification.report.tables import J_sentence, consequences, own_warnings, parameter_table, verdict
from pendubot_identification.results.result import Result

from .terminal import columns, paint

#: Lines of it, those about files included.
LINES = 30
COLOURS = {Level.OK: 'green', Level.WARN: 'yellow', Level.ERROR: 'red'}


def brief(result: Result, files: int) -> str:
    """Return at most :data:`LINES` lines, less those that are said of files: what is not said is in --verbose."""
    head = [*_sources(result), '', *_published(result), '', *_prediction(result), '']
    warned = [f'{result.level.name}: {warning}' for warning in result.warnings or [verdict(result)]]
    if followed := len(consequences(result)):
        warned.append(f'{followed} more follow from that: the result file and the report list them')
    design = ['pendubot excite --design proposes a motion that tells most'] if result.advice else []
    todo = [f'to do: {sentence}' for sentence in (*result.advice, *design)]
    room = LINES - files - len(head)
    lines, left_out = list[str](), sum(map(len, own_warnings(result).values()))
    for said in (*warned, *todo):
        paragraph = textwrap.wrap(said, columns(), subsequent_indent='  ', break_on_hyphens=False)
        # The first is said in any case, and a line is kept for how many are not.
        if lines and len(lines) + len(paragraph) >= room:
            left_out += 1
            continue
        colour = COLOURS[result.level] if said in warned else 'bold'
        lines += [paint(paragraph[0], colour, of=f'{said.partition(":")[0]}:'), *paragraph[1:]]
    more = f'{left_out} more remark{"s"[: left_out != 1]}, and all tables' if left_out else 'all tables'
    return '\n'.join([*head, *lines[: room - 1], f'{more}: add --verbose'])


def _sources(result: Result) -> list[str]:
    """Return a line for what estimated and one for what validated."""
    lines = []
    for role in dict.fromkeys(bag.role for bag in result.bags):
        bags = [bag for bag in result.bags if bag.role == role]
        which = bags[0].bag if len(bags) == 1 else f'{len(bags)} recordings'
        samples, duration = sum(bag.samples for bag in bags), sum(bag.duration for bag in bags)
        lines.append(f'{role}: {which}, {samples} samples, {duration:.2f} s')
    return lines


def _published(result: Result) -> list[str]:
    table = parameter_table(result)
    # How the intervals came about, and what the rig cannot have, is not what one looks for first.
    lines = table.text().splitlines()[: 1 + len(table.rows)]
    return [f'{result.model} model, by the criterion {result.criterion}', *lines, J_sentence(result)]


def _prediction(result: Result) -> list[str]:
    found = result.prediction
    told = [(h, e) for h, e in zip(found.horizons, found.error, strict=True) if e is not None]
    if not told:
        return ['nothing is left to be predicted: how well the parameters predict is not known']
    said = ', '.join(f'{e:.3f} after {h:g} s' for h, e in told)
    return textwrap.wrap(f'errors of prediction, in standard deviations: {said}', columns())
