# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What a result says, as tables and sentences: those of the terminal and those of the page."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pendubot_identification.identify.advice import TOGETHER
from pendubot_identification.identify.result import Given, Parameter, Result
from pendubot_identification.level import NORMAL_95, Level

from .table import Cell, Number, Table, wrapped

#: What each level means.
VERDICTS = {
    Level.OK: 'the 95 % intervals hold',
    Level.WARN: 'use these parameters with the reservations below',
    Level.ERROR: 'do not use these parameters in a controller',
}
#: What no recording tells.
GIVEN = 'given the torque scale, the clock and g'
HOLDS = {'zero': 'held from sample to sample', 'linear': 'changing linearly from sample to sample'}
STATES = {'q1': 'angle of link 1', 'q2': 'angle of link 2', 'dq1': 'velocity of link 1', 'dq2': 'velocity of link 2'}


@dataclass(frozen=True, slots=True)
class ParameterRow:
    """A parameter as the page shows it.

    Attributes:
        value: with the half of its 95 % interval.
        part: what part of the value that is, at most all of it; None where it is not known.
        paper: its value in the paper's answer.
        beside: its value in what stands beside the result.
        doubts: why it is not to be relied upon, and with which others it is correlated.
        advice: what would tell more of it.
    """

    name: str
    unit: str
    value: Cell
    part: float | None
    paper: Cell
    beside: Cell
    doubts: list[Cell]
    advice: list[str]


#: Another result, or parameters alone, to be shown beside a result, and what to call it.
Beside = tuple[Result | Given, str]


def entry(result: Result | Given, path: str) -> Any:
    """Return an entry of a result by its path, such as ``parameters.P1.interval.0``."""
    found: Any = result
    for key in path.split('.'):
        if isinstance(found, Sequence):
            found = found[int(key)]
        else:
            found = found[key] if isinstance(found, Mapping) else getattr(found, key)
    return found.name if isinstance(found, Level) else found


def number(result: Result | Given, path: str, format: str = '', of: str = '') -> Number:
    """Return the number at a path, to be shown; ``format`` and ``of`` as in :class:`.Number`."""
    return Number(entry(result, path), format, path, of)


def _with_error(result: Result, path: str, format: str, error: str = '', quantile: float = NORMAL_95) -> Cell:
    """Return the number at a path with, where it is known, the half-width of its 95 % interval.

    That is ``quantile`` standard errors, which are at ``error`` or beside the number.
    """
    at = error or f'{path}_std_error'
    value, known = number(result, path, format), entry(result, at)
    return value if known is None else (value, ' ± ', Number(known, format, at, times=quantile))


def _estimate(result: Result, at: str, format: str) -> Cell:
    """Return the parameter at a path with the half-width of its 95 % interval."""
    return _with_error(result, f'{at}.value', format, f'{at}.std_error', entry(result, at).quantile)


def papers_head(result: Result) -> str:
    """Return what to call the paper's answer, which stands beside the published one; empty where there is none."""
    energy = result.criteria.get('energy')
    if energy is None or result.criterion == 'energy':
        return ''
    return 'energy' if energy.mde is None else 'energy by MDE'


def _papers(result: Result, name: str, format: str) -> Cell:
    answer = result.criteria['energy'].parameters
    return number(result, f'criteria.energy.parameters.{name}.value', format) if name in answer else '-'


def J_sentence(result: Result) -> Cell:
    """Return J of what is published, and of the paper's answer."""

    def J(name: str) -> Cell:
        at = f'criteria.{name}.J'
        judged = entry(result, at).validation is not None
        validation: Cell = (', ', number(result, f'{at}.validation', '.4g'), ' on validation') if judged else ''
        return f'{name} ', number(result, f'{at}.training', '.4g'), ' ', entry(result, f'{at}.unit'), validation

    paper: Cell = ('; ', J('energy')) if papers_head(result) else ''
    return 'J: ', J(result.criterion), paper


