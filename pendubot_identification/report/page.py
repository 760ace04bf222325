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

from pendubot_identification.identify.result import Given, Result, plain
from pendubot_identification.model.parameters import SPECIFICATIONS

from . import tables
from .figures import Picture
from .table import parts


def result_page(
    result: Result,
    pictures: Iterable[Picture],
    beside: tuple[Result | Given, str] | None = None,
    notes: Sequence[str] = (),
) -> str:
    """Return the page of a result.

    Args:
        result: of an identification.
        pictures: its figures, as far as they could be drawn.
        beside: another result, or of parameters alone, to stand beside it, and what that is called.
        notes: what else its reader should know, such as why a figure is missing.
    """
    return _page(
        result=result,
        entry=lambda path: plain(tables.entry(result, path)),
        number=partial(tables.number, result),
        tables=tables,
        meanings={f'{s.name} [{s.unit}]': s.meaning for s in SPECIFICATIONS},
        pictures={picture.name: picture for picture in pictures},
        beside=beside,
        notes=notes,
    )


def failure_page(reason: str, asked: Sequence[str], pictures: Iterable[Picture] = ()) -> str:
    """Return the page of an identification that failed.

    Args:
        reason: why, in a sentence: what was found, what was expected, what to do.
        asked: what was asked for, as it was typed.
        pictures: of the data, as far as they could be read.
    """
    return _page(result=None, reason=reason, asked=asked, pictures={picture.name: picture for picture in pictures})


def _page(**context: Any) -> str:
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters['parts'], environment.filters['base64'] = parts, _base64
    return environment.get_template('page.html.jinja').render(context)


def _base64(text: str) -> str:
    return base64.b64encode(text.encode()).decode()
