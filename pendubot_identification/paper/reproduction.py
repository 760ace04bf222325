# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``index.md`` of a reproduction of the paper: what was run, every table, every figure, and where the rest is."""

from __future__ import annotations

from collections.abc import Sequence

from .paper_tables import Table

HEAD = """\
# The paper, reproduced

N. S. Nguyen and D. K. Nguyen, *Parameter estimation of Pendubot model using modified differential evolution algorithm*,
2018, doi:10.1080/02286203.2018.1525938, held against this package. Made by

    {command}

version {version}. The same command gives the same files, byte for byte; times.md and times.csv alone hold measured
times, and those differ. What in the paper is ambiguous or lost, and what was chosen instead, is in docs/paper.md of the
package."""


def index(
    command: str, version: str, contents: Sequence[Table | tuple[str, str]], raw: Sequence[str], missing: Sequence[str]
) -> str:
    """Return the page.

    Args:
        command: that makes the same again.
        version: of this package.
        contents: tables, and figures as (name, caption), in order.
        raw: names of the files of raw runs.
        missing: parts that were asked for and are not there.
    """
    parts = [HEAD.format(command=command, version=version) + '\n']
    if missing:
        parts.append(f'**Not finished:** {", ".join(missing)} are missing here.\n')
    for entry in contents:
        if isinstance(entry, Table):
            parts.append(entry.markdown())
        else:
            name, caption = entry
            parts.append(f'![{caption}](figures/{name}.png)\n\n{caption} ([SVG](figures/{name}.svg))\n')
    files = ', '.join(f'[{name}]({name})' for name in raw)
    parts.append(f'## Raw runs\n\nSeeds and every run: {files}. Tables as CSV and Markdown: `tables/`.\n')
    return '\n'.join(parts)
