# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The tables and sentences of a result and of a designed excitation, for terminal, page and notebook."""

import math
import re
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup, escape

from pendubot_identification.arrays import Array
from pendubot_identification.excitation.design import IDENTIFIABLE, Experiment
from pendubot_identification.excitation.design import Predicted as Excited
from pendubot_identification.identification.validation import SETTINGS as VALIDATION
from pendubot_identification.level import NORMAL_95, Level
from pendubot_identification.model.parameters import NAMES, SPECIFICATIONS, UNITS, Parameters
from pendubot_identification.results.result import Parameter, PartialResult, Predicted, Result

#: Width of a terminal [characters].
WIDTH = 120
SUPERSCRIPTS = str.maketrans('-0123456789', '⁻⁰¹²³⁴⁵⁶⁷⁸⁹')
VERDICTS = {
    Level.OK: 'the 95 % intervals hold, given the torque scale, the clock and g',
    Level.WARN: 'use these parameters with the reservations below',
    Level.ERROR: 'do not use these parameters in a controller',
}
HOLDS = {'zero': 'constant between samples', 'linear': 'linear between samples'}
MEANINGS = {each.name: each.meaning for each in SPECIFICATIONS}
STATES = {'q1': 'angle of link 1', 'q2': 'angle of link 2', 'dq1': 'velocity of link 1', 'dq2': 'velocity of link 2'}

#: Another result for comparison, and its name.
Beside = tuple[PartialResult, str]


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


def _cell(text: str) -> Markup:
    """Return the HTML of a cell; a browser may break a line after a hyphen, but not after a minus sign."""
    return escape(re.sub(r'(?<!\w)-(?=\d)|(?<=\de)-(?=\d)', '−', typeset(text)))


def number(value: float | None, format: str = '') -> str:
    """Return a number as text, a rounded zero without sign, or a dash if it is unknown."""
    return re.sub('^-(?=[0.]+$)', '', f'{value:{format}}') if value is not None and math.isfinite(value) else '-'


def typeset(text: str) -> str:
    """Return text with powers as superscripts: ``kg m²``."""
    return re.sub(r'\^(-?\d)', lambda found: found[1].translate(SUPERSCRIPTS), text)


def wrapped(text: str, width: int = WIDTH) -> str:
    """Return a paragraph wrapped to the width of a terminal; names of files stay complete."""
    return textwrap.fill(text, width, subsequent_indent='  ', break_long_words=False, break_on_hyphens=False)


def estimate(entry: Parameter, format: str) -> str:
    """Return the value of a parameter with the half-width of its 95 % interval."""
    return _with_error(entry.value, entry.std_error, format, entry.quantile)


def relative_half_width(entry: Parameter) -> float | None:
    """Return the half-width of the 95 % interval over the value, at most 1; None if unknown."""
    half_width = None if entry.std_error is None else entry.quantile * entry.std_error
    return None if half_width is None else min(half_width / abs(entry.value), 1.0) if entry.value else 1.0


def parameter_table(result: Result, beside: Beside | None = None, *, complete: bool = False) -> Table:
    """Return a row for each parameter: estimate, 95 % interval, estimates for comparison, and reservations.

    ``complete``: with the parameter's meaning, and with all reservations instead of one.
    """
    format, entries, head = rounding(result.parameters.values()), result.parameters, paper_heading(result)
    others = {head: result.criteria['energy'].parameters} if head else {}
    others |= {beside[1]: beside[0].parameters} if beside else {}
    reservations = [_reservations(result, name) if complete else _reservation(entry) for name, entry in entries.items()]
    columns = [
        ['', *(f'{name} [{entry.unit}]' for name, entry in entries.items())],
        ['meaning', *(MEANINGS[name] for name in entries)] if complete else [],
        ['estimate', *(number(entry.value, format) for entry in entries.values())],
        [
            '95 % interval',
            *(' to '.join(number(bound, format) for bound in entry.interval) for entry in entries.values()),
        ],
        *([title, *(number(p[n].value, format) if n in p else '-' for n in entries)] for title, p in others.items()),
        ['', *reservations] if any(reservations) else [],
    ]
    titles, *lines = zip(*filter(None, columns), strict=True)
    missing = (f'not in the model: {entry}' for entry in result.not_in_model)
    return Table(titles, lines, [f'95 % intervals: {result.criteria[result.criterion].uncertainty}', *missing])


