# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The figures of a report: arrays in, SVG and PNG out. The same arrays give the same SVG, byte for byte."""

from __future__ import annotations

import re
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from pendubot_identification.identify.result import Convergence, Result
from pendubot_identification.level import NORMAL_95
from pendubot_identification.model.parameters import NAMES, UNITS
from pendubot_identification.results.figure_data import Excitation, Residuals, Simulation, UnexplainedTorque
from pendubot_identification.tracking.events import Change, Event, State
from pendubot_identification.trajectories.trajectory import Trajectory

from .style import rendered, style
from .tables import Beside
from .time_plot import Line, Panel, Span, TimePlot, envelope, in_powers, places, scaled

Array = NDArray[np.float64]

#: Of every figure [inch]: wide enough for a column on a screen, and legible when a telephone shows it.
WIDTH = 5.2
#: Means of unexplained torque are drawn in so many bins, without what is so many times its median.
BINS, OUTLYING = 24, 8.0
MEASURED, SIMULATED, ESTIMATION, VALIDATION = '#1a1a1a', '#d55e00', '#56b4e9', '#e69f00'
#: Colours that can be told apart by everyone (Okabe and Ito).
COLOURS = ('#0072b2', '#d55e00', '#009e73', '#cc79a7')
STATES = (('q1', 'rad'), ('q2', 'rad'), ("q1'", 'rad/s'), ("q2'", 'rad/s'))
#: How all figures here are drawn, which are smaller than a page.
drawn = style(
    {'axes.titlesize': 9, 'legend.fontsize': 8, 'lines.linewidth': 1.0, 'figure.constrained_layout.w_pad': 0.09}
)


@dataclass(frozen=True, slots=True)
class Timeline:
    """How recordings stand one after the other.

    Attributes:
        shift: what to add to the times [s] of each, by name.
        begins: where each begins [s], in order; empty where there is one alone.
    """

    shift: Mapping[Hashable, float] = field(default_factory=dict)
    begins: Sequence[float] = ()

    def of(self, name: str) -> float:
        """Return what to add to the times [s] of a recording, or of a part of it."""
        return self.shift.get(_recording(name), 0.0)


NOWHERE = Timeline()


