# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A result as one HTML page that needs nothing beside it: no network, no script, no other file.

Every number of the result stands in a ``<data>`` element that names its entry in the result file and holds that entry's
own value, so that page and file can be compared. The page itself is ``page.html.jinja``.
"""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from pendubot_identification.identify.result import Result, plain
from pendubot_identification.model.parameters import SPECIFICATIONS

from . import tables
from .figures import Picture
from .table import parts


def result_page(
    result: Result, pictures: Iterable[Picture], beside: tables.Beside | None = None, notes: Sequence[str] = ()
) -> str:
    """Return the page of a result; ``notes``: what else its reader should know, such as why a figure is missing."""
    return _page(
        pictures,
        result=result,
        entry=lambda path: plain(tables.entry(result, path)),
        number=partial(tables.number, result),
        tables=tables,
        meanings={f'{s.name} [{s.unit}]': s.meaning for s in SPECIFICATIONS},
        beside=beside,
        notes=notes,
    )


def failure_page(reason: str, asked: Sequence[str], pictures: Iterable[Picture] = ()) -> str:
    """Return the page of an identification that failed: why, what was asked for, and the data as far as they go."""
    return _page(pictures, result=None, reason=reason, asked=asked)


def _page(pictures: Iterable[Picture], **context: Any) -> str:
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters['parts'] = parts
    environment.filters['base64'] = lambda text: base64.b64encode(text.encode()).decode()
    shown = {picture.name: picture for picture in pictures}
    return environment.get_template('page.html.jinja').render(context, pictures=shown)
