# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Plots over time: described once, as data that the page explores (``page.js``) and that a static figure draws.

A plot is a list of panels above one time axis; a panel is a list of lines. All plots of a page are zoomed and read
together.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from .style import GREY, WIDTH
from .table import SUPERSCRIPTS, typeset

Array = NDArray[np.float64]

#: Largest number of points of a line: the lowest and the highest of half as many intervals of time.
MOST_POINTS = 1600
#: Values from SMALL to LARGE are shown as they are, others in a power of ten that their label states.
SMALL, LARGE = 0.01, 1e4


@dataclass(frozen=True, slots=True)
class Line:
    """A quantity in pieces: between them the line is broken.

    Attributes:
        label: in the legend; empty: not in it.
        pieces: times [s] and values, each of shape (N,).
        style: ``line``, ``steps`` (held until the next), ``dots``, or ``band``.
        upper: of a ``band``, whose lower edge are the pieces: the same times, and the values at its upper edge.
    """

    label: str
    pieces: Sequence[tuple[Array, Array]]
    colour: str
    width: float = 1.0
    style: Literal['line', 'steps', 'dots', 'band'] = 'line'
    upper: Sequence[tuple[Array, Array]] = ()


@dataclass(frozen=True, slots=True)
class Panel:
    """Lines of one unit; ``reach``: values beyond these are not shown, None where all are."""

    quantity: str
    unit: str
    lines: Sequence[Line]
    reach: tuple[float, float] | None = None

    def data(self) -> dict[str, Any]:
        """Return the panel as plain data."""
        sizes = [np.nanmax(np.abs(y), initial=0.0) for line in self.lines for _, y in (*line.pieces, *line.upper)]
        power = scaled(float(max(np.abs(self.reach) if self.reach else sizes, default=0.0)))
        lines = []
        for line in self.lines:
            t, y = joined(line.pieces)
            found = {'label': line.label, 'colour': line.colour, 'width': line.width, 'style': line.style}
            found |= {'t': [round(at, 5) for at in t.tolist()], 'y': _numbers(y / 10.0**power)}
            if line.style == 'band':
                found['upper'] = _numbers(np.interp(t, *joined(line.upper)) / 10.0**power)
            lines.append(found)
        label = f'{self.quantity} [{in_powers(self.unit, power)}]'.strip()
        reach = self.reach and [b / 10.0**power for b in self.reach]
        return {'label': label, 'power': power, 'reach': reach, 'lines': lines}


@dataclass(frozen=True, slots=True)
class Span:
    """A shaded interval of time [s]; ``label`` is in the legend."""

    begin: float
    end: float
    colour: str
    label: str = ''


@dataclass(frozen=True, slots=True)
class TimePlot:
    """Panels over one time axis [s].

    Attributes:
        boundaries: where each recording begins, in order, also outside of the plot.
        live: measured motion from which the page simulates the lines itself; None where it does not.
    """

    panels: Sequence[Panel]
    spans: Sequence[Span] = ()
    boundaries: Sequence[float] = ()
    live: Mapping[str, Any] | None = None

    def data(self) -> dict[str, Any]:
        """Return the plot as plain data, thinned to what a screen shows."""
        return {
            'live': self.live,
            'spans': [[round(s.begin, 5), round(s.end, 5), s.colour, s.label] for s in self.spans],
            'boundaries': [round(begin, 5) for begin in self.boundaries],
            'panels': [panel.data() for panel in self.panels],
        }

    def figure(self) -> Figure:
        """Return the plot as a static figure."""
        figure = Figure(figsize=(WIDTH, 0.4 + 1.1 * len(self.panels)), layout='constrained')
        axes = figure.subplots(len(self.panels), 1, squeeze=False, sharex=True).ravel()
        self.draw(axes)
        kinds = {span.label: span.colour for span in self.spans if span.label}
        patches = [Patch(color=colour, alpha=0.4, label=label) for label, colour in kinds.items()]
        if patches:
            figure.legend(handles=patches, loc='outside upper left', ncols=4)
        return figure

    def draw(self, axes: Sequence[Axes] | NDArray[np.object_]) -> None:
        """Draw the first panels, as many as there are axes."""
        data = self.data()
        labels: list[str] = []
        for panel, axis in zip(data['panels'], axes, strict=False):
            for line in panel['lines']:
                _draw(axis, line)
            for begin, end, colour, _ in data['spans']:
                axis.axvspan(begin, end, color=colour, alpha=0.18, linewidth=0)
            axis.set(ylabel=panel['label'].replace(' [', '\n['), ylim=panel['reach'])
            handles, earlier = axis.get_legend_handles_labels()[0], labels
            labels = [line['label'] for line in panel['lines'] if line['label']]
            if len(handles) > 1 and labels != earlier:
                axis.legend(handles=handles, loc='lower left', bbox_to_anchor=(0, 1), ncols=4, borderaxespad=0.2)
        shown = axes[0].get_xlim()
        for number, begin in enumerate(self.boundaries, 1):
            if shown[0] < begin < shown[1]:
                place = axes[0].get_xaxis_transform()
                axes[0].text(begin, 1.0, f' {number}', transform=place, va='top', fontsize=7, color=GREY)
                for axis in axes if number > 1 else ():
                    axis.axvline(begin, color=GREY, linestyle='--', linewidth=0.8)
        axes[-1].set_xlabel('time [s]')


