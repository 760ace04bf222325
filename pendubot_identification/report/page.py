# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Renders a result as one HTML page that needs no network and no other file.

The page contains all figures, and plots over time also as data, which ``page.js`` shows by uPlot (``uplot/``, MIT
licence). Its template is ``page.html.jinja``.
"""

import json
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup, escape

from pendubot_identification import __version__
from pendubot_identification.errors import PendubotError
from pendubot_identification.files import OutputFolder
from pendubot_identification.results.provenance import command
from pendubot_identification.results.result import Result, result_text
from pendubot_identification.tracking.events import Event, State

from . import plots, tables
from .plots import Picture, Prepared, Recordings
from .tables import Beside, Table, typeset
from .time_plot import TimePlot


def result_page(
    result: Result,
    pictures: Iterable[Picture],
    beside: Beside | None = None,
    notes: Sequence[str] = (),
    text: str = '',
) -> str:
    """Return the page of a result with its pictures, and another result ``beside`` it.

    ``notes`` are the reasons for missing pictures, ``text`` is the content of the result file for download.
    """
    return render(
        'page.html.jinja',
        pictures,
        result=result,
        tables=tables,
        beside=beside,
        notes=notes,
        download=text and Markup('data:text/plain,' + quote(text)),
        command=command(result),
    )


def render(template: str, pictures: Iterable[Picture], **context: Any) -> str:
    """Return the page of a template, with pictures and the template's other variables."""
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
    plots = {name: p.content._asdict() for name, p in shown.items() if isinstance(p.content, TimePlot)}
    figures = {name: _address(picture.files('svg')['svg'].decode()) for name, picture in shown.items()}
    # Within a script element only its end tag is markup.
    script = Markup(json.dumps(plots, ensure_ascii=False, separators=(',', ':')).replace('<', '\\u003c'))
    return environment.get_template(template).render(
        context, pictures=shown, plots=plots, script=script, figures=figures
    )


def _address(svg: str) -> Markup:
    """Return a figure as a data URL, rounded to hundredths of a point; base64 would be longer by a third."""
    rounded = re.sub(r'([ML] -?\d+\.\d\d)\d*( -?\d+\.\d\d)\d*', r'\1\2', svg)
    short = re.sub(r'\s+', ' ', rounded).replace('"', "'")
    return Markup('data:image/svg+xml,' + re.sub('[%#<>&]', lambda found: f'%{ord(found[0]):02X}', short))


def write_report(
    folder: OutputFolder,
    result: Result,
    motions: Recordings | None,
    *,
    beside: Beside | None = None,
    notes: Sequence[str] = (),
    progress: Callable[[str, int, int, float], None] = lambda *_: None,
    bags: Path | None = None,
    static: bool = False,
) -> Path:
    """Draw all pictures of a result, write the report, all or nothing, and return the path of the page.

    Args:
        folder: output folder.
        result: result of an identification.
        motions: the recordings; None if they cannot be read.
        beside: another result for comparison.
        notes: further remarks on the page.
        progress: called with the activity, the numbers of done and of all pictures, and NaN.
        bags: the present folder of the bags; None: as in the result.
        static: whether all pictures are written as SVG and PNG, too.

    Raises:
        ResultError: writing fails.
    """
    prepared = Prepared.of(result, *motions) if motions else None
    wanted = [*prepared.pictures()] if prepared else []
    pictures: list[Picture] = []
    missing = []
    for k, (subject, draw) in enumerate(wanted):
        progress('drawing', k, len(wanted), math.nan)
        try:
            pictures += draw()
        except PendubotError as error:
            missing.append(f'{subject}; {error}')
    text = result_text(result)
    page = result_page(result, pictures, beside, [*notes, *missing], text)
    named = [source.bag for source in result.bags] + ([f'{bags.absolute()}/-'] if bags else [])
    return _write(folder, {'result.yaml': text}, pictures if static else (), page, named)


def write_track(
    folder: OutputFolder,
    track: tuple[Sequence[State], Sequence[Event]],
    table: Table,
    happened: Sequence[str],
    bags: Sequence[str],
    result: str,
    *,
    static: bool = False,
) -> Path:
    """Write the page of a tracked rig, the newest state last, and return its path.

    ``result``: content of the result file; empty if there is none. ``static``: as in :func:`write_report`.

    Raises:
        ResultError: writing fails.
    """
    picture = plots.plot_track(*track)
    about = {'version': __version__, 'state': track[0][-1], 'table': table, 'happened': happened, 'bags': bags}
    page = render('track.html.jinja', [picture], result=bool(result), **about)
    return _write(folder, {'result.yaml': result} if result else {}, [picture] if static else (), page, bags)


def _write(
    folder: OutputFolder, files: Mapping[str, str], static: Sequence[Picture], page: str, named: Sequence[str]
) -> Path:
    """Write the report, its page last, without the absolute folders of the names; a page implies a complete report."""
    for part in _folders(*named):
        for spelling in (part, str(escape(part)), quote(part)):
            page = page.replace(spelling, '')
    drawn = {f'{p.name}.{ending}': content for p in static for ending, content in p.files('svg', 'png').items()}
    folder.write({**files, **drawn, 'report.html': page})
    return (folder.path / 'report.html').absolute()


def _folders(*texts: str) -> list[str]:
    """Return the absolute folders in texts; each text ends with the name of a recording."""
    found = {folder for text in texts for folder in re.findall(r'(?:^|(?<=\s))/\S(?:.*/)?', text)}
    return sorted((folder for folder in found if folder.endswith('/')), key=len, reverse=True)