def _joined(separator: str, numbers: Iterable[Number]) -> Cell:
    return tuple(part for each in numbers for part in (separator, each))[1:]


def rounding(entries: Iterable[Parameter]) -> str:
    """Return the format that shows three digits of the smallest estimate, or of its standard error if that is more."""
    sizes = [max(abs(e.value), e.std_error or 0.0) for e in entries if e.value and not e.on_bound]
    return f'.{min(max(2 - math.floor(math.log10(min(sizes, default=1.0))), 4), 7)}f'


def parameter_table(result: Result, beside: Beside | None = None) -> Table:
    """Return a row a published parameter: estimate, 95 % interval, what stands beside it, and doubts."""
    entries = result.parameters
    exact, doubts = rounding(entries.values()), [_doubt(entry) for entry in entries.values()]

    def interval(of: Result | Given, name: str, label: str = '') -> Cell:
        low, high = (number(of, f'parameters.{name}.interval.{k}', exact, label) for k in (0, 1))
        return low, ' to ', high

    def reference(of: Result | Given, name: str) -> Cell:
        if name not in of.parameters:
            return '-'
        value = number(of, f'parameters.{name}.value', exact, 'reference')
        known = of.parameters[name].interval[0] is not None
        return (value, ' (', interval(of, name, 'reference'), ')') if known else value

    columns: list[tuple[str, Sequence[Cell]]] = [
        ('', [f'{name} [{entry.unit}]' for name, entry in entries.items()]),
        ('estimate', [number(result, f'parameters.{name}.value', exact) for name in entries]),
        ('95 % interval', [interval(result, name) for name in entries]),
    ]
    if head := papers_head(result):
        columns.append((head, [_papers(result, name, exact) for name in entries]))
    columns += [(beside[1], [reference(beside[0], name) for name in entries])] if beside else []
    columns += [('', doubts)] if any(doubts) else []
    heads, cells = zip(*columns, strict=True)
    notes = [f'95 % intervals: {result.criteria[result.criterion].uncertainty}']
    return Table(
        heads, list(zip(*cells, strict=True)), notes + [f'not in the model: {which}' for which in result.not_in_model]
    )


def parameter_rows(result: Result, beside: Beside | None = None) -> list[ParameterRow]:
    """Return of every published parameter what the page's table shows of it."""
    exact = rounding(result.parameters.values())
    names, rows = list(result.parameters), []
    published = result.criteria[result.criterion]
    uncovered = result.not_covered or {}
    for name, found in result.parameters.items():
        doubts: list[Cell] = [doubt] if (doubt := _doubt(found)) else []
        doubts += [why] if (why := uncovered.get(name)) and why not in doubts else []
        doubts += [
            (
                f'with {other}: ',
                number(result, f'criteria.{result.criterion}.correlation.{names.index(name)}.{k}', '.2f'),
            )
            for k, other in enumerate(names)
            if other != name and abs(published.correlation[names.index(name)][k] or 0.0) > TOGETHER
        ]
        error, size, paper = found.std_error, abs(found.value), papers_head(result)
        rows.append(
            ParameterRow(
                name,
                found.unit,
                _estimate(result, f'parameters.{name}', exact),
                None if error is None or not size else min(found.quantile * error / size, 1.0),
                _papers(result, name, exact) if paper else '',
                number(beside[0], f'parameters.{name}.value', exact, 'reference')
                if beside and name in beside[0].parameters
                else '',
                doubts,
                [sentence for sentence in result.advice if f' of {name} (' in sentence],
            )
        )
    return rows


def other_advice(result: Result) -> list[str]:
    """Return the advice that is of no parameter in particular."""
    return [each for each in result.advice if not any(f' of {name} (' in each for name in result.parameters)]