def _draw(axis: Any, line: dict[str, Any]) -> None:
    t, y = np.array(line['t']), np.array(line['y'], dtype=float)
    if line['style'] == 'band':
        axis.fill_between(t, y, np.array(line['upper'], dtype=float), color=line['colour'], alpha=0.25, linewidth=0)
        return
    how: dict[str, Any] = {'color': line['colour'], 'linewidth': line['width'], 'label': line['label'] or None}
    if line['style'] == 'steps':
        how['drawstyle'] = 'steps-post'
    if line['style'] == 'dots':
        how |= {'linestyle': '', 'marker': '.', 'markersize': 4 * line['width']}
    axis.plot(t, y, **how)


def envelope(t: Array, y: Array, most: int = MOST_POINTS) -> tuple[Array, Array]:
    """Return at most ``most`` points of a line, shapes (N,), that cover the same area of the plot.

    Of each interval of time the lowest and the highest point are kept, in their order.
    """
    if len(t) <= most:
        return t, y
    edges = np.linspace(0, len(t), most // 2 + 1).astype(int)
    kept = []
    for low, high in itertools.pairwise(edges):
        part = np.nan_to_num(y[low:high])
        kept += sorted((low + int(part.argmin()), low + int(part.argmax())))
    return t[kept], y[kept]


def joined(pieces: Sequence[tuple[Array, Array]], most: int = MOST_POINTS) -> tuple[Array, Array]:
    """Return pieces as one line of at most about ``most`` points, strictly ascending in time, with NaN between them."""
    times, values = [], []
    end = -math.inf
    share = max(most // max(len(pieces), 1), 4)
    for piece in pieces:
        t, y = envelope(*piece, share)
        if len(t) == 0:
            continue
        if end > -math.inf:
            # A piece may begin where the last one ends: it begins 20 us later, which nobody sees.
            times.append(np.array([end + 1e-5]))
            values.append(np.array([np.nan]))
        times.append(np.maximum(t, end + 2e-5))
        values.append(y)
        end = float(times[-1][-1])
    return (np.concatenate(times), np.concatenate(values)) if times else (np.empty(0), np.empty(0))


def scaled(largest: float) -> int:
    """Return the power of ten in which values up to this are shown: 0 where they are legible as they are."""
    return 0 if not 0 < largest < math.inf or SMALL <= largest < LARGE else math.floor(math.log10(largest))


def in_powers(unit: str, power: int) -> str:
    """Return a unit as it is read, ``10⁻³ kg m²``."""
    unit = typeset('' if unit == '1' else unit)
    return f'10{str(power).translate(SUPERSCRIPTS)} {unit}'.rstrip() if power else unit


def _numbers(values: Array) -> list[float | None]:
    """Return numbers to five digits, as short as can be; None where there is none."""
    return [float(f'{value:.5g}') if math.isfinite(value) else None for value in values.tolist()]
