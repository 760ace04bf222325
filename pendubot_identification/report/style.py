# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What all figures share: sizes, lines that differ in grey too, and files that come out the same every time.

matplotlib takes half a second to import: nothing but what draws should import this module.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from io import BytesIO
from typing import Any

import matplotlib
from matplotlib.figure import Figure

#: Colour, line and marker of the first, second, ... of several curves: told apart by hue (also by the colour-blind), by
#: lightness, which is what is left in grey, and by the line itself.
STYLES: tuple[dict[str, Any], ...] = (
    {'color': '#000000', 'linestyle': '-', 'marker': 'o'},
    {'color': '#0060ad', 'linestyle': '--', 'marker': 's'},
    {'color': '#d55e00', 'linestyle': '-.', 'marker': '^'},
    {'color': '#009e73', 'linestyle': (0, (1, 1)), 'marker': 'D'},
    {'color': '#e69f00', 'linestyle': (0, (5, 1, 1, 1, 1, 1)), 'marker': 'v'},
)
#: Of what stands behind the curves: limits, targets, halves.
GREY = '#888888'
#: Width of a figure that fills a page [inch], and dots per inch of a PNG.
WIDTH, RESOLUTION = 8.0, 150
#: Height of a legend above all panels [inch].
LEGEND = 0.32

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
    'savefig.dpi': RESOLUTION,
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


def panels(rows: int, columns: int, height: float, **shared: Any) -> tuple[Figure, Any]:
    """Return a figure, ``height`` inches high, and its axes, shape (rows, columns)."""
    figure = Figure(figsize=(WIDTH, height), layout='constrained')
    return figure, figure.subplots(rows, columns, squeeze=False, **shared)


def legend_above(figure: Figure, axes: Any, columns: int) -> None:
    """Put one legend for all panels, of the curves of one, above them."""
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc='upper center', ncols=columns)
    # The legend's place, which matplotlib before 3.7 (Ubuntu 24.04) does not leave free by itself.
    figure.set_layout_engine('constrained', rect=(0, 0, 1, 1 - LEGEND / figure.get_figheight()))


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
