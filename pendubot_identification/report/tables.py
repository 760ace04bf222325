# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Results as text for a terminal."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from pendubot_identification.identify.result import EffortTaken, Number, Parameter, Result
from pendubot_identification.level import Level

#: What each level means. That of OK holds where every parameter is known.
VERDICTS = {
    Level.OK: 'nothing speaks against these parameters',
    Level.WARN: 'use these parameters with the reservations below',
    Level.ERROR: 'do not use these parameters in a controller',
}
#: Columns of a terminal.
WIDTH = 120


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return aligned columns, the first to the left and the others to the right."""
    lines = [head, *rows]
    widths = [max(len(line[k]) for line in lines) for k in range(len(head))]
    return '\n'.join(
        '  '.join(
            cell.rjust(w) if k else cell.ljust(w) for k, (cell, w) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in lines
    )


def parameter_table(result: Result, truth: Mapping[str, float] | None = None) -> str:
    """Return a row a published parameter: estimate, 95 % interval, unit, the true value where known, and doubts."""
    entries = result.parameters
    digits = decimals(entries.values())
    head, rows = ['', 'estimate', '95 % interval', 'unit'], []
    if truth is not None:
        head += ['true value', 'error']
    for name, entry in entries.items():
        low, high = (fixed(value, digits) for value in entry.interval)
        row = [name, fixed(entry.value, digits), f'{low} to {high}', entry.unit]
        if truth is not None:
            row += [fixed(truth[name], digits), _error(entry.value, truth[name])]
        rows.append([*row, doubt(entry)])
    absent = (_wrapped(f'not in the model: {which}') for which in result.not_in_model)
    return '\n'.join([table([*head, ''], rows), *absent])


def comparison_table(result: Result, truth: Mapping[str, float] | None = None) -> str:
    """Return a column a criterion: its parameters beside the truth, where known, or with their standard errors."""
    criteria = {name: entry.parameters for name, entry in result.criteria.items()}
    digits = decimals(entry for parameters in criteria.values() for entry in parameters.values())
    head, rows = ['', *criteria], []
    if truth is not None:
        head.append('true value')
    for name, first in result.parameters.items():
        row = [f'{name} [{first.unit}]']
        for parameters in criteria.values():
            value, error = parameters[name].value, parameters[name].std_error
            beside = f'± {fixed(error, digits)}' if truth is None else _error(value, truth[name]).rjust(9)
            row.append(f'{fixed(value, digits)} {beside}')
        if truth is not None:
            row.append(fixed(truth[name], digits))
        rows.append(row)
    return table(head, rows)


def quality_table(result: Result) -> str:
    """Return a column a criterion: J, simulation errors beside those of standing still, delay, level."""
    criteria = result.criteria.values()
    rows = [['J training', *(scientific(e.J.training) for e in criteria), '']]
    rows.append(['J validation', *(scientific(e.J.validation) for e in criteria), ''])
    rows.append(['  in', *(e.J.unit for e in criteria), ''])
    prediction = result.prediction
    for k, horizon in enumerate(prediction.horizons):
        errors = [fixed(e.prediction.error[k], 3) for e in criteria]
        rows.append([f'error after {horizon:g} s', *errors, fixed(prediction.standing_still[k], 3)])
    rows.append(['effort acts later by', *(_delay(e.effort) for e in criteria), ''])
    rows.append(['level', *(e.level.name for e in criteria), ''])
    names = (f'{name}, published' if name == result.criterion else name for name in result.criteria)
    return table(['', *names, 'standing still'], rows)


def zero_table(result: Result) -> str:
    """Return how far off the zeros of every recording are by the published criterion; empty where it knows of none."""
    rows = [
        [zero.recording, _angle(zero.q1, zero.q1_std_error), _angle(zero.q2, zero.q2_std_error)]
        for zero in result.zeros
    ]
    return table(['zeros are off by [degrees]', 'q1', 'q2'], rows) if rows else ''


def model_table(result: Result) -> str:
    """Return how the models predict, which one was chosen, and why; empty where it was given."""
    compared = result.models.compared
    if not compared:
        return ''
    rows = []
    for score in compared:
        behind, error = score.behind or 0.0, score.behind_std_error
        beside = '' if error is None else f' ± {100 * error:.1f} %'
        errors = ' '.join(fixed(error, 4) for error in score.error)
        rows.append([score.model, str(score.parameters), errors, f'{100 * behind:+.1f} %{beside}'])
    ahead = ', '.join(f'{h:g}' for h in result.prediction.horizons[: len(compared[0].error)])
    why = 'the smallest model that predicts the training data within one standard error of the best'
    if compared[-1].exact:
        why = "the smallest model that leaves nothing but the encoders' rounding; larger ones were not tried"
    return '\n'.join(
        [
            table(['model', 'parameters', f'error after {ahead} s', 'behind the best'], rows),
            _wrapped(f'{result.model} was chosen: {why} ({result.models.by})'),
        ]
    )


def criterion_table(result: Result) -> str:
    """Return J of ``energy``: best, worst and average over MDE's runs; empty without them."""
    energy = result.criteria.get('energy')
    if energy is None or energy.mde is None:
        return ''
    J = energy.J
    rows = [['training', *_spread(J.training_runs)]]
    if J.validation is not None:
        runs = J.validation_runs
        rows.append(['validation', *(_spread(runs) if runs else ['', '', f'{J.validation:.3e}'])])
    return table([f'energy: J [{J.unit}]', 'best', 'worst', 'average'], rows)


