# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Plots over time, described once as data for the page (``page.js``) and for static figures.

A plot is a list of panels above one time axis; a panel is a list of lines. All plots of a page share zoom and cursor.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, Literal, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from pendubot_identification.arrays import Array

from .tables import typeset

#: Largest number of times in a panel, which shows the lowest and the highest value of each line per interval.
MOST_POINTS = 2400


class Line(NamedTuple):
    """A quantity in pieces; the line is broken between them."""

    label: str  #: legend entry, or empty.
    values: Sequence[Array]  #: at the times of each piece, shapes (N,).
    colour: str
    width: float = 1.0
    style: Literal['line', 'steps', 'dots', 'band'] = 'line'
    upper: Sequence[Array] = ()  #: upper edge of a ``band``, shapes (N,).


def panel(
    quantity: str,
    unit: str,
    times: Sequence[Array],
    lines: Sequence[Line],
    reach: tuple[float, float] | None = None,
) -> dict[str, Any]:
    """Return a panel as plain data, thinned for a screen: times, and the values of all lines.

    ``times`` are those of each piece [s], shapes (N,), ``reach`` is the range of the shown values; None: all values.
    """
    edges = [edge for line in lines for edge in (line.values, line.upper) if edge]
    t, values = joined(times, [np.column_stack(piece) for piece in zip(*edges, strict=True)])
    columns = iter([_numbers(column) for column in values.T])
    entries = []
    for line in lines:
        entry = {'label': line.label, 'colour': line.colour, 'width': line.width, 'style': line.style}
        entries.append(entry | {'y': next(columns)} | ({'upper': next(columns)} if line.upper else {}))
    label = f'{quantity} [{typeset(unit)}]'.replace('[1]', '').strip()
    return {'label': label, 'reach': reach, 't': [round(time, 5) for time in t.tolist()], 'lines': entries}


class Span(NamedTuple):
    """A shaded interval of time [s], or a line if its length is 0; ``label`` is the legend entry."""

    begin: float
    end: float
    colour: str
    label: str = ''


class TimePlot(NamedTuple):
    """Panels over one time axis [s]."""

    panels: Sequence[Mapping[str, Any]]  #: see :func:`panel`.
    spans: Sequence[Span] = ()

    def figure(self) -> Figure:
        """Return the plot as a static figure, as wide as a page of paper."""
        figure = Figure(figsize=(7.2, max(1.8, 0.8 + 0.62 * len(self.panels))), layout='constrained')
        self.draw(figure.subplots(len(self.panels), 1, squeeze=False, sharex=True).ravel())
        kinds = {span.label: Patch(color=span.colour, label=span.label) for span in self.spans if span.label}
        if kinds:
            figure.legend(handles=[*kinds.values()], loc='outside upper left', ncols=4)
        return figure

    def draw(self, axes: Sequence[Axes] | NDArray[np.object_]) -> None:
        """Draw the first panels, as many as there are axes."""
        labels: list[str] = []
        for panel, axis in zip(self.panels, axes, strict=False):
            for line in panel['lines']:
                _draw(axis, np.array(panel['t']), line)
            first, last = min(panel['t'], default=0.0), max(panel['t'], default=0.0)
            for begin, end, colour, _ in (span for span in self.spans if first <= span[1] and span[0] <= last):
                axis.axvspan(begin, end, color=colour, linewidth=0 if end > begin else 0.8)
            axis.set(ylabel=panel['label'].replace(' [', '\n['), ylim=panel['reach'])
            handles, earlier = axis.get_legend_handles_labels()[0], labels
            labels = [line['label'] for line in panel['lines'] if line['label']]
            if len(handles) > 1 and labels != earlier:
                axis.legend(handles=handles, loc='lower left', bbox_to_anchor=(0, 1), ncols=4, borderaxespad=0.2)
        axes[-1].set_xlabel('time [s]')


def _draw(axis: Any, t: Array, line: Mapping[str, Any]) -> None:
    y, how = np.array(line['y'], dtype=float), {'color': line['colour'], 'linewidth': line['width']}
    if line['style'] == 'band':
        axis.fill_between(t, y, np.array(line['upper'], dtype=float), color=line['colour'], alpha=0.25, linewidth=0)
        return
    dots = {'linestyle': '', 'marker': '.', 'markersize': 4 * line['width']}
    how |= {'steps': {'drawstyle': 'steps-post'}, 'dots': dots}.get(line['style'], {})
    axis.plot(t, y, label=line['label'] or None, **how)


def thinned(values: Array, most: int = MOST_POINTS) -> NDArray[np.intp]:
    """Return the indices of at most ``most`` of N samples of L lines, shape (N, L), that cover the same plot area.

    They are the lowest and the highest sample of each line in each interval of time.
    """
    if len(values) <= most:
        return np.arange(len(values))
    edges = np.linspace(0, len(values), most // (2 * values.shape[1]) + 1).astype(int)
    parts = [(low, np.nan_to_num(values[low:high])) for low, high in pairwise(edges)]
    return np.unique([low + k for low, part in parts for k in (*part.argmin(axis=0), *part.argmax(axis=0))])


def joined(times: Sequence[Array], values: Sequence[Array], most: int = MOST_POINTS) -> tuple[Array, Array]:
    """Return thinned pieces of L lines, shapes (N,) and (N, L), as one piece in ascending time, separated by NaN."""
    pieces = [(np.empty(0), np.empty((0, 1)))]
    end, share = -math.inf, most // max(len(times), 1)
    # The rest of a recording, which validates, may begin before the end of other pieces.
    for t, piece in sorted(zip(times, values, strict=True), key=lambda piece: piece[0][:1].tolist()):
        kept = thinned(piece, max(share, 2 * piece.shape[1]))
        if len(kept) == 0:
            continue
        if end > -math.inf:
            pieces.append((np.array([end + 1e-5]), np.full((1, piece.shape[1]), np.nan)))
        # A piece that begins at the end of the last one is moved by 20 us, which is invisible.
        pieces.append((np.maximum(t[kept], end + 2e-5), piece[kept]))
        end = float(pieces[-1][0][-1])
    t, piece = (np.concatenate(part) for part in zip(*(pieces[1:] or pieces), strict=True))
    return t, piece


def _numbers(values: Array) -> list[float | None]:
    """Return numbers rounded to five digits; None for numbers that are not finite."""
    return [float(f'{value:.5g}') if math.isfinite(value) else None for value in values.tolist()]
