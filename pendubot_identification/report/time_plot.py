# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Plots over time: described once, as data that the page explores (``page.js``) and that a static figure draws.

A plot is a list of panels above one time axis; a panel is a list of lines. All plots of a page are zoomed and read
together.
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

from .table import typeset

#: Largest number of times that a panel shows: of each interval the lowest and the highest value of each line.
MOST_POINTS = 2400


class Line(NamedTuple):
    """A quantity in pieces: between them the line is broken."""

    label: str  #: in the legend; empty: not in it.
    values: Sequence[Array]  #: at the times of each piece, shapes (N,).
    colour: str
    width: float = 1.0
    style: Literal['line', 'steps', 'dots', 'band'] = 'line'
    upper: Sequence[Array] = ()  #: edge of a ``band`` above that of ``values``.


class Panel(NamedTuple):
    """Lines of one unit."""

    quantity: str
    unit: str
    times: Sequence[Array]  #: of each piece [s], shapes (N,).
    lines: Sequence[Line]
    reach: tuple[float, float] | None = None  #: values beyond these are not shown; None: all are.

    def data(self) -> dict[str, Any]:
        """Return the panel as plain data, thinned to what a screen shows: times, and the values of all lines there."""
        edges = [edge for line in self.lines for edge in (line.values, line.upper) if edge]
        t, values = joined(self.times, [np.column_stack(piece) for piece in zip(*edges, strict=True)])
        columns = iter([_numbers(column) for column in values.T])
        lines = []
        for line in self.lines:
            found = {'label': line.label, 'colour': line.colour, 'width': line.width, 'style': line.style}
            lines.append(found | {'y': next(columns)} | ({'upper': next(columns)} if line.upper else {}))
        label = f'{self.quantity} [{typeset(self.unit)}]'.replace('[1]', '').strip()
        times = [round(at, 5) for at in t.tolist()]
        return {'label': label, 'reach': self.reach, 't': times, 'lines': lines}


class Span(NamedTuple):
    """An interval of time [s], shaded, or a line where its length is 0; ``label`` is in the legend."""

    begin: float
    end: float
    colour: str
    label: str = ''


class TimePlot(NamedTuple):
    """Panels over one time axis [s]."""

    panels: Sequence[Panel]
    spans: Sequence[Span] = ()
    live: Mapping[str, Any] | None = None  #: measured motion from which the page simulates the lines itself.

    def data(self) -> dict[str, Any]:
        """Return the plot as plain data, thinned to what a screen shows."""
        return {
            'live': self.live,
            'spans': [[round(begin, 5), round(end, 5), *rest] for begin, end, *rest in self.spans],
            'panels': [panel.data() for panel in self.panels],
        }

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
        data = self.data()
        labels: list[str] = []
        for panel, axis in zip(data['panels'], axes, strict=False):
            for line in panel['lines']:
                _draw(axis, np.array(panel['t']), line)
            first, last = min(panel['t'], default=0.0), max(panel['t'], default=0.0)
            for begin, end, colour, _ in (span for span in data['spans'] if first <= span[1] and span[0] <= last):
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
    """Return which at most ``most`` of N samples of L lines, shape (N, L), cover the same area of a plot.

    Of each interval of time they are the lowest and the highest sample of each line.
    """
    if len(values) <= most:
        return np.arange(len(values))
    edges = np.linspace(0, len(values), most // (2 * values.shape[1]) + 1).astype(int)
    parts = [(low, np.nan_to_num(values[low:high])) for low, high in pairwise(edges)]
    return np.unique([low + k for low, part in parts for k in (*part.argmin(axis=0), *part.argmax(axis=0))])


def joined(times: Sequence[Array], values: Sequence[Array], most: int = MOST_POINTS) -> tuple[Array, Array]:
    """Return pieces of L lines, shapes (N,) and (N, L), thinned, as one that ascends in time, with NaN between them."""
    found = [(np.empty(0), np.empty((0, 1)))]
    end, share = -math.inf, most // max(len(times), 1)
    for t, piece in zip(times, values, strict=True):
        kept = thinned(piece, max(share, 2 * piece.shape[1]))
        if len(kept) == 0:
            continue
        if end > -math.inf:
            found.append((np.array([end + 1e-5]), np.full((1, piece.shape[1]), np.nan)))
        # A piece may begin where the last one ends: it begins 20 us later, which nobody sees.
        found.append((np.maximum(t[kept], end + 2e-5), piece[kept]))
        end = float(found[-1][0][-1])
    t, piece = (np.concatenate(each) for each in zip(*(found[1:] or found), strict=True))
    return t, piece


def _numbers(values: Array) -> list[float | None]:
    """Return numbers to five digits, as short as can be; None where there is none."""
    return [float(f'{value:.5g}') if math.isfinite(value) else None for value in values.tolist()]
