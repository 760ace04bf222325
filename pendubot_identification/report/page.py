# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A result as one HTML page that needs nothing beside it: no network and no other file.

What can be explored is in the page as data and as static figures: without JavaScript, and on paper, these stand there.
``page.js`` shows the data, by uPlot (``uplot/``, MIT licence).

Every number of the result stands in a ``<data>`` element that names its entry in the result file and holds that entry's
own value, so that page and file can be compared. The page itself is ``page.html.jinja``.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from pendubot_identification import __version__
from pendubot_identification.identify.result import Result, plain
from pendubot_identification.model.parameters import SPECIFICATIONS
from pendubot_identification.tracking.events import State

from . import tables
from .figures import Picture
from .table import Table, parts
from .time_plot import typeset


class Bag(NamedTuple):
    """A bag that the page names: its name, its address where it lies here, and the day of its recording or nothing."""

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
    """Return the page of a result.

    Args:
        result: of an identification.
        pictures: its figures.
        beside: what stands beside it.
        notes: what else its reader should know, such as why a figure is missing.
        bags: where its bags lie, and when they were recorded.
    """
    return _page(
        pictures,
        result=result,
        entry=lambda path: plain(tables.entry(result, path)),
        number=partial(tables.number, result),
        tables=tables,
        meanings={s.name: s.meaning for s in SPECIFICATIONS},
        bags=bags,
        beside=beside,
        notes=notes,
    )


def failure_page(reason: str, asked: Sequence[str], pictures: Iterable[Picture] = ()) -> str:
    """Return the page of an identification that failed: why, what was asked for, and the data as far as they go."""
    return _page(pictures, result=None, reason=reason, asked=asked)


def track_page(
    state: State, picture: Picture, table: Table, happened: Sequence[str], bags: Sequence[str], *, result: bool
) -> str:
    """Return the page of a rig that was followed.

    Args:
        state: the newest.
        picture: of all states, by :func:`.figures.draw_track`.
        table: of the parameters at the end.
        happened: in sentences.
        bags: that were followed.
        result: whether a result file stands beside it.
    """
    shown = {'state': state, 'table': table, 'happened': happened, 'bags': bags, 'result': result}
    return _page([picture], 'track.html.jinja', version=__version__, **shown)


def _page(pictures: Iterable[Picture], template: str = 'page.html.jinja', **context: Any) -> str:
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters['parts'] = parts
    environment.filters['typeset'] = typeset
    environment.globals['file'] = lambda name: Markup((Path(__file__).parent / name).read_text(encoding='utf-8'))
    environment.filters['address'] = _address
    shown = {picture.name: picture for picture in pictures}
    plots = {name: picture.plot.data() for name, picture in shown.items() if picture.plot is not None}
    # Within a script element nothing is markup but what would end it.
    data = Markup(json.dumps(plots, ensure_ascii=False, separators=(',', ':')).replace('<', '\\u003c'))
    return environment.get_template(template).render(context, pictures=shown, plots=data)


def _address(svg: str) -> Markup:
    """Return a figure as the address of an image, a quarter shorter than by base64."""
    short = re.sub(r'\s+', ' ', svg).replace('"', "'")
    return Markup('data:image/svg+xml,' + re.sub('[%#<>&]', lambda found: f'%{ord(found[0]):02X}', short))