def _reservations(result: Result, name: str) -> str:
    """Return the reasons against relying on an estimate, and its large correlations."""
    answer = result.criteria[result.criterion]
    correlated = [
        f'with {other}: {value:.2f}'
        for other, value in zip(
            answer.parameters, answer.correlation[list(answer.parameters).index(name)], strict=False
        )
        if other != name and value is not None and abs(value) > VALIDATION.correlated
    ]
    reasons = [_reservation(result.parameters[name]), result.not_covered.get(name, ''), *correlated]
    return '; '.join(filter(None, dict.fromkeys(reasons)))


def _with_error(value: float | None, error: float | None, format: str, quantile: float = NORMAL_95) -> str:
    """Return a number and, if its standard error is known, the half-width of its 95 % interval."""
    if value is None or error is None:
        return number(value, format)
    half_width = f'{quantile * error:{format}}'
    if not re.search('[1-9]', half_width):
        half_width = f'{quantile * error:.1g}'
    return f'{number(value, format)} ± {half_width}'


def paper_heading(result: Result) -> str:
    """Return the heading of the paper's estimate; empty if it is absent or the selected estimate."""
    energy = result.criteria.get('energy')
    if energy is None or result.criterion == 'energy':
        return ''
    return 'energy' if energy.mde is None else 'energy by MDE'


def rounding(entries: Iterable[Parameter]) -> str:
    """Return the format with three digits of the smallest estimate, or of its standard error if it is larger.

    Decimals are limited to seven; if most estimates need more, there are exponents instead.
    """
    sizes = [max(abs(e.value), e.std_error or 0.0) for e in entries if e.value and not e.on_bound]
    decimals = [2 - math.floor(math.log10(size)) for size in sizes] or [2]
    return '.3e' if np.median(decimals) > 7 else f'.{min(max(*decimals, 4), 7)}f'


def _reservation(entry: Parameter) -> str:
    if entry.fixed:
        return 'fixed'
    if entry.on_bound:
        return 'on its bound'
    return 'undetermined' if entry.determined is False else ''


def comparison_table(result: Result) -> Table:
    """Return a column for each criterion: parameters with their 95 % half-widths."""
    answers = [answer.parameters for answer in result.criteria.values()]
    format = rounding(entry for entries in answers for entry in entries.values())
    rows = [
        [
            f'{name} [{entry.unit}]',
            *(estimate(entries[name], format) if name in entries else '-' for entries in answers),
        ]
        for name, entry in result.parameters.items()
    ]
    return Table(['', *result.criteria], rows)


def prediction_table(result: Result) -> Table:
    """Return the errors at the end of simulations, by horizon and criterion."""
    errors = (answer.prediction.error for answer in result.criteria.values())
    rows = _error_rows(result.prediction.horizons, *errors, result.prediction.persistence)
    note = f'errors of simulated states in their standard deviations, {result.prediction.method}'
    return Table(['', *_heads(result), 'persistence'], rows, [note])


def _error_rows(horizons: Sequence[float], *errors: Sequence[float | None]) -> list[list[str]]:
    columns = zip(horizons, *errors, strict=True)
    return [[f'error after {horizon:g} s', *(number(e, '.3f') for e in row)] for horizon, *row in columns]


def fit_table(result: Result) -> Table:
    """Return the fit in per cent by the selected parameters, by horizon and state."""
    columns = zip(result.prediction.horizons, *(result.prediction.fit[state] for state in STATES), strict=True)
    return Table(
        ['', *STATES.values()],
        [[f'after {horizon:g} s', *(number(fit, '.1f') for fit in fits)] for horizon, *fits in columns],
    )


def fits(predicted: Predicted, at: float = 0.5) -> tuple[float, dict[str, float | None]]:
    """Return the longest predicted horizon up to ``at`` [s], and the fit of each state there in per cent."""
    known = [k for k, h in enumerate(predicted.horizons) if h <= at and predicted.error[k] is not None]
    k = known[-1] if known else 0
    return predicted.horizons[k], {words: predicted.fit[state][k] for state, words in STATES.items()}


def criterion_table(result: Result) -> Table:
    """Return a column for each criterion: J, input delay, condition number and level."""
    answers = result.criteria.values()
    rows = [
        ['J training', *(number(a.J.training, '.4g') for a in answers)],
        ['J validation', *(number(a.J.validation, '.4g') for a in answers)],
        ['unit of J', *(a.J.unit for a in answers)],
        ['input delay [s]', *(_with_error(a.effort.delay, a.effort.delay_std_error, '.3g') for a in answers)],
        ['condition number', *(number(a.condition_number, '.4g') for a in answers)],
        ['level', *(a.level.name for a in answers)],
    ]
    return Table(['', *_heads(result)], rows)


