# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The pictures of a report: plots over time and static figures. The same arrays give the same SVG, byte for byte."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.stats import binned_statistic

from pendubot_identification.criteria.prediction_error import STEP
from pendubot_identification.identification.catalogue import compensated
from pendubot_identification.identification.prediction import predict, state_scale
from pendubot_identification.level import NORMAL_95
from pendubot_identification.model.parameters import NAMES, UNITS
from pendubot_identification.results.assemble import predicted
from pendubot_identification.results.provenance import Answer, answers, hold, settings
from pendubot_identification.results.result import Convergence, PartialResult, Predicted, Result
from pendubot_identification.tracking.events import Change, Event, State
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.trajectory import Trajectory

from . import figure_data
from .figure_data import Array, Parts, Residuals, Simulation
from .style import GREY, SMALL, WIDTH, rendered, style
from .time_plot import Line, Panel, Span, TimePlot, thinned

#: The motions that estimate, and those that validate.
Recordings = tuple[Sequence[Trajectory], Sequence[Trajectory]]
MEASURED, SIMULATED = '#1a1a1a', '#d55e00'
#: Of spans, and their opacity.
ESTIMATION, VALIDATION, CHANGE = '#56b4e92e', '#e69f002e', '#d55e002e'
#: Colours that can be told apart by everyone (Okabe and Ito).
COLOURS = ('#0072b2', '#d55e00', '#009e73', '#cc79a7')
STATES = (('q1', 'rad'), ('q2', 'rad'), ("q1'", 'rad/s'), ("q2'", 'rad/s'))
#: Number of bins for means of unexplained torque; torques above OUTLYING times their median are left out.
BINS, OUTLYING = 24, 8.0
drawn = style(SMALL)


@dataclass(frozen=True, slots=True)
class Picture:
    """A plot over time or a static figure; ``about`` is what its caption in ``page.html.jinja`` depends on."""

    name: str
    content: TimePlot | Figure
    about: Mapping[str, Any] = field(default_factory=dict)

    @style(SMALL)
    def files(self, *endings: str) -> dict[str, bytes]:
        """Return it as a static figure, by the ending of the file's name."""
        figure = self.content.figure() if isinstance(self.content, TimePlot) else self.content
        return rendered(figure, endings, bbox_inches='tight')


#: The subject of pictures, for messages, and the function that draws them.
Wanted = tuple[str, Callable[[], list[Picture]]]


@dataclass(frozen=True, slots=True)
class Timeline:
    """Recordings one after the other: what to add to the times [s] of each, and a mark where each begins."""

    shifts: Mapping[str, float] = field(default_factory=dict)
    marks: Sequence[Span] = ()

    @classmethod
    def of(cls, motions: Sequence[Trajectory]) -> Timeline:
        """Return the places of these motions; parts of one recording keep their distance in time."""
        spans: dict[str, list[float]] = {}
        for motion in motions:
            spans.setdefault(_recording(motion.name), []).extend((float(motion.t[0]), float(motion.t[-1])))
        shifts: dict[str, float] = {}
        marks: list[Span] = []
        end = None
        for name, times in spans.items():
            shifts[name] = 0.0 if end is None else end - min(times)
            if end is not None:
                marks.append(Span(end, end, GREY))
            end = max(times) + shifts[name]
        return cls(shifts, marks)

    def times(self, parts: Parts) -> list[Array]:
        """Return the times [s] of each recording, or part of one, in its place."""
        return [t + self.shifts.get(_recording(name), 0.0) for name, t, _ in parts]


def _recording(name: str) -> str:
    """Return the recording of a part with the name ``BAG@START:END``."""
    return name.rpartition('@')[0] or name