def _doubt(entry: Parameter) -> str:
    return (
        'held'
        if entry.held
        else 'on its bound'
        if entry.on_bound
        else 'undetermined'
        if entry.determined is False
        else ''
    )


def comparison_table(result: Result, truth: Mapping[str, float] | None = None) -> Table:
    """Return a column a criterion: its parameters with their standard errors or, where known, their true errors."""
    exact = rounding(found for answer in result.criteria.values() for found in answer.parameters.values())

    def cell(criterion: str, name: str) -> Cell:
        at = f'criteria.{criterion}.parameters.{name}'
        if name not in result.criteria[criterion].parameters:
            return '-'
        if truth is None:
            return _estimate(result, at, exact)
        value, true = number(result, f'{at}.value', exact), truth[name]
        found = entry(result, f'{at}.value')
        off = f'{100 * (found / true - 1):+.1f} %' if true else f'{found:+.1e}'
        return value, f' {off:>9}'

    rows = [
        [
            f'{name} [{published.unit}]',
            *(cell(criterion, name) for criterion in result.criteria),
            *([] if truth is None else [Number(truth[name], exact)]),
        ]
        for name, published in result.parameters.items()
    ]
    return Table(['', *result.criteria, *([] if truth is None else ['true value'])], rows)


def _by_horizon(result: Result, label: str, columns: Mapping[str, str], format: str, notes: Sequence[Cell]) -> Table:
    """Return a row a horizon of lists of numbers, whose paths stand by the columns' heads."""
    rows: list[list[Cell]] = [
        [
            (label, number(result, f'prediction.horizons.{k}', 'g'), ' s'),
            *(number(result, f'{path}.{k}', format) for path in columns.values()),
        ]
        for k in range(len(result.prediction.horizons))
    ]
    return Table(['', *columns], rows, notes)


def prediction_table(result: Result) -> Table:
    """Return a row a horizon and a column a criterion: how far simulation ends from what was measured."""
    columns = {head: f'criteria.{name}.prediction.error' for name, head in _heads(result).items()}
    note = f'errors of simulated states in their standard deviations, {result.prediction.method}'
    return _by_horizon(result, 'error after ', columns | {'persistence': 'prediction.persistence'}, '.3f', [note])


def fit_table(result: Result) -> Table:
    """Return a row a horizon and a column a state: the fit in per cent by the published parameters."""
    return _by_horizon(result, 'after ', {head: f'prediction.fit.{s}' for s, head in STATES.items()}, '.1f', [])


def criterion_table(result: Result) -> Table:
    """Return a column a criterion: the J that it minimised, the effort's delay, its condition number and its level."""
    paths = [f'criteria.{name}' for name in result.criteria]
    rows = [
        ['J training', *(number(result, f'{at}.J.training', '.4g') for at in paths)],
        ['J validation', *(number(result, f'{at}.J.validation', '.4g') for at in paths)],
        ['unit of J', *(entry(result, f'{at}.J.unit') for at in paths)],
        ['effort acts later by [s]', *(_with_error(result, f'{at}.effort.delay', '.3g') for at in paths)],
        ['condition number', *(number(result, f'{at}.condition_number', '.4g') for at in paths)],
        ['level', *(entry(result, f'{at}.level') for at in paths)],
    ]
    return Table(['', *_heads(result).values()], rows)


def _heads(result: Result) -> dict[str, str]:
    """Return what stands above each criterion's column."""
    return {name: f'{name}, published' if name == result.criterion else name for name in result.criteria}


def run_table(result: Result) -> Table | None:
    """Return J of ``energy``: best, worst and average over MDE's runs; None without them."""
    energy = result.criteria.get('energy')
    if energy is None or energy.mde is None:
        return None

    def spread(values: Sequence[float | None]) -> list[str]:
        known = [value for value in values if value is not None]
        return [f'{v:.3e}' for v in (min(known), max(known), sum(known) / len(known))] if known else ['-'] * 3

    J = energy.J
    rows = [['training', *spread(J.training_runs)]]
    if J.validation is not None:
        rows.append(
            ['validation', *(spread(J.validation_runs) if J.validation_runs else ['', '', f'{J.validation:.3e}'])]
        )
    return Table([f'energy: J [{J.unit}]', 'best', 'worst', 'average'], rows)


