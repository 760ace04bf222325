# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A result as one HTML page that needs nothing beside it: no network, no script, no other file.

Every number of the result stands in a ``<data>`` element that says which entry of the result file it is and holds that
entry's own value, so that page and file can be compared.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any

from pendubot_identification.identify.result import Given, Result, plain
from pendubot_identification.model.parameters import SPECIFICATIONS

from .figures import Picture
from .tables import consequences, decimals, doubt, fixed, scientific, verdict

MEANINGS = {s.name: s.meaning for s in SPECIFICATIONS}
UNITS = {'q1': 'angle of link 1', 'q2': 'angle of link 2', 'dq1': 'velocity of link 1', 'dq2': 'velocity of link 2'}
HOLDS = {'zero': 'held from sample to sample', 'linear': 'changing linearly from sample to sample'}
CRITERIA = {
    'energy': 'the work done equals the energy gained',
    'weak': 'the equations of motion, weighted with smooth bumps, balance',
    'trajectory': 'simulated motion equals recorded motion',
}
STYLE = """
:root { color-scheme: light; --line: #d0d0d0; --ink: #1a1a1a; --quiet: #555; }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 76rem; padding: 1rem; color: var(--ink); background: #fff;
  font: 1rem/1.5 system-ui, "DejaVu Sans", sans-serif; overflow-wrap: anywhere; }
h1 { font-size: 1.6rem; line-height: 1.2; margin: .5rem 0; }
h2 { font-size: 1.25rem; margin: 2.2rem 0 .5rem; border-bottom: 1px solid var(--line); }
h3 { font-size: 1rem; margin: 1rem 0 .25rem; }
p { max-width: 46rem; margin: .4rem 0; }
.level { border-left: .5rem solid #009e73; padding: .2rem .8rem; margin: 1rem 0; }
.level.WARN { border-color: #e69f00; } .level.ERROR { border-color: #c1272d; }
.level ul { margin: .3rem 0; padding-left: 1.1rem; max-width: 46rem; }
.figures { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 30rem), 1fr)); gap: 1.5rem 2rem;
  align-items: start; }
figure { margin: 0; max-width: 40rem; break-inside: avoid; }
figure img { display: block; width: 100%; height: auto; }
figcaption { font-size: .9rem; } figcaption p { margin: .2rem 0; }
.good { border-left: .25rem solid #009e73; padding-left: .5rem; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; margin: .6rem 0; font-size: .9rem;
  max-width: 100%; break-inside: avoid; overflow-wrap: break-word; }
th, td { text-align: right; padding: .2rem .6rem; border-bottom: 1px solid var(--line); vertical-align: top; }
th:first-child, td:first-child { text-align: left; padding-left: 0; }
th { font-weight: 600; } tbody th { font-weight: 400; }
td small, th small { display: block; color: var(--quiet); font-size: .8rem; line-height: 1.25; }
data { white-space: nowrap; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: .1rem 1rem; font-size: .85rem; margin: .4rem 0; }
dt { color: var(--quiet); } dd { margin: 0; }
dd data { white-space: normal; }
@media (max-width: 40rem) {
  body { padding: .6rem; } table { font-size: .72rem; } th, td { padding: .2rem .22rem; }
  td small, th small { font-size: .66rem; } dl { display: block; } dd { margin: 0 0 .3rem 1rem; }
}
@media print {
  @page { margin: 14mm; } html { font-size: 75%; } body { padding: 0; max-width: none; } h2, h3 { break-after: avoid; }
  .figures { grid-template-columns: 1fr 1fr; gap: 1rem; }
}
"""