def plot_recordings(training: Sequence[Trajectory], validation: Sequence[Trajectory]) -> list[Picture]:
    """Plot the torques and both angles, and which part estimates and which validates."""
    motions = [*training, *validation]
    timeline = Timeline.of(motions)
    times = timeline.times([(motion.name, motion.t, motion.q) for motion in motions])
    driven = any(motion.tau[:, 1].any() for motion in motions)
    torques = [
        Line(('shoulder', 'elbow')[k] if driven else '', [m.tau[:, k] for m in motions], colour, 0.8, 'steps')
        for k, colour in enumerate((MEASURED, COLOURS[0])[: 1 + driven])
    ]
    panels = [Panel('tau1, tau2' if driven else 'tau1', 'N m', times, torques)]
    panels += [Panel(f'q{k + 1}', 'rad', times, [Line('', [m.q[:, k] for m in motions], MEASURED)]) for k in (0, 1)]
    kinds = [(ESTIMATION, 'estimates')] * len(training) + [(VALIDATION, 'validates')] * len(validation)
    spans = [Span(t[0], t[-1], *kind) for t, kind in zip(times, kinds, strict=True)]
    about = {'driven': driven, 'recordings': list(timeline.shifts)}
    return [Picture('recordings', TimePlot(panels, [*spans, *timeline.marks]), about)]


def plot_simulation(simulation: Simulation, timeline: Timeline, *, validation: bool) -> list[Picture]:
    """Plot measured states, states simulated from measured ones on, and their difference."""
    t = timeline.times([(simulation.name, simulation.t, simulation.measured)])
    pieces = simulation.simulated
    size, _, count = pieces.shape
    paths = np.moveaxis(pieces[:-1], 0, 2)
    starts = np.append(np.arange(count * (size - 1)) % (size - 1) == 0, False)
    panels, errors = [], []
    for k, (name, unit) in enumerate(STATES):
        measured, y = simulation.measured[k], np.append(paths[k], pieces[-1, k, -1])
        middle, reach = (measured.max() + measured.min()) / 2, 0.75 * np.ptp(measured) + 1e-3
        # Before each start there is a gap, and a state far outside the plot would only make its lines long.
        y[(np.abs(y - middle) > 20 * reach) | np.append(starts[1:], False)] = np.nan
        lines = [
            Line('measured', [measured], MEASURED, 1.6),
            Line('simulated', [y], SIMULATED),
            Line('', [np.where(starts, measured, np.nan)], SIMULATED, style='dots'),
        ]
        panels.append(Panel(name, unit, t, lines, (middle - reach, middle + reach)))
        errors.append(Line(name, [y - measured], COLOURS[k % 2]))
    panels += [Panel('error', 'rad', t, errors[:2]), Panel('error', 'rad/s', t, errors[2:])]
    about = {
        'validation': validation,
        'ahead': simulation.ahead,
        'part': '' if simulation.complete else simulation.name,
    }
    live = {
        'first': round(float(t[0][0]), 9),
        'step': STEP,
        'every': size - 1,
        'states': [[float(f'{x:.7g}') for x in state] for state in simulation.measured.tolist()],
        'tau': [[float(f'{x:.5g}') for x in torque] for torque in simulation.tau.tolist()],
        'scale': simulation.scale.tolist(),
    }
    return [Picture('simulation', TimePlot(panels, timeline.marks, live), about)]


