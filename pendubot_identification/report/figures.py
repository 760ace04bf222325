# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The figures of a report: arrays in, SVG and PNG out. The same arrays give the same SVG, byte for byte."""

from __future__ import annotations

import itertools
import re
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from pendubot_identification.identify.evidence import Excitation, Residuals, Simulation, TorqueLeft
from pendubot_identification.identify.result import Convergence, CriterionValue, Result
from pendubot_identification.trajectories.trajectory import Trajectory

from .style import rendered, style
from .tables import Beside

Array = NDArray[np.float64]

#: Of every figure [inch]: wide enough for a column on a screen, and legible when a telephone shows it.
WIDTH = 5.2
#: Points that a line may have, two for each of half as many intervals of time.
MOST_POINTS = 2000
#: Means of unexplained torque are drawn in so many bins, without what is so many times its median.
BINS, OUTLYING = 24, 8.0
MEASURED, SIMULATED, ESTIMATION, VALIDATION = '#1a1a1a', '#d55e00', '#56b4e9', '#e69f00'
#: Colours that can be told apart by everyone (Okabe and Ito).
COLOURS = ('#0072b2', '#d55e00', '#009e73', '#cc79a7')
STATE_LABELS = ('q1 [rad]', 'q2 [rad]', "q1' [rad/s]", "q2' [rad/s]")
#: How all figures here are drawn, which are smaller than a page.
drawn = style(
    {'axes.titlesize': 9, 'legend.fontsize': 8, 'lines.linewidth': 1.0, 'figure.constrained_layout.w_pad': 0.09}
)


