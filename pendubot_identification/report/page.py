# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A result as one HTML page that needs nothing beside it: no network and no other file.

Plots over time are in the page as data, which ``page.js`` shows by uPlot (``uplot/``, MIT licence); all other figures
are static. The page itself is ``page.html.jinja``.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from pendubot_identification.model.parameters import SPECIFICATIONS
from pendubot_identification.results.result import Result

from . import tables
from .plots import Picture
from .table import typeset
from .time_plot import TimePlot


class Bag(NamedTuple):
    """The name of a bag, its address, and the day of its recording or nothing."""

    name: str
    address: str
    day: str


def result_page(
    result: Result,
    pictures: Iterable[Picture],
    beside: tables.Beside | None = None,
    notes: Sequence[str] = (),
    bags: Sequence[Bag] = (),
) -> str:
    """Return the page of a result, with another result ``beside`` it; ``notes`` say why a picture is missing."""
    meanings = {s.name: s.meaning for s in SPECIFICATIONS}
    shown = {'result': result, 'tables': tables, 'meanings': meanings, 'bags': bags, 'beside': beside, 'notes': notes}
    return render('page.html.jinja', pictures, **shown)


def failure_page(reason: str, asked: Sequence[str], pictures: Iterable[Picture] = ()) -> str:
    """Return the page of an identification that failed: why, what was asked for, and the data as far as they go."""
    return render('page.html.jinja', pictures, result=None, reason=reason, asked=asked)


def render(template: str, pictures: Iterable[Picture], **context: Any) -> str:
    """Return a page by its template, with pictures and whatever else the template shows."""
    folder = Path(__file__).parent
    environment = Environment(
        loader=FileSystemLoader(folder),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters['typeset'] = typeset
    environment.globals['file'] = lambda name: Markup((folder / name).read_text(encoding='utf-8'))
    shown = {picture.name: picture for picture in pictures}
    plots = {name: each.content.data() for name, each in shown.items() if isinstance(each.content, TimePlot)}
    # Within a script element nothing is markup but what would end it.
    data = Markup(json.dumps(plots, ensure_ascii=False, separators=(',', ':')).replace('<', '\\u003c'))
    figures = {name: _address(each.files('svg')['svg'].decode()) for name, each in shown.items() if name not in plots}
    return environment.get_template(template).render(context, pictures=shown, plots=plots, data=data, figures=figures)


def _address(svg: str) -> Markup:
    """Return a figure as the address of an image, with hundredths of a point, a quarter shorter than by base64."""
    rounded = re.sub(r'([ML] -?\d+\.\d\d)\d*( -?\d+\.\d\d)\d*', r'\1\2', svg)
    short = re.sub(r'\s+', ' ', rounded).replace('"', "'")
    return Markup('data:image/svg+xml,' + re.sub('[%#<>&]', lambda found: f'%{ord(found[0]):02X}', short))
