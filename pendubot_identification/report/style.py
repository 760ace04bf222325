# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What all figures share: one style, and files that come out the same every time.

matplotlib takes half a second to import: nothing but what draws should import this module.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from io import BytesIO
from typing import Any

import matplotlib
from matplotlib.figure import Figure

#: Of what stands behind the curves: limits, targets, halves.
GREY = '#888888'
SETTINGS = {
    'font.family': 'DejaVu Sans',
    'font.size': 9,
    'axes.titlesize': 10,
    'axes.grid': True,
    'axes.axisbelow': True,
    'axes.spines.top': False,
    'axes.spines.right': False,
    'grid.color': '#dddddd',
    'grid.linewidth': 0.6,
    'lines.linewidth': 1.4,
    'lines.markersize': 4,
    'legend.frameon': False,
    'savefig.dpi': 150,
    'svg.hashsalt': 'pendubot',
    'svg.fonttype': 'path',
}


@contextmanager
def style(own: Mapping[str, Any] | None = None) -> Iterator[None]:
    """Draw within this: the same whatever the user's own matplotlibrc says; ``own`` replaces settings."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update({**SETTINGS, **(own or {})})
        yield


def rendered(figure: Figure, **how: Any) -> dict[str, bytes]:
    """Return the figure as PNG and as SVG, without date or version, by the ending of the file's name.

    ``how``: what else matplotlib's ``savefig`` takes.
    """
    files = {}
    for ending, metadata in (('png', {'Software': None}), ('svg', {'Date': None, 'Creator': None})):
        file = BytesIO()
        figure.savefig(file, format=ending, metadata=metadata, **how)
        figure.set_layout_engine('none')  # the second one has the first one's layout, without computing it again
        files[ending] = file.getvalue()
    return files
