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

from pendubot_identification import __version__
from pendubot_identification.model.parameters import SPECIFICATIONS
from pendubot_identification.results.result import Result
from pendubot_identification.tracking.events import State

from . import tables
from .plots import Picture
from .table import Table, typeset
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
    return _page(pictures, result=result, tables=tables, meanings=meanings, bags=bags, beside=beside, notes=notes)


def failure_page(reason: str, asked: Sequence[str], pictures: Iterable[Picture] = ()) -> str:
    """Return the page of an identification that failed: why, what was asked for, and the data as far as they go."""
    return _page(pictures, result=None, reason=reason, asked=asked)


def track_page(
    state: State, picture: Picture, table: Table, happened: Sequence[str], bags: Sequence[str], *, result: bool
) -> str:
    """Return the page of a rig that was tracked.

    Args:
        state: the newest.
        picture: of all states, by :func:`.plots.plot_track`.
        table: of the parameters at the end.
        happened: the events in sentences.
        bags: the tracked recordings.
        result: whether a result file stands beside the page.
    """
    shown = {'state': state, 'table': table, 'happened': happened, 'bags': bags, 'result': result}
    return _page([picture], 'track.html.jinja', version=__version__, **shown)


def _page(pictures: Iterable[Picture], template: str = 'page.html.jinja', **context: Any) -> str:
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