def _heads(result: Result) -> list[str]:
    return [f'{name}, selected' if name == result.criterion else name for name in result.criteria]


def effects_table(result: Result) -> Table | None:
    """Return the unmodelled effects and the unexplained variance; None if there is neither."""
    if result.unmodelled is None and not result.effects:
        return None
    rows = [
        [
            f'{effect.name} ({effect.where})',
            'compensated' if effect.accepted else 'possible',
            number(effect.gain, '.0f'),
            number(effect.z, '.1f'),
        ]
        for effect in result.effects
    ]
    if result.unmodelled is not None:
        fractions = ' and '.join(number(fraction, '.2%') for fraction in result.unmodelled)
        rows.append(['unexplained innovations at shoulder and elbow', fractions, '', ''])
    return Table(['effect', '', 'gain in J', "Vuong's z"], rows)


def zero_table(result: Result) -> Table | None:
    """Return the errors of the zeros of each recording by the selected criterion; None if it estimates none."""
    rows = [
        [zero.recording, _with_error(zero.q1, zero.q1_std_error, '.1f'), _with_error(zero.q2, zero.q2_std_error, '.1f')]
        for zero in result.zeros
    ]
    return Table(['errors of the zeros [degrees]', 'q1', 'q2'], rows) if rows else None


def data_sentences(result: Result) -> list[str]:
    """Return sentences on the torque, the smoothing of states, and the length of link 1 by the elbow's equation."""
    effort, length = result.effort, result.link_length
    delay = _with_error(effort.delay, effort.delay_std_error, '.3g')
    sentences = [
        f'The torque is assumed {HOLDS[effort.hold]}, with an input delay of {delay} s; states are '
        f'smoothed over {result.smoothing} s.'
    ]
    if length.value is not None:
        found = _with_error(length.value, length.std_error, '.4g')
        expected = f'; {length.expected} m was expected' if length.expected else ''
        sentences.append(
            f"The elbow's equation of motion, which contains no torque, gives {found} m as length of link 1{expected}."
        )
    return sentences


def verdict(result: Result) -> str:
    """Return the meaning of a result's level in a sentence; OK names the parameters that it does not cover."""
    if result.level is not Level.OK or not result.not_covered:
        return VERDICTS[result.level]
    named = ', '.join(f'{name} ({why})' for name, why in result.not_covered.items())
    return f'{VERDICTS[Level.OK]}; do not rely on {named}'


def remarks(result: Result) -> list[str]:
    """Return the level with each warning, or else with its meaning, and the number of consequences of a fault."""
    lines = [f'{result.level.name}: {warning}' for warning in result.warnings or [verdict(result)]]
    if followed := len(consequences(result)):
        lines.append(
            f'{followed} more follow from that: the result file (--output) and the report (--report) list them'
        )
    return lines


def own_warnings(result: Result) -> list[str]:
    """Return the warnings of each criterion that are not warnings of the result."""
    return [
        f'{name} alone, {answer.level.name}: {warning}'
        for name, answer in result.criteria.items()
        for warning in answer.warnings
        if warning not in result.warnings
    ]


def headline(result: Result) -> str:
    """Return one line with the verdict or all warnings, and the number of consequences of a fault."""
    followed = len(consequences(result))
    more = [f'{followed} more follow from that'] if followed else []
    return '; '.join([*result.warnings, *more]) or f'identified: {verdict(result)}'


def consequences(result: Result) -> list[str]:
    """Return the consequences of a severe fault of the recordings, by criterion; empty if there is none."""
    return [f'{name}: {sentence}' for name, answer in result.criteria.items() for sentence in answer.consequences]


def summary(result: Result) -> str:
    """Return the text of a result for a terminal."""
    sources = [f'{b.role}: {b.bag}, {b.samples} samples, {b.duration:.2f} s' for b in result.bags]
    sources += dict.fromkeys(f'taken as: {b.taken_as}' for b in result.bags if b.taken_as)
    selected = f'selected: the criterion {result.criterion}, {result.model} model'
    shown: list[str | Table | None] = ['\n'.join(sources), f'{selected}\n{parameter_table(result).text()}']
    # If a fault of the recordings explains the warnings, further tables would only hide it.
    if not result.consequences:
        design = 'pendubot excite --design proposes an optimal excitation for all parameters'
        shown += [
            comparison_table(result) if len(result.criteria) > 1 else None,
            prediction_table(result),
            criterion_table(result),
            '\n'.join(map(wrapped, data_sentences(result))),
            effects_table(result),
            zero_table(result),
            '\n'.join(wrapped(f'{name}: {"; ".join(answer.steps)}') for name, answer in result.criteria.items()),
            '\n'.join(map(wrapped, [*result.advice, design])) if result.advice else None,
        ]
    shown.append('\n'.join(map(wrapped, [*remarks(result), *own_warnings(result)])))
    return '\n\n'.join(part.text() if isinstance(part, Table) else part for part in shown if part)