@drawn
def draw_residuals(residuals: Residuals, timeline: Timeline) -> list[Picture]:
    """Plot the residuals of a criterion, and draw their autocorrelation and histogram."""
    lines = [
        Line(channel, [y[:, k] for _, _, y in residuals.parts], COLOURS[k], 0.7)
        for k, channel in enumerate(residuals.names)
    ]
    plot = TimePlot([Panel('', residuals.unit, timeline.times(residuals.parts), lines)], timeline.marks)
    everything = np.concatenate([values for _, _, values in residuals.parts])
    sizes, bins = np.sqrt((everything**2).mean(axis=0)), np.linspace(-4, 4, 41)
    figure, (correlation, histogram) = _panels(2.2, 1, 2)
    shown = 1 + thinned(residuals.autocorrelation[1:])
    for k in range(len(residuals.names)):
        correlation.plot(residuals.lags[shown], residuals.autocorrelation[shown, k], color=COLOURS[k])
        counts, _ = np.histogram(everything[:, k] / (sizes[k] or 1.0), bins, density=True)
        histogram.stairs(counts, bins, color=COLOURS[k])
    histogram.plot(bins, np.exp(-(bins**2) / 2) / np.sqrt(2 * np.pi), color=MEASURED, linestyle=':')
    correlation.axhspan(-residuals.band, residuals.band, color='#bbbbbb', alpha=0.6, linewidth=0)
    correlation.axvspan(0, min(residuals.overlap, residuals.lags[-1]), color='#eeeeee', zorder=0, linewidth=0)
    correlation.set(xlim=(0, residuals.lags[-1]), ylim=(-1.05, 1.05), xlabel='lag [s]', title='autocorrelation')
    histogram.set(xlabel='in its root mean square', title='histogram', yticks=[])
    pictures: dict[str, TimePlot | Figure] = {'residuals': plot, 'whiteness': figure}
    about = {'cumulative': bool(np.isinf(residuals.overlap))}
    return [Picture(f'{name}_{residuals.criterion}', content, about) for name, content in pictures.items()]


@drawn
def draw_unexplained_torque(parts: Parts, against: Mapping[str, Array], timeline: Timeline) -> list[Picture]:
    """Plot the unexplained torque of both joints, and draw its means against other quantities."""
    torque, panels = np.concatenate([values for _, _, values in parts]), []
    figure, axes = _panels(2.6, 2, len(against), sharey='row')
    usual = np.abs(torque) < OUTLYING * np.median(np.abs(torque), axis=0) + np.finfo(float).tiny
    for k, (joint, row) in enumerate(zip(('shoulder', 'elbow'), axes.reshape(2, -1), strict=True)):
        line = Line('', [values[:, k] for _, _, values in parts], COLOURS[k], 0.7)
        panels.append(Panel(joint, 'N m', timeline.times(parts), [line]))
        kept = torque[usual[:, k], k]
        row[0].set_ylabel(f'{joint}\n[N m]')
        for axis, (name, values) in zip(row, against.items(), strict=True):
            x = values[usual[:, k], k]
            edges = np.unique(np.quantile(x, np.linspace(0, 1, BINS + 1)))
            if len(edges) > 2:
                means = binned_statistic(x, kept, bins=edges).statistic
                axis.plot((edges[1:] + edges[:-1]) / 2, means, color=COLOURS[k])
                axis.axhline(0, color='#bbbbbb', linewidth=0.6, zorder=0)
            if k == 1:
                axis.set_xlabel(name)
    return [Picture('torque_left', TimePlot(panels, timeline.marks)), Picture('torque_means', figure)]