def result_page(
    result: Result,
    motion: Sequence[Picture],
    sections: Mapping[str, Sequence[Picture]],
    reference: Result | Given | None = None,
    reference_name: str = 'reference',
    notes: Sequence[str] = (),
) -> str:
    """Return the page of a result.

    Args:
        result: of an identification.
        motion: the figures of recorded and simulated motion, which come first.
        sections: all others under their heading, in order.
        reference: another result, or parameters alone, to stand beside it.
        reference_name: what that is called.
        notes: what else its reader should know, such as why a figure is not there.
    """
    show = _Shown(result)
    criterion, model, level = result.criterion, result.model, result.level.name
    parts = [
        f'<h1>Parameters of a pendubot, by <em>{escape(criterion)}</em>, {escape(model)} model</h1>',
        _judgement(result),
        *(f'<p><strong>Not shown:</strong> {escape(note)}</p>' for note in notes),
        '<p>The parameters of an arm of two links were estimated from its recorded motion and torque, and tried on '
        + ('motion that was not used' if _validated(result) else 'parts of it that were left out in turn')
        + f'. Of the criteria below the published one is <em>{escape(criterion)}</em>: '
        f'{CRITERIA.get(criterion, "")}.</p>',
        '<h2>Parameters</h2>',
        _parameters(result, show, reference, reference_name),
        *(f'<p>{escape(sentence)}.</p>' for sentence in result.advice),
        _section('Recorded and simulated motion', motion),
        '<h2>How well they predict</h2>',
        _quality(result, show),
        *(_section(title, pictures) for title, pictures in sections.items()),
        '<h2>How they were found</h2>',
        _how(result, show),
        '<h2>Where all this comes from</h2>',
        _provenance(show),
    ]
    return _page(f'Pendubot: {criterion}, {model} model, {level}', parts)


def failure_page(reason: str, asked: Sequence[str], pictures: Sequence[Picture] = ()) -> str:
    """Return the page of an identification that failed.

    Args:
        reason: why, in a sentence: what was found, what was expected, what to do.
        asked: what was asked for, as it was typed.
        pictures: of the data, as far as they could be read.
    """
    parts = [
        '<h1>No parameters: the identification failed</h1>',
        f'<section class="level ERROR"><strong>ERROR: there is no result</strong><ul><li>{escape(reason)}</li></ul>'
        '</section>',
        '<h2>What was asked for</h2>',
        '<ul>' + ''.join(f'<li>{escape(text)}</li>' for text in asked) + '</ul>',
        _section('What was read', pictures) or '<p>No data could be drawn.</p>',
    ]
    return _page('Pendubot: no parameters', parts)


class _Shown:
    """Numbers of a result as HTML, each with the entry that it is."""

    def __init__(self, result: Result | Given, of: str = '') -> None:
        self._result, self._of = plain(result), f' data-of="{of}"' if of else ''

    def entry(self, path: str) -> Any:
        """Return an entry, such as that of ``parameters.P1.interval.0``."""
        found: Any = self._result
        for key in path.split('.'):
            found = found[int(key)] if isinstance(found, Sequence) else found[key]
        return found

    def __call__(self, path: str, text: str | None = None) -> str:
        value = self.entry(path)
        if value is None:
            return '-'
        shown = repr(value) if text is None else text
        return f'<data value="{value!r}" data-entry="{path}"{self._of}>{escape(shown)}</data>'

    def fixed(self, path: str, digits: int) -> str:
        return self(path, fixed(self.entry(path), digits))

    def scientific(self, path: str) -> str:
        return self(path, scientific(self.entry(path)))

    def short(self, path: str) -> str:
        value = self.entry(path)
        return self(path, None if value is None else f'{value:.4g}')


def _page(title: str, parts: Iterable[str]) -> str:
    body = '\n'.join(part for part in parts if part)
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<link rel="icon" href="data:,">\n<title>{escape(title)}</title>\n<style>{STYLE}</style>\n</head>\n'
        f'<body>\n{body}\n</body>\n</html>\n'
    )


def _judgement(result: Result) -> str:
    level, warnings = result.level.name, result.warnings
    items = [escape(warning) for warning in warnings]
    for name, entry in result.criteria.items():
        others = [warning for warning in entry.warnings if warning not in warnings]
        items += [f'<em>{escape(name)}</em> alone, {entry.level.name}: {escape(warning)}' for warning in others]
    listed = _list(items)
    if not warnings:
        listed = '<p>No warnings of what is published.</p>' + listed
    if followed := consequences(result):
        listed += f'<details><summary>What follows from that</summary>{_list(map(escape, followed))}</details>'
    return (
        f'<section class="level {escape(level)}"><strong>{escape(level)}: {escape(verdict(result))}</strong>'
        f'{listed}</section>'
    )


def _list(items: Iterable[str]) -> str:
    listed = ''.join(f'<li>{item}</li>' for item in items)
    return f'<ul>{listed}</ul>' if listed else ''