def steps(result: Result) -> str:
    """Return what the optimiser did, a paragraph a criterion."""
    return '\n'.join(_wrapped(f'{name}: {"; ".join(entry.steps)}') for name, entry in result.criteria.items())


def not_covered(result: Result) -> Mapping[str, str]:
    """Return by name the parameters that the level says nothing of, and why."""
    if result.not_covered is not None:
        return result.not_covered
    # Results of earlier versions only mark them.
    doubts = {name: doubt(entry) for name, entry in result.parameters.items()}
    return {name: doubt for name, doubt in doubts.items() if doubt}


def verdict(result: Result) -> str:
    """Return what the level of a result means, in a sentence; one of OK names the parameters that it does not cover."""
    if result.level is not Level.OK:
        return VERDICTS[result.level]
    doubts = [f'{name} ({why})' for name, why in not_covered(result).items()]
    if doubts:
        return f'use these parameters, but do not rely on {", ".join(doubts)}'
    return VERDICTS[Level.OK]


def judgement(result: Result) -> str:
    """Return the level of what is published and every warning; of other criteria what each is warned of first."""
    level, warnings = result.level.name, result.warnings
    lines = [f'{level}: {warning}' for warning in warnings or [verdict(result)]]
    if followed := len(consequences(result)):
        lines.append(
            f'{followed} more follow from that: the result file (--output) and the report (--report) list them'
        )
    for name, entry in result.criteria.items():
        others = [warning for warning in entry.warnings if warning not in warnings]
        more = f' (and {len(others) - 1} more)' if len(others) > 1 else ''
        lines += [f'{name} alone, {entry.level.name}: {warning}{more}' for warning in others[:1]]
    return '\n'.join(map(_wrapped, lines))


def headline(result: Result) -> str:
    """Return in one line what is published: the verdict, or all warnings, and how much follows from a fault."""
    followed = len(consequences(result))
    more = [f'{followed} more follow from that'] if followed else []
    return '; '.join([*result.warnings, *more]) or f'identified: {verdict(result)}'


def consequences(result: Result) -> list[str]:
    """Return what follows from a grave fault of the recordings, by criterion; empty where there is none."""
    return [f'{name}: {sentence}' for name, entry in result.criteria.items() for sentence in entry.consequences]


def advice(result: Result) -> str:
    """Return what motion would tell more; empty where nothing is told poorly."""
    sentences = result.advice
    if not sentences:
        return ''
    design = 'pendubot excite --design proposes an excitation that tells most of all parameters'
    return '\n'.join(_wrapped(sentence) for sentence in [*sentences, design])


