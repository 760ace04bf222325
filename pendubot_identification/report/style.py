# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The style of all static figures, and their reproducible files.

matplotlib takes half a second to import: only modules that draw import this one.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from io import BytesIO
from typing import Any

import matplotlib
from matplotlib.figure import Figure

#: Colour of limits, targets and boundaries behind the curves.
GREY = '#888888'
#: Settings of the figures of a report, which are smaller than a page.
SMALL = {'axes.titlesize': 9, 'legend.fontsize': 8, 'lines.linewidth': 1.0, 'figure.constrained_layout.w_pad': 0.09}
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
def style(changes: Mapping[str, Any] | None = None) -> Iterator[None]:
    """Draw with these settings instead of the user's matplotlibrc; ``changes`` replace some of them."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update({**SETTINGS, **(changes or {})})
        yield


def rendered(figure: Figure, endings: tuple[str, ...] = ('png', 'svg'), **options: Any) -> dict[str, bytes]:
    """Return the figure as PNG and as SVG, without date or version, by the ending of the file's name.

    ``options``: other arguments of matplotlib's ``savefig``.
    """
    metadata: dict[str, dict[str, None]] = {'png': {'Software': None}, 'svg': {'Date': None, 'Creator': None}}
    files = {}
    for ending in endings:
        file = BytesIO()
        figure.savefig(file, format=ending, metadata=metadata[ending], **options)
        figure.set_layout_engine('none')  # the next file reuses this layout
        files[ending] = file.getvalue()
    return files