def _parameters(result: Result, show: _Shown, reference: Result | Given | None, reference_name: str) -> str:
    entries = result.parameters
    digits = decimals(entries.values())
    other = None if reference is None else _Shown(reference, 'reference')
    head = ['', 'estimate', '95 % interval', *([reference_name] if other else [])]
    rows = []
    for name, entry in entries.items():
        at = f'parameters.{name}'
        beside = doubt(entry)
        interval = ' to '.join(show.fixed(f'{at}.interval.{k}', digits) for k in (0, 1))
        row = [
            f'{name} [{entry.unit}]<small>{escape(MEANINGS[name])}</small>',
            show.fixed(f'{at}.value', digits) + (f'<small>{beside}</small>' if beside else ''),
            interval,
        ]
        if other is not None and reference is not None:
            there = reference.parameters.get(name)
            row.append('-' if there is None else other.fixed(f'{at}.value', digits))
            if there is not None and there.interval[0] is not None:
                low, high = (other.fixed(f'{at}.interval.{k}', digits) for k in (0, 1))
                row[-1] += f'<small>{low} to {high}</small>'
        rows.append(row)
    absent = (f'<p>Not in the model: {escape(which)}.</p>' for which in result.not_in_model)
    return _table(head, rows) + ''.join(absent)


def _quality(result: Result, show: _Shown) -> str:
    names = list(result.criteria)
    head = ['', *(f'{name}<small>{"published" if name == result.criterion else ""}</small>' for name in names)]
    rows = []
    for k, _ in enumerate(result.prediction.horizons):
        at = [show.fixed(f'criteria.{name}.prediction.error.{k}', 3) for name in names]
        still = show.fixed(f'prediction.standing_still.{k}', 3)
        rows.append([f'error after {show.short(f"prediction.horizons.{k}")} s', *at, still])
    prediction = _table([*head, 'standing still'], rows)
    fits = [
        [text, *(show.fixed(f'prediction.fit.{state}.{k}', 1) for k in range(len(result.prediction.horizons)))]
        for state, text in UNITS.items()
    ]
    ahead = [f'{show.short(f"prediction.horizons.{k}")} s' for k in range(len(fits[0]) - 1)]
    worth = [
        [f'J {which}', *(show.scientific(f'criteria.{name}.J.{which}') for name in names)]
        for which in ('training', 'validation')
    ]
    worth.append(['&nbsp; in', *(escape(result.criteria[name].J.unit) for name in names)])
    worth.append(['condition number', *(show.short(f'criteria.{name}.condition_number') for name in names)])
    worth.append(['level', *(result.criteria[name].level.name for name in names)])
    return '\n'.join(
        [
            f'<p>Errors of simulated states in standard deviations of these states, '
            f'{escape(result.prediction.method)}. Good errors are far below those of a rig that is said to '
            'stand still, and below one.</p>',
            prediction,
            '<p>The published parameters, state by state: fit in per cent, where a hundred is perfect and nought is no '
            'better than the mean.</p>',
            _table(['', *ahead], fits),
            '<p>J is what each criterion minimises. It compares training with validation data, never one criterion '
            'with another. The condition number says how much worse the worst told combination of parameters is than '
            'the best: tens are good, above a thousand small errors of the data become large ones of the parameters.'
            '</p>',
            _table(head, worth),
        ]
    )


