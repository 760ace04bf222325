# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What is plotted over time, once: drawn as a static figure, and as the data that a page explores.

A plot is a list of panels above one time axis; a panel is a list of lines. Plots of one page whose ``axis`` has the
same name are zoomed and read together (``page.js``).
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Points that a line may have, two for each of half as many intervals of time: on a page, and in a static figure.
MOST_POINTS, MOST_DRAWN = 1600, 1000
#: Values below and above these are shown in thousandths and the like, which their label then says.
SMALL, LARGE = 0.01, 1e4
INK, PALE = '#1a1a1a', '#999999'
SUPERSCRIPTS = str.maketrans('-0123456789', '⁻⁰¹²³⁴⁵⁶⁷⁸⁹')


@dataclass(frozen=True, slots=True)
class Line:
    """A quantity in pieces: between them the line is broken.

    Attributes:
        label: in the legend; empty: not in it.
        pieces: times [s] and values, each of shape (N,).
        style: ``line``, ``steps`` (held until the next), ``dots``, or ``band``.
        upper: of a ``band``, which lies above the pieces' values: the same times, and the values at its other edge.
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


@dataclass(frozen=True, slots=True)
class Span:
    """A shaded interval of time [s]; ``label`` is in the legend."""

    begin: float
    end: float
    colour: str
    label: str = ''


@dataclass(frozen=True, slots=True)
class TimePlot:
    """Panels over one time axis [s]; ``boundaries``: where each recording begins, in order, also outside of it."""

    panels: Sequence[Panel]
    spans: Sequence[Span] = ()
    boundaries: Sequence[float] = ()
    axis: str = 'time'

    def draw(self, axes: NDArray[Any]) -> None:
        """Draw it, each panel into its axes."""
        styles: dict[str, dict[str, Any]] = {
            'steps': {'drawstyle': 'steps-post'},
            'dots': {'linestyle': '', 'marker': '.', 'markersize': 4},
        }
        for panel, axis in zip(self.panels, axes, strict=True):
            power = _power(panel)
            for line in panel.lines:
                t, y = joined(line.pieces, MOST_DRAWN)
                if line.style == 'band':
                    above = np.interp(t, *joined(line.upper, MOST_DRAWN))
                    axis.fill_between(t, y / 10**power, above / 10**power, color=line.colour, alpha=0.25, linewidth=0)
                    continue
                axis.plot(
                    t,
                    y / 10**power,
                    color=line.colour,
                    linewidth=line.width,
                    label=line.label,
                    **styles.get(line.style, {}),
                )
            if panel.reach:
                axis.set_ylim(*np.divide(panel.reach, 10**power))
            for span in self.spans:
                axis.axvspan(span.begin, span.end, color=span.colour, alpha=0.18, linewidth=0)
            shown = axis.get_xlim()
            for begin in self.boundaries[1:]:
                if shown[0] < begin < shown[1]:
                    axis.axvline(begin, color=PALE, linestyle='--', linewidth=0.8)
            axis.set_ylabel(_label(panel, '\n' if len(panel.quantity) > 12 else ' '))
        for number, begin in enumerate(self.boundaries, 1):
            if shown[0] < begin < shown[1]:
                place = axes[0].get_xaxis_transform()
                axes[0].text(begin, 1.0, f' {number}', transform=place, va='top', fontsize=7, color=PALE)
        axes[-1].set_xlabel('time [s]')

    def data(self) -> dict[str, Any]:
        """Return the same as plain data, thinned to what a screen shows: what ``page.js`` reads."""
        return {
            'axis': self.axis,
            'spans': [[_round(s.begin), _round(s.end), s.colour, s.label] for s in self.spans],
            'boundaries': [_round(begin) for begin in self.boundaries],
            'panels': [_panel_data(panel) for panel in self.panels],
        }


def envelope(t: Array, y: Array, most: int = MOST_POINTS) -> tuple[Array, Array]:
    """Return at most ``most`` points of a line, shapes (N,), that cover what all of it covers.

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
    for t, y in pieces:
        t, y = envelope(t, y, share)
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


def places(recordings: Sequence[Hashable], times: Sequence[Array]) -> dict[Hashable, float]:
    """Return what to add to each recording's times [s] so that different ones stand one after the other.

    ``recordings`` says by part of which recording it is; parts of one recording keep their distance in time.
    """
    found: dict[Hashable, float] = {}
    end = None
    for recording in dict.fromkeys(recordings):
        own = [t for r, t in zip(recordings, times, strict=True) if r == recording]
        found[recording] = 0.0 if end is None else end - min(float(t[0]) for t in own)
        end = found[recording] + max(float(t[-1]) for t in own)
    return found


def scaled(largest: float) -> int:
    """Return the power of ten in which values up to this are shown: 0 where they are legible as they are."""
    return 0 if not 0 < largest < math.inf or SMALL <= largest < LARGE else math.floor(math.log10(largest))


def in_powers(unit: str, power: int) -> str:
    """Return a unit as it is read, ``10⁻³ kg m²``."""
    unit = typeset('' if unit == '1' else unit)
    return f'10{str(power).translate(SUPERSCRIPTS)} {unit}'.rstrip() if power else unit


def typeset(text: str) -> str:
    """Return text in which what is raised to a power is written so: ``kg m²``."""
    return re.sub(r'\^(-?\d)', lambda found: found[1].translate(SUPERSCRIPTS), text)


def _power(panel: Panel) -> int:
    sizes = [np.nanmax(np.abs(y), initial=0.0) for line in panel.lines for _, y in (*line.pieces, *line.upper)]
    return scaled(float(max(np.abs(panel.reach) if panel.reach else sizes, default=0.0)))


def _label(panel: Panel, gap: str = ' ') -> str:
    return f'{panel.quantity}{gap if panel.quantity else ""}[{in_powers(panel.unit, _power(panel))}]'


def _panel_data(panel: Panel) -> dict[str, Any]:
    size = 10.0 ** _power(panel)
    lines = []
    for line in panel.lines:
        t, y = joined(line.pieces)
        found = {'label': line.label, 'colour': line.colour, 'width': line.width, 'style': line.style}
        found |= {'t': [_round(at) for at in t.tolist()], 'y': _numbers(y / size)}
        if line.style == 'band':
            found['upper'] = _numbers(np.interp(t, *joined(line.upper)) / size)
        lines.append(found)
    return {'label': _label(panel), 'reach': panel.reach and [b / size for b in panel.reach], 'lines': lines}


def _numbers(values: Array) -> list[float | None]:
    """Return numbers to five digits, as short as can be; None where there is none."""
    return [float(f'{value:.5g}') if math.isfinite(value) else None for value in values.tolist()]


def _round(time: float) -> float:
    """Return a time [s] to 10 us, which tells pieces apart that follow each other."""
    return round(time, 5)