@dataclass(frozen=True, slots=True)
class Picture:
    """A figure: the name of its files, their contents, and what its caption in ``page.html.jinja`` needs to know.

    ``plot``: what it shows over time, for a page to explore; None where it shows something else.
    """

    name: str
    svg: str
    png: bytes
    about: Mapping[str, Any]
    plot: TimePlot | None = None

    @property
    def size(self) -> tuple[str, ...]:
        """Width and height, in units of the SVG."""
        found = re.search(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', self.svg)
        return found.groups() if found else ('4', '3')


def timeline(motions: Sequence[Trajectory]) -> Timeline:
    """Return how recordings stand one after the other."""
    names = [_recording(motion.name) for motion in motions]
    shift = places(names, [motion.t for motion in motions])
    begin: dict[str, float] = {}
    for name, motion in zip(names, motions, strict=True):
        begin[name] = min(float(motion.t[0] + shift[name]), begin.get(name, np.inf))
    return Timeline(shift, sorted(begin.values()) if len(begin) > 1 else ())


@drawn
def draw_recordings(training: Sequence[Trajectory], validation: Sequence[Trajectory]) -> Picture:
    """Draw the torque and both angles, and which part estimates and which validates."""
    motions = [*training, *validation]
    at = timeline(motions)
    times = [motion.t + at.of(motion.name) for motion in motions]
    driven = any(motion.tau[:, 1].any() for motion in motions)

    def line(values: Sequence[Array], label: str = '', colour: str = MEASURED, **how: Any) -> Line:
        return Line(label, list(zip(times, values, strict=True)), colour, **how)

    torques = [line([m.tau[:, 0] for m in motions], 'shoulder' if driven else '', width=0.8, style='steps')]
    if driven:
        torques.append(line([m.tau[:, 1] for m in motions], 'elbow', COLOURS[0], width=0.8, style='steps'))
    panels = [Panel('tau1, tau2' if driven else 'tau1', 'N m', torques)]
    panels += [Panel(name, 'rad', [line([m.q[:, k] for m in motions])]) for k, name in enumerate(('q1', 'q2'))]
    kinds = [(ESTIMATION, 'estimates')] * len(training) + [(VALIDATION, 'validates')] * len(validation)
    spans = [Span(t[0], t[-1], *kind) for t, kind in zip(times, kinds, strict=True)]
    earlier = sorted(zip(motions, times, strict=True), key=lambda part: float(part[1][0]))
    ordered = list(dict.fromkeys(_recording(motion.name) for motion, _ in earlier))
    plot = TimePlot(panels, spans, at.begins)
    figure, axes = _panels(4.2, 3, sharex=True)
    plot.draw(axes)
    _legend(axes[0], [Patch(color=colour, alpha=0.4, label=kind) for colour, kind in dict.fromkeys(kinds)])
    return _picture(figure, 'recordings', plot, driven=driven, recordings=ordered)


@drawn
def draw_simulation(simulation: Simulation, at: Timeline = NOWHERE, *, validation: bool) -> Picture:
    """Draw what was measured, what was simulated from measured states on, and below them by how much it is off."""
    place = at.of(simulation.name)
    times, pieces = (simulation.simulated_t + place).T, simulation.simulated
    panels, errors = [], []
    for k, (name, unit) in enumerate(STATES):
        measured = simulation.measured[k]
        middle, reach = (measured.max() + measured.min()) / 2, 0.75 * np.ptp(measured) + 1e-3
        # What has left the figure by far would only make its lines long.
        near = np.where(np.abs(pieces[:, k] - middle) < 20 * reach, pieces[:, k], np.nan)
        truth = np.interp(simulation.simulated_t.T, simulation.t, measured)
        starts = (times[:, 0], pieces[0, k])
        lines = [
            Line('measured', [(simulation.t + place, measured)], MEASURED, 1.6),
            Line('simulated', list(zip(times, near.T, strict=True)), SIMULATED),
            Line('', [starts], SIMULATED, style='dots'),
        ]
        panels.append(Panel(name, unit, lines, (middle - reach, middle + reach)))
        errors.append(Line(name, list(zip(times, near.T - truth, strict=True)), COLOURS[k % 2]))
    panels += [Panel('error', 'rad', errors[:2]), Panel('error', 'rad/s', errors[2:])]
    plot = TimePlot(panels, boundaries=at.begins)
    figure, axes = _panels(7.4, len(panels), sharex=True)
    plot.draw(axes)
    _legend(axes[0], axes[0].lines[:2])
    axes[4].legend(loc='upper left', ncols=2)
    part = '' if simulation.complete else simulation.name
    return _picture(figure, 'simulation', plot, validation=validation, ahead=simulation.ahead, part=part)


@drawn
def draw_residuals(residuals: Residuals, names: Sequence[str] = (), at: Timeline = NOWHERE) -> list[Picture]:
    """Draw a criterion's residuals over time, and apart their autocorrelation and histogram.

    ``names``: of the recordings, as many as the residuals have parts; with others they stand on an axis of their own.
    """
    parts = residuals.parts
    own = len(names) != len(parts)
    if own:
        found = places(range(len(parts)), [t for t, _ in parts])
        times = [t + found[k] for k, (t, _) in enumerate(parts)]
    else:
        times = [t + at.of(name) for name, (t, _) in zip(names, parts, strict=True)]
    lines = [
        Line(name, [(t, values[:, k]) for t, (_, values) in zip(times, parts, strict=True)], colour, 0.7)
        for k, (name, colour) in enumerate(zip(residuals.names, COLOURS, strict=False))
    ]
    panels = [Panel('', residuals.unit, lines)]
    plot = TimePlot(panels, axis=residuals.criterion) if own else TimePlot(panels, boundaries=at.begins)
    figure, axes = _panels(2.2, 1)
    plot.draw(axes)
    _legend(axes[0], axes[0].lines)
    cumulative = bool(np.isinf(residuals.overlap))
    over_time = _picture(figure, f'residuals_{residuals.criterion}', plot, cumulative=cumulative)
    everything = np.concatenate([values for _, values in parts])
    sizes = np.sqrt((everything**2).mean(axis=0))
    bins = np.linspace(-4, 4, 41)
    figure, (correlation, histogram) = _panels(2.2, 1, 2)
    for k, (_, colour) in enumerate(zip(residuals.names, COLOURS, strict=False)):
        correlation.plot(*envelope(residuals.lags[1:], residuals.autocorrelation[1:, k]), color=colour)
        counts, _ = np.histogram(everything[:, k] / (sizes[k] or 1.0), bins, density=True)
        histogram.stairs(counts, bins, color=colour)
    histogram.plot(bins, np.exp(-(bins**2) / 2) / np.sqrt(2 * np.pi), color=MEASURED, linestyle=':', label='normal')
    correlation.axhspan(-residuals.band, residuals.band, color='#bbbbbb', alpha=0.6, linewidth=0)
    correlation.axvspan(0, min(residuals.overlap, residuals.lags[-1]), color='#eeeeee', zorder=0, linewidth=0)
    correlation.set(xlim=(0, residuals.lags[-1]), ylim=(-1.05, 1.05), xlabel='lag [s]', title='autocorrelation')
    histogram.set(xlabel='in its root mean square', title='histogram', yticks=[])
    return [over_time, _picture(figure, f'whiteness_{residuals.criterion}', cumulative=cumulative)]


@drawn
def draw_unexplained_torque(left: UnexplainedTorque, at: Timeline = NOWHERE) -> list[Picture]:
    """Draw the unexplained torque of both joints over time, and its means against what the rig did."""
    starts = [at.of(name) for name in left.names]
    panels = [
        Panel(
            joint,
            'N m',
            [
                Line(
                    '',
                    [(t + s, y[:, k]) for s, t, y in zip(starts, left.times, left.torque, strict=True)],
                    colour,
                    0.7,
                )
            ],
        )
        for k, (joint, colour) in enumerate(zip(('shoulder', 'elbow'), COLOURS, strict=False))
    ]
    plot = TimePlot(panels, [], at.begins)
    figure, axes = _panels(2.6, 2, sharex=True)
    plot.draw(axes)
    over_time = _picture(figure, 'torque_left', plot)
    everything = np.concatenate(left.torque)
    figure, means_of = _panels(2.6, 2, len(left.abscissas), sharey='row')
    against = means_of.reshape(2, -1)
    quiet = np.abs(everything) < OUTLYING * np.median(np.abs(everything), axis=0) + np.finfo(float).tiny
    for joint, colour in enumerate(COLOURS[:2]):
        power = scaled(float(np.abs(everything[quiet[:, joint], joint]).max(initial=0.0)))
        against[joint, 0].set_ylabel(f'{("shoulder", "elbow")[joint]}\n[{in_powers("N m", power)}]')
        for column, (name, values) in enumerate(left.abscissas.items()):
            shown, kept = against[joint, column], quiet[:, joint]
            edges = np.unique(np.quantile(values[kept, joint], np.linspace(0, 1, BINS + 1)))
            if len(edges) < 3:
                continue
            number = np.clip(np.searchsorted(edges, values[kept, joint], side='right') - 1, 0, len(edges) - 2)
            count = np.maximum(np.bincount(number, minlength=len(edges) - 1), 1)
            means = np.bincount(number, everything[kept, joint], minlength=len(edges) - 1) / count / 10.0**power
            shown.plot((edges[1:] + edges[:-1]) / 2, means, color=colour)
            shown.axhline(0, color='#bbbbbb', linewidth=0.6, zorder=0)
            against[1, column].set_xlabel(name)
    return [over_time, _picture(figure, 'torque_means')]


@drawn
def draw_convergence(criterion: str, least: float, convergence: Convergence) -> Picture:
    """Draw how far the best value of each run of MDE is above the exact minimum ``least``, after each generation."""
    generations = np.array(convergence.generations) + 1.0
    best = np.array(convergence.best, dtype=float)
    figure, (axis,) = _panels(3.0, 1)
    axis.loglog(generations, np.maximum(best / least - 1, 1e-14).T, color=COLOURS[0], linewidth=0.8, alpha=0.8)
    axis.set(xlabel='generation', ylabel='best J / exact minimum - 1')
    axis.axhline(1e-6, color=SIMULATED, linestyle='--', label='counts as found')
    _legend(axis, axis.lines[-1:])
    return _picture(figure, f'convergence_{criterion}')


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
        shown = [parameters[name] for _, parameters, _ in rows if name in parameters]
        power = scaled(max(abs(b) for entry in shown for b in (entry.value, *entry.interval) if b is not None))
        size = 10.0**power
        for k, (_, parameters, colour) in enumerate(rows):
            entry = parameters.get(name)
            if entry is None:
                continue
            low, high = entry.interval
            if low is not None and high is not None:
                axis.plot(
                    [low / size, high / size], [k, k], color=colour, linewidth=2.5, alpha=0.5, solid_capstyle='butt'
                )
            axis.plot(entry.value / size, k, 'o', color=colour, markersize=4)
        axis.set_title(f'{name} [{in_powers(result.parameters[name].unit, power)}]')
        axis.set_yticks(range(len(rows)), [label for label, _, _ in rows])
        axis.set_ylim(len(rows) - 0.5, -0.5)
        axis.xaxis.set_major_locator(MaxNLocator(3))
        axis.ticklabel_format(axis='x', style='plain', useOffset=False)
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


@drawn
def draw_track(states: Sequence[State], events: Sequence[Event]) -> Picture:
    """Draw what became of parameters: each with its band over time, unexplained torque below, and what happened."""
    t = np.array([s.t for s in states])
    theta, reach = (np.array([getattr(s, what) for s in states]) for what in ('theta', 'std_error'))
    reach = np.where(np.isfinite(reach), NORMAL_95 * reach, np.nan)
    panels = []
    for k, name in enumerate(NAMES[: theta.shape[1]]):
        low, high = theta[:, k] - reach[:, k], theta[:, k] + reach[:, k]
        # The first bands are wide: what is worth seeing are the others.
        usual = np.isfinite(low) & (np.arange(len(t)) >= len(t) // 20)
        shown = (low[usual].min(), high[usual].max()) if usual.any() else (0.0, 0.0)
        margin = 0.1 * (shown[1] - shown[0])
        lines = [
            Line('95 %', [(t, low)], COLOURS[0], style='band', upper=[(t, high)]),
            Line(name, [(t, theta[:, k])], COLOURS[0]),
        ]
        panels.append(Panel(name, UNITS[k], lines, (shown[0] - margin, shown[1] + margin) if margin > 0 else None))
    panels.append(Panel('unexplained', 'N m', [Line('', [(t, np.array([s.unexplained for s in states]))], MEASURED)]))
    spans = []
    for event in events:
        begin = max(event.begin, float(t[0]))
        # So wide that it is seen.
        end = max(event.end, begin + 0.003 * float(t[-1] - t[0]))
        colour, label = (
            (SIMULATED, 'change') if isinstance(event, Change) else (VALIDATION, type(event).__name__.lower())
        )
        spans.append(Span(begin, end, colour, label))
    plot = TimePlot(panels, spans)
    figure, axes = _panels(0.85 * len(panels), len(panels), sharex=True)
    plot.draw(axes)
    kinds = dict.fromkeys((span.colour, span.label) for span in spans)
    _legend(axes[0], [Patch(color=colour, alpha=0.4, label=label) for colour, label in kinds])
    return _picture(figure, 'track', plot)


def _panels(height: float, rows: int, columns: int = 1, **shared: Any) -> tuple[Figure, NDArray[Any]]:
    """Return a figure, ``height`` inches high, and its axes, row by row."""
    figure = Figure(figsize=(WIDTH, height), layout='constrained')
    return figure, figure.subplots(rows, columns, squeeze=False, **shared).ravel()


def _picture(figure: Figure, name: str, plot: TimePlot | None = None, **about: Any) -> Picture:
    files = rendered(figure, bbox_inches='tight')
    # Hundredths of a point are enough: the page holds every figure.
    svg = re.sub(r'([ML] -?\d+\.\d\d)\d*( -?\d+\.\d\d)\d*', r'\1\2', files['svg'].decode())
    return Picture(name, svg, files['png'], about, plot)


def _recording(name: str) -> str:
    """Return of which recording a part is, by the part's name, ``BAG@START:END``."""
    return name.rpartition('@')[0] or name


def _legend(axis: Axes, handles: Sequence[Any]) -> None:
    """Put a legend above an axis, where it covers nothing."""
    axis.legend(handles=handles, loc='lower left', bbox_to_anchor=(0, 1.0), ncols=4, borderaxespad=0.2)