def comparison(compared: Mapping[str, Any]) -> str:
    """Return results beside each other, as ``pendubot compare --json`` prints them."""
    letters = [chr(ord('A') + k) if k < 26 else f'A{k}' for k in range(len(compared['results']))]
    legend = [f'{letter}  {name}' for letter, name in zip(letters, compared['results'], strict=True)]
    parameters = compared['parameters']
    pairs = {name: list(zip(row['value'], row['std_error'], strict=True)) for name, row in parameters.items()}
    entries = [Parameter(value=value or 0.0, std_error=error) for pair in pairs.values() for value, error in pair]
    format = rounding(entries)
    rows = [
        [
            f'{name} [{row["unit"]}]',
            *(_with_error(value, error, format, 1.0) for value, error in pairs[name]),
            *('-' if t is None else f'{t:+.1f} ({p:.2g})' for t, p in zip(row['apart'][1:], row['p'][1:], strict=True)),
        ]
        for name, row in parameters.items()
    ]
    note = '±: standard errors; t: difference from A in standard errors of both; p: probability of such a t by chance'
    tables = [Table(['', *letters, *(f't (p) of {letter} - A' for letter in letters[1:])], rows, [note])]
    if 'on' in compared:
        rows = _error_rows(compared['horizons'], *compared['error'], compared['persistence'])
        note = f'errors of simulated states in their standard deviations, on {compared["on"]}'
        tables.append(Table(['', *letters, 'persistence'], rows, [note]))
    return '\n\n'.join(['\n'.join(legend), *(table.text() for table in tables), *map(wrapped, compared['notes'])])


def motion_lines(found: Excited, experiment: Experiment) -> list[str]:
    """Return sentences on the pulses and on the predicted motion."""
    train, speed, turns = found.train, found.speed, found.angle / (2 * np.pi)
    return [
        f'pulses: every {train.period:g} s, {100 * train.width:g} % of it, from {train.amplitude_min:g} to '
        f'{train.amplitude_max:g} N m, a new torque every {train.hold:g} s, seed {train.seed}',
        f'simulated, {experiment.duration:g} s from hanging: shoulder up to {speed[0]:.1f} rad/s and {turns[0]:.2f} '
        f'turns away, elbow up to {speed[1]:.1f} rad/s and {turns[1]:.2f} turns away',
    ]


def excitation_table(parameters: Parameters, std_error: Array | None, paper: Excited, found: Excited) -> Table:
    """Return the standard errors of each parameter now, after the paper's pulses, and after the designed pulses.

    They are in % of the value or, if it is 0, in its unit. Parameters that are 0 and not identifiable are omitted.
    ``std_error`` are the standard errors of the present estimate, shape (D,); None if unknown.
    """
    theta = parameters.vector()
    zero = theta == 0
    scale = np.where(zero, 1.0, np.abs(theta) / 100)
    columns = {"paper's pulses": paper.std_error / scale, 'these': found.std_error / scale}
    if std_error is not None:
        columns = {'now': std_error / scale, **columns}

    def row(name: str, errors: Sequence[float], unit: str = '') -> list[str]:
        ratio = errors[-2] / (errors[-1] or math.nan)
        return [name, *(f'{number(error, ".2g")}{unit}' for error in errors), number(ratio, '.1f')]

    rows = []
    for k, name in enumerate(NAMES[: len(theta)]):
        if zero[k] and not np.isfinite(found.std_error[k]):
            continue
        unit = '' if not zero[k] else ' N m/N m' if UNITS[k] == '1' else f' {UNITS[k]}'
        rows.append(row(name, [float(errors[k]) for errors in columns.values()], unit))
    compared = np.flatnonzero(~zero[:IDENTIFIABLE])
    rows.append(row('the worst', [float(errors[compared].max()) for errors in columns.values()]))
    notes = [
        'standard errors from this motion alone, in simulations of 2 s, due to encoder quantization;',
        'errors of the model make them larger; compare the ratio',
    ]
    return Table(['standard error, %', *columns, 'ratio'], rows, notes)