def _how(result: Result, show: _Shown) -> str:
    effort, length = result.effort, result.link_length
    delay = f'{show.short("effort.delay")} s'
    if effort.delay_std_error is not None:
        delay += f' (standard error {show.short("effort.delay_std_error")} s)'
    parts = [
        f'<p>The torque was taken as {HOLDS.get(effort.hold, effort.hold)}, and as acting later than it is '
        f'stamped by {delay}. States were smoothed over {show("smoothing")} s.</p>',
        f'<p>The intervals: {escape(result.criteria[result.criterion].uncertainty)}.</p>',
    ]
    if length.value is not None:
        expected = '' if length.expected is None else f'; {show("link_length.expected")} m was expected'
        parts.append(
            "<p>The elbow's own equation has no torque in it and gives the length of link 1 as "
            f'{show.short("link_length.value")} m, standard error {show.short("link_length.std_error")} m{expected}. A '
            'length that is not the one of a ruler means wrong signs, zeros or stamps.</p>'
        )
    if result.zeros:
        rows = [
            [escape(zero.recording), *(_angle(show, f'zeros.{k}.{joint}') for joint in ('q1', 'q2'))]
            for k, zero in enumerate(result.zeros)
        ]
        parts += [
            '<p>So far off are the zeros of each recording, in degrees, what was read less what is true: friction may '
            'hold the links where they do not hang straight when the encoders are set to zero.</p>',
            _table(['recording', 'q1', 'q2'], rows),
        ]
    for name, entry in result.criteria.items():
        said = _list(map(escape, entry.steps))
        parts.append(f'<h3>{escape(name)}: {CRITERIA.get(name, "")}</h3>{said}')
    compared = result.models.compared
    if compared:
        rows = [
            [
                escape(score.model),
                show(f'models.compared.{k}.parameters'),
                ' '.join(show.fixed(f'models.compared.{k}.error.{h}', 4) for h in range(len(score.error))),
            ]
            for k, score in enumerate(compared)
        ]
        ahead = ', '.join(show.short(f'prediction.horizons.{h}') for h in range(len(compared[0].error)))
        parts += [
            '<h3>The choice of the model</h3>',
            _table(['model', 'parameters', f'errors after {ahead} s'], rows),
            f'<p>By {escape(result.models.by or "")}. The smallest model that predicts about as well as any is taken.'
            '</p>',
        ]
    return '\n'.join(parts)


def _angle(show: _Shown, path: str) -> str:
    if show.entry(path) is None:
        return '-'
    return f'{show.fixed(path, 1)}<small>± {show.fixed(f"{path}_std_error", 1)}</small>'


def _provenance(show: _Shown) -> str:
    bags = ''.join(
        f'<h3>{escape(source["role"])}: {escape(source["bag"])}</h3>{_entries(show, f"bags.{k}", skip=("bag", "role"))}'
        for k, source in enumerate(show.entry('bags'))
    )
    settings = ''.join(
        f'<h3>MDE on {escape(name)}</h3>{_entries(show, f"criteria.{name}.mde")}'
        for name, entry in show.entry('criteria').items()
        if entry['mde'] is not None
    )
    return f'{bags}<h3>What was asked for</h3>{_entries(show, "made_by")}{settings}'


def _entries(show: _Shown, path: str, skip: Sequence[str] = ()) -> str:
    rows = (
        f'<dt>{escape(key.replace("_", " "))}</dt><dd>{_entry(show, f"{path}.{key}")}</dd>'
        for key in show.entry(path)
        if key not in skip
    )
    return f'<dl>{"".join(rows)}</dl>'


def _entry(show: _Shown, path: str) -> str:
    value = show.entry(path)
    if isinstance(value, str):
        return escape(value)
    if isinstance(value, Sequence):
        return ', '.join(_entry(show, f'{path}.{k}') for k in range(len(value)))
    return {None: '-', True: 'yes', False: 'no'}[value] if value is None or isinstance(value, bool) else show(path)


def _section(title: str, pictures: Sequence[Picture]) -> str:
    if not pictures:
        return ''
    return f'<h2>{escape(title)}</h2><div class="figures">{"".join(map(_figure, pictures))}</div>'


def _figure(picture: Picture) -> str:
    svg = base64.b64encode(picture.svg.encode()).decode()
    size = re.search(r'width="([\d.]+)pt" height="([\d.]+)pt"|height="([\d.]+)pt".*?width="([\d.]+)pt"', picture.svg)
    width, height = (size[1] or size[4], size[2] or size[3]) if size else ('4', '3')
    # The size says how high the picture will be before it is drawn, so that nothing jumps.
    return (
        f'<figure><h3>{escape(picture.title)}</h3>'
        f'<img alt="{escape(picture.title)}: {escape(picture.shows)}" style="aspect-ratio: {width} / {height}" '
        f'src="data:image/svg+xml;base64,{svg}">'
        f'<figcaption><p>{escape(picture.shows)}</p><p class="good">{escape(picture.good)}</p></figcaption></figure>'
    )


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    top = ''.join(f'<th scope="col">{cell}</th>' for cell in head)
    body = ''.join(
        f'<tr><th scope="row">{first}</th>{"".join(f"<td>{cell}</td>" for cell in rest)}</tr>' for first, *rest in rows
    )
    return f'<table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>'


def _validated(result: Result) -> bool:
    return any(source.role == 'validation' for source in result.bags)