def effects_table(result: Result) -> Table | None:
    """Return the unmodelled effects, and what nothing explains; None where there is neither."""
    if result.unmodelled is None and not result.effects:
        return None
    rows: list[list[Cell]] = [
        [
            f'{e.name} ({e.where})',
            'compensated' if e.accepted else 'possible',
            number(result, f'effects.{k}.gain', '.0f'),
            number(result, f'effects.{k}.z', '.1f'),
        ]
        for k, e in enumerate(result.effects)
    ]
    if result.unmodelled is not None:
        parts = (number(result, f'unmodelled.{k}', '.2%') for k in (0, 1))
        rows.append(['unexplained innovations at shoulder and elbow', _joined(' and ', parts), '', ''])
    return Table(['effect', '', 'gain in J', "Vuong's z"], rows)


def zero_table(result: Result) -> Table | None:
    """Return how far off the zeros of every recording are by the published criterion; None where it knows of none."""
    rows = [
        [zero.recording, *(_with_error(result, f'zeros.{k}.{joint}', '.1f') for joint in ('q1', 'q2'))]
        for k, zero in enumerate(result.zeros)
    ]
    return Table(['zeros are off by [degrees]', 'q1', 'q2'], rows) if rows else None


def data_sentences(result: Result) -> list[Cell]:
    """Return how the torque and the states were taken, and what the elbow's own equation says of link 1."""
    hold, length = result.effort.hold, result.link_length
    sentences: list[Cell] = [
        (
            f'The torque was taken as {HOLDS.get(hold, hold)}, and as acting later than it is stamped by ',
            _with_error(result, 'effort.delay', '.3g'),
            ' s; states were smoothed over ',
            number(result, 'smoothing'),
            ' s.',
        )
    ]
    if length.value is not None:
        expected = ('; ', number(result, 'link_length.expected'), ' m was expected') if length.expected else ''
        found = _with_error(result, 'link_length.value', '.4g', 'link_length.std_error')
        says = "The elbow's own equation, in which no torque stands, gives the length of link 1 as "
        sentences.append((says, found, ' m', expected, '.'))
    return sentences


def steps(result: Result) -> str:
    """Return what the optimiser did, a paragraph a criterion."""
    return '\n'.join(wrapped(f'{name}: {"; ".join(answer.steps)}') for name, answer in result.criteria.items())


def verdict(result: Result) -> str:
    """Return what the level of a result means, in a sentence; OK names the parameters that it does not cover."""
    if result.level is not Level.OK:
        return VERDICTS[result.level]
    doubts = result.not_covered
    if doubts is None:  # results of earlier versions only mark them
        doubts = {name: doubt for name, entry in result.parameters.items() if (doubt := _doubt(entry))}
    if doubts:
        named = ', '.join(f'{name} ({why})' for name, why in doubts.items())
        return f'{VERDICTS[Level.OK]}, {GIVEN}; do not rely on {named}'
    return f'{VERDICTS[Level.OK]}, {GIVEN}'


def judgement(result: Result) -> str:
    """Return the level of what is published and every warning; of other criteria what each is warned of first."""
    lines = [f'{result.level.name}: {warning}' for warning in result.warnings or [verdict(result)]]
    if followed := len(consequences(result)):
        lines.append(
            f'{followed} more follow from that: the result file (--output) and the report (--report) list them'
        )
    for name, (first, *others) in own_warnings(result).items():
        more = f' (and {len(others)} more)' if others else ''
        lines.append(f'{name} alone, {result.criteria[name].level.name}: {first}{more}')
    return '\n'.join(map(wrapped, lines))