@dataclass(frozen=True, slots=True)
class Picture:
    """A figure: the name of its files, their contents, and what its caption in ``page.html.jinja`` needs to know."""

    name: str
    svg: str
    png: bytes
    about: Mapping[str, Any]

    @property
    def size(self) -> tuple[str, ...]:
        """Width and height, in units of the SVG."""
        found = re.search(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', self.svg)
        return found.groups() if found else ('4', '3')


@drawn
def draw_recordings(training: Sequence[Trajectory], validation: Sequence[Trajectory]) -> Picture:
    """Draw the torque and both angles, and which part estimates and which validates."""
    motions = [*training, *validation]
    recordings = [motion.name.rpartition('@')[0] or motion.name for motion in motions]
    driven = any(motion.tau[:, 1].any() for motion in motions)
    figure, axes = _panels(4.2, 3, sharex=True)
    colours = [ESTIMATION] * len(training) + [VALIDATION] * len(validation)
    for motion, place, colour in zip(motions, _places(recordings, [m.t for m in motions]), colours, strict=True):
        t = motion.t + place
        for axis in axes:
            axis.axvspan(t[0], t[-1], color=colour, alpha=0.18, linewidth=0)
        axes[0].plot(*envelope(t, motion.tau[:, 0]), color=MEASURED, linewidth=0.8)
        if driven:
            axes[0].plot(*envelope(t, motion.tau[:, 1]), color=COLOURS[0], linewidth=0.8)
        for axis, angle in zip(axes[1:], motion.q.T, strict=True):
            axis.plot(*envelope(t, angle), color=MEASURED)
    _label(axes, ('tau1, tau2 [N m]' if driven else 'tau1 [N m]', *STATE_LABELS[:2]))
    kinds = {'estimates': ESTIMATION, 'validates': VALIDATION} if validation else {'estimates': ESTIMATION}
    _legend(axes[0], [Patch(color=colour, alpha=0.4, label=kind) for kind, colour in kinds.items()])
    return _picture(figure, 'recordings', driven=driven, several=len(set(recordings)) > 1)


@drawn
def draw_simulation(simulation: Simulation, *, validation: bool) -> Picture:
    """Draw what was measured and what was simulated from measured states on."""
    t, pieces = simulation.simulated_t, simulation.simulated
    figure, axes = _panels(5.6, 4, sharex=True)
    for k, axis in enumerate(axes):
        measured = simulation.measured[k]
        axis.plot(*envelope(simulation.t, measured), color=MEASURED, linewidth=1.6, label='measured')
        middle, reach = (measured.max() + measured.min()) / 2, 0.75 * np.ptp(measured) + 1e-3
        # What has left the figure by far would only make its lines long.
        near = np.where(np.abs(pieces[:, k] - middle) < 20 * reach, pieces[:, k], np.nan)
        for piece, at in zip(near.T, t.T, strict=True):
            axis.plot(*envelope(at, piece), color=SIMULATED, label='simulated')
        axis.plot(t[0], pieces[0, k], '.', color=SIMULATED, markersize=4)
        axis.set_ylim(middle - reach, middle + reach)
    _label(axes, STATE_LABELS)
    _legend(axes[0], axes[0].lines[:2])
    part = '' if simulation.whole else simulation.name
    return _picture(figure, 'simulation', validation=validation, ahead=simulation.ahead, part=part)


@drawn
def draw_residuals(residuals: Residuals) -> Picture:
    """Draw a criterion's residuals over time, their autocorrelation, and their histogram."""
    places = _places(range(len(residuals.parts)), [t for t, _ in residuals.parts])
    everything = np.concatenate([values for _, values in residuals.parts])
    sizes = np.sqrt((everything**2).mean(axis=0))
    bins = np.linspace(-4, 4, 41)
    figure = Figure(figsize=(WIDTH, 4.4), layout='constrained')
    top, bottom = figure.subfigures(2, 1)
    over_time, (correlation, histogram) = top.subplots(), bottom.subplots(1, 2)
    for k, (name, colour) in enumerate(zip(residuals.names, COLOURS, strict=False)):
        for place, (t, values) in zip(places, residuals.parts, strict=True):
            over_time.plot(*envelope(t + place, values[:, k]), color=colour, linewidth=0.7, label=name)
        correlation.plot(*envelope(residuals.lags[1:], residuals.autocorrelation[1:, k]), color=colour)
        counts, _ = np.histogram(everything[:, k] / (sizes[k] or 1.0), bins, density=True)
        histogram.stairs(counts, bins, color=colour)
    histogram.plot(bins, np.exp(-(bins**2) / 2) / np.sqrt(2 * np.pi), color=MEASURED, linestyle=':', label='normal')
    correlation.axhspan(-residuals.band, residuals.band, color='#bbbbbb', alpha=0.6, linewidth=0)
    correlation.axvspan(0, min(residuals.shared, residuals.lags[-1]), color='#eeeeee', zorder=0, linewidth=0)
    correlation.set(xlim=(0, residuals.lags[-1]), ylim=(-1.05, 1.05), xlabel='lag [s]', title='autocorrelation')
    histogram.set(xlabel='in its root mean square', title='histogram', yticks=[])
    over_time.set(xlabel='time [s]', ylabel=f'[{residuals.unit}]')
    _legend(over_time, over_time.lines[:: len(places)])
    return _picture(figure, f'residuals_{residuals.criterion}', cumulative=np.isinf(residuals.shared))


@drawn
def draw_torque_left(left: TorqueLeft) -> Picture:
    """Draw the unexplained torque of both joints over time, with its bursts, and its means against what the rig did."""
    found = left.found
    places = _places(range(len(found.times)), found.times)
    everything, rest = np.concatenate(found.torque), np.concatenate(found.rest)
    figure = Figure(figsize=(WIDTH, 4.4), layout='constrained')
    top, bottom = figure.subfigures(2, 1)
    over_time, against = top.subplots(2, 1, sharex=True), bottom.subplots(2, len(left.seen), sharey='row')
    quiet = np.abs(everything) < OUTLYING * np.median(np.abs(everything), axis=0) + np.finfo(float).tiny
    for joint, (axis, colour) in enumerate(zip(over_time, COLOURS, strict=False)):
        for place, t, torque in zip(places, found.times, found.torque, strict=True):
            axis.plot(*envelope(t + place, torque[:, joint]), color=colour, linewidth=0.7)
        for burst in found.bursts:
            number = left.names.index(burst.recording)
            begin = places[number] + found.times[number][0]
            axis.axvspan(begin + burst.begin, begin + burst.end, color=SIMULATED, alpha=0.25, linewidth=0)
        axis.set_ylabel(f'{("shoulder", "elbow")[joint]}\n[N m]')
        for column, (name, values) in enumerate(left.seen.items()):
            shown, kept = against[joint, column], quiet[:, joint]
            edges = np.unique(np.quantile(values[kept, joint], np.linspace(0, 1, BINS + 1)))
            if len(edges) < 3:
                continue
            number = np.clip(np.searchsorted(edges, values[kept, joint], side='right') - 1, 0, len(edges) - 2)
            count = np.maximum(np.bincount(number, minlength=len(edges) - 1), 1)
            for torque, line in ((everything, '-'), (rest, ':')):
                means = np.bincount(number, torque[kept, joint], minlength=len(edges) - 1) / count
                shown.plot((edges[1:] + edges[:-1]) / 2, means, color=colour, linestyle=line)
            shown.axhline(0, color='#bbbbbb', linewidth=0.6, zorder=0)
            against[1, column].set_xlabel(name)
    over_time[1].set_xlabel('time [s]')
    return _picture(figure, 'torque_left', bursts=len(found.bursts), effects=[f.effect.name for f in found.effects])


@drawn
def draw_convergence(criterion: str, J: CriterionValue, convergence: Convergence) -> Picture:
    """Draw the best value of each run of MDE after each generation."""
    generations = np.array(convergence.generations) + 1.0
    best = np.array(convergence.best, dtype=float)
    least = J.least_squares
    figure, (axis,) = _panels(3.0, 1)
    values = best if least is None else np.maximum(best / least - 1, 1e-14)
    axis.loglog(generations, values.T, color=COLOURS[0], linewidth=0.8, alpha=0.8)
    axis.set(xlabel='generation', ylabel='best value' if least is None else 'best J / exact minimum - 1')
    if least is not None:
        axis.axhline(1e-6, color=SIMULATED, linestyle='--', label='counts as found')
        _legend(axis, axis.lines[-1:])
    return _picture(figure, f'convergence_{criterion}', exact=least is not None)


@drawn
def draw_parameters(result: Result, beside: Beside | None = None) -> Picture:
    """Draw every parameter with its 95 % interval: the published one, each criterion's, and what stands beside them."""
    published = result.criterion
    rows = [(f'{published}, published', result.parameters, COLOURS[1])]
    rows += [(n, e.parameters, COLOURS[0]) for n, e in result.criteria.items() if n != published]
    rows += [(beside[1], beside[0].parameters, MEASURED)] if beside else []
    names = list(result.parameters)
    lines = -(-len(names) // 2)
    figure, axes = _panels(0.55 + lines * (0.62 + 0.17 * len(rows)), lines, 2, sharey=True)
    for axis, name in zip(axes, names, strict=False):
        for k, (_, parameters, colour) in enumerate(rows):
            entry = parameters.get(name)
            if entry is None:
                continue
            low, high = entry.interval
            if low is not None and high is not None:
                axis.plot([low, high], [k, k], color=colour, linewidth=2.5, alpha=0.5, solid_capstyle='butt')
            axis.plot(entry.value, k, 'o', color=colour, markersize=4)
        axis.set_title(f'{name} [{result.parameters[name].unit}]')
        axis.set_yticks(range(len(rows)), [label for label, _, _ in rows])
        axis.set_ylim(len(rows) - 0.5, -0.5)
        axis.xaxis.set_major_locator(MaxNLocator(3))
        axis.ticklabel_format(axis='x', style='sci', scilimits=(-2, 3), useOffset=False)
    for axis in axes[len(names) :]:
        axis.set_visible(False)
    return _picture(figure, 'parameters')


@drawn
def draw_correlation(result: Result) -> Picture | None:
    """Draw the correlation matrix of the published estimate; None where it has none."""
    names = list(result.parameters)
    matrix = np.array(result.criteria[result.criterion].correlation, dtype=float)
    if not np.isfinite(matrix).any():
        return None
    few = len(names) < 11
    figure, (axis,) = _panels(4.6, 1)
    axis.imshow(matrix, cmap='RdBu_r', vmin=-1, vmax=1)
    for row, column in np.argwhere(np.isfinite(matrix)):
        value = matrix[row, column]
        shown = f'{value:.2f}'.replace('0.', '.').replace('1.00', '1').replace('-.00', '.00')
        colour = 'white' if abs(value) > 0.6 else 'black'
        axis.text(column, row, shown, ha='center', va='center', fontsize=8 if few else 6, color=colour)
    axis.set_xticks(range(len(names)), names)
    axis.set_yticks(range(len(names)), names)
    axis.tick_params(length=0, labelsize=8 if few else 7)
    axis.grid(False)
    return _picture(figure, 'correlation')


@drawn
def draw_excitation(names: Sequence[str], excitation: Excitation) -> Picture:
    """Draw what each parameter does in the equation of each joint, and what no other could do in its place."""
    figure, axes = _panels(1.4 + 0.26 * len(names), 1, 2, sharey=True)
    at = np.arange(len(names))
    for k, (axis, joint) in enumerate(zip(axes, ('shoulder', 'elbow'), strict=True)):
        term, own, residual = excitation.term[:, k], excitation.own[:, k], excitation.residual[k]
        largest = max(term.max(), residual) or 1.0
        least = 10.0 ** np.floor(np.log10(max(min(residual, largest * 1e-3), largest * 1e-7, 1e-300)) - 0.5)
        axis.barh(at, np.maximum(term - least, 0), left=least, color=COLOURS[0], alpha=0.35, label='all it does')
        axis.barh(at, np.maximum(own - least, 0), left=least, height=0.45, color=COLOURS[0], label='it alone')
        axis.axvline(max(residual, least), color=SIMULATED, linestyle='--', label='unexplained')
        axis.set(xscale='log', xlim=(least, 2 * largest), title=f"{joint}'s equation", xlabel='root mean square [N m]')
        axis.set_yticks(at, names)
        axis.grid(False, axis='y')
    axes[0].invert_yaxis()
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc='lower center', ncols=3, bbox_to_anchor=(0.5, 1.0))
    return _picture(figure, 'excitation')


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


def _panels(height: float, rows: int, columns: int = 1, **shared: Any) -> tuple[Figure, NDArray[Any]]:
    """Return a figure, ``height`` inches high, and its axes, row by row."""
    figure = Figure(figsize=(WIDTH, height), layout='constrained')
    return figure, figure.subplots(rows, columns, squeeze=False, **shared).ravel()


def _picture(figure: Figure, name: str, **about: Any) -> Picture:
    files = rendered(figure, bbox_inches='tight')
    return Picture(name, files['svg'].decode(), files['png'], about)


def _label(axes: NDArray[Any], labels: Sequence[str]) -> None:
    for axis, label in zip(axes, labels, strict=True):
        axis.set_ylabel(label)
    axes[-1].set_xlabel('time [s]')


def _legend(axis: Axes, handles: Sequence[Any]) -> None:
    """Put a legend above an axis, where it covers nothing."""
    axis.legend(handles=handles, loc='lower left', bbox_to_anchor=(0, 1.0), ncols=4, borderaxespad=0.2)


def _places(recordings: Sequence[Hashable], times: Sequence[Array]) -> list[float]:
    """Return what to add to each part's times [s] so that different recordings stand one after the other.

    ``recordings`` says by part of which recording it is; parts of one recording keep their distance in time.
    """
    places: dict[Hashable, float] = {}
    end = None
    for recording in dict.fromkeys(recordings):
        own = [t for r, t in zip(recordings, times, strict=True) if r == recording]
        places[recording] = 0.0 if end is None else end - min(float(t[0]) for t in own)
        end = places[recording] + max(float(t[-1]) for t in own)
    return [places[recording] for recording in recordings]