def plot_track(states: Sequence[State], events: Sequence[Event]) -> Picture:
    """Plot tracked parameters with their 95 % bands, the unexplained torque, and all events."""
    t = np.array([s.t for s in states])
    theta, std_error = (np.array([getattr(s, name) for s in states]) for name in ('theta', 'std_error'))
    reach = np.where(np.isfinite(std_error), NORMAL_95 * std_error, np.nan)
    panels = []
    for k, name in enumerate(NAMES[: theta.shape[1]]):
        low, high = theta[:, k] - reach[:, k], theta[:, k] + reach[:, k]
        # The first bands are wide and would hide the others.
        usual = np.isfinite(low) & (np.arange(len(t)) >= len(t) // 20)
        shown = (low[usual].min(), high[usual].max()) if usual.any() else (0.0, 0.0)
        margin = 0.1 * (shown[1] - shown[0])
        lines = [Line('95 %', [low], COLOURS[0], style='band', upper=[high]), Line(name, [theta[:, k]], COLOURS[0])]
        within = (shown[0] - margin, shown[1] + margin) if margin > 0 else None
        panels.append(Panel(name, UNITS[k], [t], lines, within))
    panels.append(Panel('unexplained', 'N m', [t], [Line('', [np.array([s.unexplained for s in states])], MEASURED)]))
    spans = []
    for event in events:
        begin = max(event.begin, float(t[0]))
        end = max(event.end, begin + 0.003 * float(t[-1] - t[0]))  # wide enough to be seen
        changed = isinstance(event, Change)
        label = 'change' if changed else type(event).__name__.lower()
        spans.append(Span(begin, end, CHANGE if changed else VALIDATION, label))
    return Picture('track', TimePlot(panels, spans))


@drawn
def draw_convergence(criterion: str, least: float, convergence: Convergence) -> list[Picture]:
    """Draw the distance of the best value of each run of MDE from the exact minimum ``least``, by generation."""
    generations = np.array(convergence.generations) + 1.0
    best = np.array(convergence.best, dtype=float)
    figure, (axis,) = _panels(3.0, 1)
    axis.loglog(generations, np.maximum(best / least - 1, 1e-14).T, color=COLOURS[0], linewidth=0.8, alpha=0.8)
    axis.set(xlabel='generation', ylabel='best J / exact minimum - 1')
    axis.axhline(1e-6, color=SIMULATED, linestyle='--', label='counts as found')
    axis.legend(loc='lower left', bbox_to_anchor=(0, 1.0), borderaxespad=0.2)
    return [Picture(f'convergence_{criterion}', figure)]


@drawn
def draw_correlation(result: Result) -> list[Picture]:
    """Draw the correlation matrix of the selected estimate, if it has one."""
    names = list(result.parameters)
    matrix = np.array(result.criteria[result.criterion].correlation, dtype=float)
    if not np.isfinite(matrix).any():
        return []
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
    return [Picture('correlation', figure)]


@drawn
def draw_excitation(names: Sequence[str], terms: Array, own: Array, residual: Array) -> list[Picture]:
    """Draw the effect of each parameter in the equation of each joint, and its part that no other can imitate.

    The arrays are those of :func:`.figure_data.excitation`.
    """
    figure, axes = _panels(1.4 + 0.26 * len(names), 1, 2, sharey=True)
    places = np.arange(len(names))
    for k, (axis, joint) in enumerate(zip(axes, ('shoulder', 'elbow'), strict=True)):
        largest = max(terms[:, k].max(), residual[k]) or 1.0
        least = 10.0 ** np.floor(np.log10(max(min(residual[k], largest * 1e-3), largest * 1e-7, 1e-300)) - 0.5)
        for values, label, how in ((terms, 'all it does', {'alpha': 0.35}), (own, 'it alone', {'height': 0.45})):
            width = np.maximum(values[:, k] - least, 0)
            axis.barh(places, width, left=least, color=COLOURS[0], label=label, **how)
        axis.axvline(max(residual[k], least), color=SIMULATED, linestyle='--', label='unexplained')
        axis.set(xscale='log', xlim=(least, 2 * largest), title=f"{joint}'s equation", xlabel='root mean square [N m]')
        axis.set_yticks(places, names)
        axis.grid(False, axis='y')
    axes[0].invert_yaxis()
    figure.legend(*axes[0].get_legend_handles_labels(), loc='lower center', ncols=3, bbox_to_anchor=(0.5, 1.0))
    return [Picture('excitation', figure)]


def _panels(height: float, rows: int, columns: int = 1, **shared: Any) -> tuple[Figure, NDArray[Any]]:
    """Return a figure, ``height`` inches high, and its axes, row by row."""
    figure = Figure(figsize=(WIDTH, height), layout='constrained')
    return figure, figure.subplots(rows, columns, squeeze=False, **shared).ravel()


def of_result(result: Result) -> Iterator[Wanted]:
    """Yield the subject of each picture of a result alone, and the function that draws it."""
    yield 'the correlations', partial(draw_correlation, result)
    for criterion, answer in result.criteria.items():
        if answer.convergence and answer.J.least_squares is not None:
            draw = partial(draw_convergence, criterion, answer.J.least_squares, answer.convergence)
            yield f'the convergence of {criterion}', draw


@dataclass(frozen=True, slots=True)
class Prepared:
    """A result and its recordings, with smoothed states and without the compensated effects."""

    result: Result
    recorded: Recordings
    estimating: Sequence[Motion]
    validating: Sequence[Motion]
    scale: Array

    @classmethod
    def of(cls, result: Result, training: Sequence[Trajectory], validation: Sequence[Trajectory]) -> Prepared:
        """Prepare the recordings as the identification did."""
        delay = answers(result)[result.criterion].delay
        estimating, validating = (
            [Motion.prepare(motion, result.smoothing, hold(result)) for motion in recorded]
            for recorded in (training, validation)
        )
        scale = state_scale(estimating)
        effects = figure_data.known_effects(estimating, delay, result.effects)
        estimating, validating = (
            [compensated(motion, effects, delay) for motion in motions] for motions in (estimating, validating)
        )
        return cls(result, (training, validation), estimating, validating, scale)

    def compared(self, beside: tuple[PartialResult, str]) -> dict[str, Predicted]:
        """Return how well another result, and this one, predict the validation data or, without any, all data."""
        best, (other, name) = answers(self.result)[self.result.criterion], beside
        motions, vectors = self.validating or self.estimating, {name: other.theta.vector(), 'identified': best.theta}
        return {title: predicted(predict(motions, theta, best.delay, self.scale)) for title, theta in vectors.items()}

    def pictures(self) -> Iterator[Wanted]:
        """Yield the subject of each picture of the recordings, and the function that draws it."""
        estimates, motions, validating = answers(self.result), self.estimating, self.validating
        best, asked, names = estimates[self.result.criterion], settings(self.result), list(self.result.parameters)
        timeline = Timeline.of([*self.recorded[0], *self.recorded[1]])
        yield 'the data', lambda: plot_recordings(*self.recorded)
        yield (
            'the unexplained torque',
            lambda: draw_unexplained_torque(*figure_data.unexplained_torque(motions, best), timeline),
        )
        yield (
            'the simulation',
            lambda: plot_simulation(
                figure_data.simulate_beside(validating or motions, best, self.scale),
                timeline,
                validation=bool(validating),
            ),
        )
        yield 'the excitation', lambda: draw_excitation(names, *figure_data.excitation(motions, best, names))

        def residuals(answer: Answer) -> list[Picture]:
            return draw_residuals(figure_data.residuals(motions, answer, asked), timeline)

        yield from ((f'the residuals of {name}', partial(residuals, answer)) for name, answer in estimates.items())


def draw_balance(path: Path, motion: Trajectory, limit: float) -> None:
    """Draw the angles of a swing-up from upright, and the torque with its limit [N m], into a picture file."""
    t = [motion.t - motion.t[0]]
    upright = np.degrees(np.remainder(np.cumsum(motion.q, axis=1) + math.pi / 2, 2 * math.pi) - math.pi)
    angles = [Line(f'link {k + 1}', [upright[:, k]], COLOURS[k], 0.5, 'dots') for k in (0, 1)]
    limits = [Line('', [np.full(len(motion), bound)], GREY) for bound in (-limit, limit)]
    torque = Line('', [motion.tau[:, 0]], MEASURED, 0.7, 'steps')
    panels = [Panel('from upright', 'degrees', t, angles, (-185, 185)), Panel('torque', 'N m', t, [torque, *limits])]
    picture = Picture('balance', TimePlot(panels))
    path.write_bytes(picture.files(path.suffix[1:])[path.suffix[1:]])