def own_warnings(result: Result) -> dict[str, list[str]]:
    """Return by criterion the warnings that what is published does not have; without criteria that have none."""
    found = {
        name: [warning for warning in answer.warnings if warning not in result.warnings]
        for name, answer in result.criteria.items()
    }
    return {name: warnings for name, warnings in found.items() if warnings}


def headline(result: Result) -> str:
    """Return in one line what is published: the verdict, or all warnings, and how much follows from a fault."""
    followed = len(consequences(result))
    more = [f'{followed} more follow from that'] if followed else []
    return '; '.join([*result.warnings, *more]) or f'identified: {verdict(result)}'


def consequences(result: Result) -> list[str]:
    """Return what follows from a grave fault of the recordings, by criterion; empty where there is none."""
    return [f'{name}: {sentence}' for name, answer in result.criteria.items() for sentence in answer.consequences]


def summary(result: Result) -> str:
    """Return all that a terminal shows of a result."""
    sources = [f'{b.role}: {b.bag}, {b.samples} samples, {b.duration:.2f} s' for b in result.bags]
    published = f'published: the answer of {result.criterion}, {result.model} model'
    shown: list[str | Table | None] = [
        '\n'.join(sources),
        f'{published}\n{parameter_table(result).text()}\n{wrapped(J_sentence(result))}',
    ]
    # Where a fault of the recordings explains all that is odd, the rest would only hide it.
    if not result.consequences:
        design = 'pendubot excite --design proposes an excitation that identifies all parameters as well as can be'
        shown += [
            comparison_table(result) if len(result.criteria) > 1 else None,
            prediction_table(result),
            criterion_table(result),
            '\n'.join(map(wrapped, data_sentences(result))),
            effects_table(result),
            zero_table(result),
            run_table(result),
            steps(result),
            '\n'.join(map(wrapped, [*result.advice, design])) if result.advice else None,
        ]
    shown.append(judgement(result))
    return '\n\n'.join(part.text() if isinstance(part, Table) else part for part in shown if part)


def comparison(compared: Mapping[str, Any]) -> str:
    """Return results beside each other, as ``pendubot compare --json`` prints them."""
    letters = [chr(ord('A') + k) if k < 26 else f'A{k}' for k in range(len(compared['results']))]
    legend = [f'{letter}  {name}' for letter, name in zip(letters, compared['results'], strict=True)]
    found = compared['parameters'].values()
    pairs = [list(zip(row['value'], row['std_error'], strict=True)) for row in found]
    exact = rounding(Parameter(value=value or 0.0, std_error=error) for row in pairs for value, error in row)
    rows: list[list[Cell]] = [
        [
            f'{name} [{row["unit"]}]',
            *((Number(value, exact), '' if error is None else f' ± {error:{exact}}') for value, error in pair),
            *(
                '-' if t is None else (Number(t, '+.1f'), ' (', Number(p, '.2g'), ')')
                for t, p in zip(row['apart'][1:], row['p'][1:], strict=True)
            ),
        ]
        for (name, row), pair in zip(compared['parameters'].items(), pairs, strict=True)
    ]
    note = '±: standard errors; t: difference from A in standard errors of both; p: how likely chance makes it as large'
    tables = [Table(['', *letters, *(f't (p) of {letter} - A' for letter in letters[1:])], rows, [note])]
    if 'on' in compared:
        columns = zip(compared['horizons'], *compared['error'], compared['persistence'], strict=True)
        rows = [[f'error after {horizon:g} s', *(Number(e, '.3f') for e in errors)] for horizon, *errors in columns]
        note = f'errors of simulated states in their standard deviations, on {compared["on"]}'
        tables.append(Table(['', *letters, 'persistence'], rows, [note]))
    return '\n\n'.join(['\n'.join(legend), *(table.text() for table in tables), *map(wrapped, compared['notes'])])