def side_by_side(compared: Mapping[str, Any]) -> str:
    """Return results beside each other, as ``pendubot compare`` found them."""
    letters = [_letter(k) for k in range(len(compared['results']))]
    legend = [f'{letter}  {name}' for letter, name in zip(letters, compared['results'], strict=True)]
    rows = compared['parameters']
    digits = decimals(
        Parameter(value=value or 0.0, std_error=error)
        for row in rows.values()
        for value, error in zip(row['value'], row['std_error'], strict=True)
    )
    head = ['', *letters, *(f'{letter} - A' for letter in letters[1:])]
    lines = []
    for name, row in rows.items():
        shown = (
            fixed(value, digits) + ('' if error is None else f' ± {fixed(error, digits)}')
            for value, error in zip(row['value'], row['std_error'], strict=True)
        )
        apart = ('-' if a is None else f'{a:+.1f}' for a in row['apart'][1:])
        lines.append([f'{name} [{row["unit"]}]', *shown, *apart])
    parts = ['\n'.join(legend), table(head, lines), 'differences from A in standard errors of both together']
    if 'on' in compared:
        errors = [
            [f'error after {horizon:g} s', *(fixed(e[k], 3) for e in compared['error']), fixed(still, 3)]
            for k, (horizon, still) in enumerate(zip(compared['horizons'], compared['standing_still'], strict=True))
        ]
        parts += [
            table(['', *letters, 'standing still'], errors),
            _wrapped(f'errors of simulated states in their standard deviations, on {compared["on"]}'),
        ]
    return '\n\n'.join([*parts, *map(_wrapped, compared['notes'])])


def _letter(k: int) -> str:
    return chr(ord('A') + k) if k < 26 else f'A{k}'


def whole(result: Result, truth: Mapping[str, float] | None = None) -> str:
    """Return all that a terminal shows of a result."""
    effort, length, published = result.effort, result.link_length, result.criteria[result.criterion]
    sources = (f'{b.role}: {b.bag}, {b.samples} samples, {b.duration:.2f} s' for b in result.bags)
    held = {'zero': 'held from sample to sample', 'linear': 'changing linearly from sample to sample'}
    taken = f'torque {held[effort.hold]}; states smoothed over {result.smoothing:g} s'
    if length.value is not None:
        taken += f'; P3 / P5 by the elbow alone: {length.value:.4g} m ± {length.std_error or 0:.1g} m'
        taken += '' if length.expected is None else f', expected {length.expected:g} m'
    several = len(result.criteria) > 1
    parts = [
        '\n'.join(sources),
        f'published: the answer of {result.criterion}, {result.model} model\n' + parameter_table(result, truth),
    ]
    # Where a fault of the recordings explains all that is odd, the rest would only hide it.
    if not result.consequences:
        parts += [
            comparison_table(result, truth) if several else '',
            '\n'.join(
                [
                    quality_table(result),
                    _wrapped(f'errors of simulated states in their standard deviations, {result.prediction.method}'),
                    _wrapped(f'95 % intervals: {published.uncertainty}'),
                    _wrapped(taken),
                ]
            ),
            zero_table(result),
            model_table(result),
            criterion_table(result),
            steps(result),
            advice(result),
        ]
    return '\n\n'.join(part for part in [*parts, judgement(result)] if part)


def _spread(values: Sequence[Number]) -> list[str]:
    known = [value for value in values if value is not None]
    return [f'{value:.3e}' for value in (min(known), max(known), sum(known) / len(known))] if known else ['-'] * 3


def doubt(entry: Parameter) -> str:
    """Return what stands beside a parameter that is not known; empty for others."""
    return 'on its bound' if entry.on_bound else 'undetermined' if entry.determined is False else ''


def decimals(entries: Iterable[Parameter]) -> int:
    """Return the decimals that show three digits of the smallest estimate, or of its standard error if that is more."""
    sizes = [max(abs(e.value), e.std_error or 0.0) for e in entries if e.value and not e.on_bound]
    return min(max(2 - math.floor(math.log10(min(sizes, default=1.0))), 4), 7)


def fixed(value: float | None, digits: int) -> str:
    """Return a number with so many decimals; a dash where there is none."""
    return '-' if value is None else f'{value:.{digits}f}'


def scientific(value: float | None) -> str:
    """Return a number with four digits and its power of ten; a dash where there is none."""
    return '-' if value is None else f'{value:.3e}'


def _error(value: float, truth: float) -> str:
    return f'{100 * (value / truth - 1):+.1f} %' if truth else f'{value:+.1e}'


def _angle(value: float | None, error: float | None) -> str:
    return '-' if value is None else f'{value:.1f} ± {fixed(error, 1)}'


def _delay(effort: EffortTaken) -> str:
    error = effort.delay_std_error
    return f'{1e3 * effort.delay:.2f}' + ('' if error is None else f' ± {1e3 * error:.2f}') + ' ms'


def _wrapped(text: str) -> str:
    """Return a paragraph that a terminal need not break; names of files stay whole."""
    return textwrap.fill(text, WIDTH, subsequent_indent='  ', break_long_words=False, break_on_hyphens=False)
