# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The pictures of a report: plots over time and static figures. The same arrays give the same SVG, byte for byte.

matplotlib takes half a second to import: only modules that draw import this one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from io import BytesIO
from types import MappingProxyType
from typing import Any, NamedTuple

import matplotlib.style
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from pendubot_identification.arrays import Array
from pendubot_identification.criteria.prediction_error import HORIZONS, LOST, STEP, Simulations, state_scale
from pendubot_identification.criteria.weak import WIDTH, weak_regression
from pendubot_identification.errors import TrajectoryError
from pendubot_identification.identification.effects import DetectedEffect, catalogue, compensated
from pendubot_identification.identification.fitting import linear, with_given_parameters
from pendubot_identification.identification.validation import stillness
from pendubot_identification.level import NORMAL_95
from pendubot_identification.model.parameters import NAMES, UNITS
from pendubot_identification.recordings.bag_reader import BagWindow
from pendubot_identification.results.provenance import hold, settings
from pendubot_identification.results.result import Result, theta_of
from pendubot_identification.tracking.events import Change, Event, State
from pendubot_identification.trajectories.conventions import JOINT_NAMES
from pendubot_identification.trajectories.conversion import Affine
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.trajectory import Trajectory

from .time_plot import Line, Span, TimePlot, panel, thinned

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
    with matplotlib.style.context({**SETTINGS, **(changes or {})}, after_reset=True):
        yield


def rendered(figure: Figure, endings: tuple[str, ...] = ('png', 'svg')) -> dict[str, bytes]:
    """Return the figure as PNG and as SVG, without date or version, by the ending of the file's name."""
    metadata: dict[str, dict[str, None]] = {'png': {'Software': None}, 'svg': {'Date': None, 'Creator': None}}
    files = {}
    for ending in endings:
        file = BytesIO()
        figure.savefig(file, format=ending, metadata=metadata[ending])
        figure.set_layout_engine('none')  # the next file reuses this layout
        files[ending] = file.getvalue()
    return files


#: The motions for training and for validation.
Recordings = tuple[Sequence[Trajectory], Sequence[Trajectory]]
MEASURED, SIMULATED = '#1a1a1a', '#d55e00'
#: Colours of spans, with their opacity.
ESTIMATION, VALIDATION, CHANGE = '#56b4e92e', '#e69f002e', '#d55e002e'
#: Colours that are distinct for colour-blind readers, too (Okabe and Ito).
COLOURS = ('#0072b2', '#d55e00', '#009e73', '#cc79a7')
STATES = (('q1', 'rad'), ('q2', 'rad'), ("q1'", 'rad/s'), ("q2'", 'rad/s'))
#: Width of a static figure [inch]: a column on a screen, and legible on a telephone.
COLUMN = 5.2
#: Longest duration of a simulation, equal to the longest prediction horizon, and of the shown part [s].
AHEAD, SHOWN = HORIZONS[-1], 10.0
#: Number of bins for means of unexplained torque; torques above OUTLYING times their median are omitted.
BINS, OUTLYING = 24, 8.0
drawn = style(SMALL)


class Picture(NamedTuple):
    """A plot over time or a static figure; ``about`` are the variables of its caption in ``page.html.jinja``."""

    name: str
    content: TimePlot | Figure
    about: Mapping[str, Any] = MappingProxyType({})

    @drawn
    def files(self, *endings: str) -> dict[str, bytes]:
        """Return the static figure by the ending of the file's name."""
        figure = self.content.figure() if isinstance(self.content, TimePlot) else self.content
        return rendered(figure, endings)


@dataclass(frozen=True, slots=True)
class Prepared:
    """A result and its recordings, with smoothed states and without the compensated effects and errors of zeros."""

    result: Result
    recorded: Recordings  #: recordings, moved to follow each other in time; parts of one keep their distance.
    marks: Sequence[Span]  #: lines at the start of each further recording.
    uncompensated: Sequence[Motion]  #: training motions with the effects, as energy and weak read them.
    estimating: Sequence[Motion]
    validating: Sequence[Motion]
    scale: Array  #: standard deviations of the states, the unit of prediction errors, shape (4,).

    @classmethod
    def of(cls, result: Result, training: Sequence[Trajectory], validation: Sequence[Trajectory]) -> Prepared:
        """Prepare the recordings as the identification did."""
        recorded, marks = _one_after_the_other([*training, *validation])
        motions = [Motion.prepare(motion, result.smoothing, hold(result)) for motion in recorded]
        size, delay = len(training), result.effort.delay
        known = {(effect.name, effect.where): effect for effect in catalogue(motions[:size], delay)}
        effects = [
            DetectedEffect(known[e.name, e.where], np.array(e.sizes, dtype=float), np.nan, np.nan, True, np.zeros(5))
            for e in result.effects
            if e.accepted and (e.name, e.where) in known
        ]
        # A recording at rest validates nothing; energy and weak estimate no zeros.
        known_zeros = iter(result.zeros)
        zeros = [next(known_zeros, None) if k < size or not stillness(m) else None for k, m in enumerate(recorded)]
        off = [np.radians([zero.q1 or 0.0, zero.q2 or 0.0]) if zero else np.zeros(2) for zero in zeros]
        acting = [compensated(m, effects, delay).changed(Affine.of(c=-c)) for m, c in zip(motions, off, strict=True)]
        split = recorded[:size], recorded[size:]
        return cls(result, split, marks, motions[:size], acting[:size], acting[size:], state_scale(motions[:size]))

    @property
    def theta(self) -> Array:
        """The selected parameters of the model, shape (D,)."""
        return self.result.theta.vector(self.result.model)

    def pictures(self) -> Iterator[tuple[str, Callable[[], list[Picture]]]]:
        """Yield the subject of each picture of the recordings, and the function that draws it."""
        yield 'the data', self.data
        yield 'the unexplained torque', self.unexplained_torque
        yield 'the simulation', self.simulation
        yield from ((f'the residuals of {name}', partial(self.residuals, name)) for name in self.result.criteria)

    def data(self) -> list[Picture]:
        """Plot the torques and both angles, and shade training and validation data."""
        training, validation = self.recorded
        motions = [*training, *validation]
        times = [motion.t for motion in motions]
        driven = any(motion.tau[:, 1].any() for motion in motions)
        torques = [
            Line(JOINT_NAMES[k] if driven else '', [m.tau[:, k] for m in motions], colour, 0.8, 'steps')
            for k, colour in enumerate((MEASURED, COLOURS[0])[: 1 + driven])
        ]
        panels = [panel('tau1, tau2' if driven else 'tau1', 'N m', times, torques)]
        panels += [panel(f'q{k + 1}', 'rad', times, [Line('', [m.q[:, k] for m in motions], MEASURED)]) for k in (0, 1)]
        kinds = [(ESTIMATION, 'training')] * len(training) + [(VALIDATION, 'validation')] * len(validation)
        spans = [Span(t[0], t[-1], *kind) for t, kind in zip(times, kinds, strict=True)]
        about = {'driven': driven, 'recordings': list(dict.fromkeys(_recording(motion) for motion in motions))}
        return [Picture('recordings', TimePlot(panels, [*spans, *self.marks]), about)]

    def simulation(self) -> list[Picture]:
        """Plot measured and simulated states of the worst predicted part, and their difference.

        Raises:
            TrajectoryError: the recordings are too short to be simulated.
        """
        motions, delay = self.validating or self.estimating, self.result.effort.delay
        motion, t, pieces, complete = _worst_part(motions, self.theta, delay, self.scale)
        measured, steps = motion.states(t), len(pieces) - 1
        # The start of the next simulation replaces the last state of each.
        states = np.column_stack([np.moveaxis(pieces[:-1], 0, 2).reshape(4, -1), pieces[-1, :, -1]])
        starts = np.append(np.arange(len(t) - 1) % steps == 0, False)
        panels, errors = [], []
        for k, (name, unit) in enumerate(STATES):
            y = states[k]
            middle, reach = (measured[k].max() + measured[k].min()) / 2, 0.75 * np.ptp(measured[k]) + 1e-3
            # A gap precedes each start; states far outside the plot are omitted.
            y[(np.abs(y - middle) > 20 * reach) | np.append(starts[1:], False)] = np.nan
            lines = [
                Line('measured', [measured[k]], MEASURED, 1.6),
                Line('simulated', [y], SIMULATED),
                Line('', [np.where(starts, measured[k], np.nan)], SIMULATED, style='dots'),
            ]
            panels.append(panel(name, unit, [t], lines, (middle - reach, middle + reach)))
            errors.append(Line(name, [y - measured[k]], COLOURS[k % 2]))
        panels += [panel('error', 'rad', [t], errors[:2]), panel('error', 'rad/s', [t], errors[2:])]
        part = '' if complete else motion.name
        about = {'validation': bool(self.validating), 'ahead': steps * STEP, 'part': part}
        return [Picture('simulation', TimePlot(panels, self.marks), about)]

    @drawn
    def unexplained_torque(self) -> list[Picture]:
        """Plot the weak-form residuals of both joints, and draw their means against angle, speed and torque.

        Raises:
            TrajectoryError: a recording is shorter than a test function.
        """
        model, delay = self.result.model, self.result.effort.delay
        motions = self._motions(self.result.criterion)
        rows = [weak_regression(m, model, delay, weights=(1, 1, 1), stride=WIDTH / 4) for m in motions]
        times = [r.t[::3] for r in rows]
        parts = [(r.y - r.phi @ self.theta).reshape(-1, 3)[:, :2] for r in rows]
        states = np.concatenate([m.states(t) for m, t in zip(motions, times, strict=True)], axis=1)
        tau = np.concatenate([m.impulse(t - delay, 1) for m, t in zip(motions, times, strict=True)])
        against = {'its angle [rad]': states[:2].T, 'its speed [rad/s]': states[2:].T, 'torque [N m]': tau[:, [0, 0]]}
        torque, panels = np.concatenate(parts), []
        figure, axes = _panels(2.6, 2, len(against), sharey='row')
        usual = np.abs(torque) < OUTLYING * np.median(np.abs(torque), axis=0) + np.finfo(float).tiny
        for k, (joint, row) in enumerate(zip(JOINT_NAMES, axes.reshape(2, -1), strict=True)):
            panels.append(panel(joint, 'N m', times, [Line('', [part[:, k] for part in parts], COLOURS[k], 0.7)]))
            row[0].set_ylabel(f'{joint}\n[N m]')
            for axis, (name, values) in zip(row, against.items(), strict=True):
                x = values[usual[:, k], k]
                edges = np.unique(np.quantile(x, np.linspace(0, 1, BINS + 1)))
                if len(edges) > 2:
                    sums, _ = np.histogram(x, edges, weights=torque[usual[:, k], k])
                    with np.errstate(invalid='ignore'):  # no point for an empty bin
                        means = sums / np.histogram(x, edges)[0]
                    axis.plot((edges[1:] + edges[:-1]) / 2, means, color=COLOURS[k])
                    axis.axhline(0, color='#bbbbbb', linewidth=0.6, zorder=0)
                if k == 1:
                    axis.set_xlabel(name)
        return [Picture('torque_left', TimePlot(panels, self.marks)), Picture('torque_means', figure)]

    @drawn
    def residuals(self, criterion: str) -> list[Picture]:
        """Plot the residuals of a criterion on training data, and draw their autocorrelation and histogram.

        Raises:
            TrajectoryError: the recordings are too short.
        """
        names, unit, overlap, times, parts = self._residuals(criterion)
        lines = [Line(name, [y[:, k] for y in parts], COLOURS[k], 0.7) for k, name in enumerate(names)]
        plot = TimePlot([panel('', unit, times, lines)], self.marks)
        everything = np.concatenate(parts)
        sizes, bins = np.sqrt((everything**2).mean(axis=0)), np.linspace(-4, 4, 41)
        lags, values = _autocorrelation(times, parts)
        band = NORMAL_95 / math.sqrt(len(everything))  # contains 95 % of white residuals
        figure, (correlation, histogram) = _panels(2.2, 1, 2)
        shown = 1 + thinned(values[1:])
        for k in range(len(names)):
            correlation.plot(lags[shown], values[shown, k], color=COLOURS[k])
            counts, _ = np.histogram(everything[:, k] / (sizes[k] or 1.0), bins, density=True)
            histogram.stairs(counts, bins, color=COLOURS[k])
        histogram.plot(bins, np.exp(-(bins**2) / 2) / np.sqrt(2 * np.pi), color=MEASURED, linestyle=':')
        correlation.axhspan(-band, band, color='#bbbbbb', alpha=0.6, linewidth=0)
        correlation.axvspan(0, min(overlap, lags[-1]), color='#eeeeee', zorder=0, linewidth=0)
        correlation.set(xlim=(0, lags[-1]), ylim=(-1.05, 1.05), xlabel='lag [s]', title='autocorrelation')
        histogram.set(xlabel='in its root mean square', title='histogram', yticks=[])
        about = {'cumulative': math.isinf(overlap)}
        return [Picture(f'residuals_{criterion}', plot, about), Picture(f'whiteness_{criterion}', figure, about)]

    def _residuals(self, criterion: str) -> tuple[Sequence[str], str, float, list[Array], list[Array]]:
        """Return the residuals of a criterion's estimate; for ``likelihood``, normalized innovations every 0.05 s.

        Returns:
            The names of C channels; their unit; the lag [s] below which residuals share data, so that they are always
            correlated; the times of each recording, shape (N,); its residuals, shape (N, C).
        """
        asked, answer = settings(self.result), self.result.criteria[criterion]
        motions = self._motions(criterion)
        theta = theta_of(answer.parameters).vector(self.result.model)
        if criterion == 'likelihood':
            fitted = with_given_parameters(motions, theta, answer.effort.delay, asked)
            filter_data, (e, s) = fitted.likelihood.filter_data, fitted.likelihood.innovations(fitted.x)
            times, z = ([values[g.rows] for g in filter_data.series] for values in (filter_data.t, e / np.sqrt(s)))
            return ('q1', 'q2'), 'standard deviations', 0.0, times, z
        names: tuple[str, ...] = (*JOINT_NAMES, 'energy')
        unit, overlap = 'N m', WIDTH
        if criterion == 'energy':
            names, unit, overlap = ('energy',), 'J', asked.sliding or math.inf
        rows = linear(criterion, motions, self.result.model, asked).residuals
        parts = [(r.y - r.phi @ theta).reshape(-1, len(names)) for r in rows]
        return names, unit, overlap, [r.t[:: len(names)] for r in rows], parts

    def _motions(self, criterion: str) -> Sequence[Motion]:
        """Return the training motions of a criterion: likelihood also estimates effects and zeros."""
        return self.estimating if criterion == 'likelihood' else self.uncompensated


def _recording(motion: Trajectory) -> str:
    """Return the recording of a part with the name ``BAG@START:END``."""
    return str(BagWindow.named(motion.name).path)


def _one_after_the_other(motions: Sequence[Trajectory]) -> tuple[list[Trajectory], list[Span]]:
    """Return motions, moved in time so that recordings follow each other, and a mark at each further start."""
    spans: dict[str, list[float]] = {}
    for motion in motions:
        spans.setdefault(_recording(motion), []).extend((float(motion.t[0]), float(motion.t[-1])))
    shifts: dict[str, float] = {}
    ends: list[float] = []
    for name, times in spans.items():
        shifts[name] = ends[-1] - min(times) if ends else 0.0
        ends.append(max(times) + shifts[name])
    moved = [replace(motion, t=motion.t + shifts[_recording(motion)]) for motion in motions]
    return moved, [Span(end, end, GREY) for end in ends[:-1]]


def _worst_part(
    motions: Sequence[Motion], theta: Array, delay: float, scale: Array
) -> tuple[Motion, Array, Array, bool]:
    """Simulate recordings from measured states, and return the worst predicted part of one of them.

    Returns:
        The motion; the times of the part every :data:`STEP`, shape (N,); the states of K simulations of L steps, shape
        (L + 1, 4, K), NaN after one diverges; whether the part contains all data.

    Raises:
        TrajectoryError: the recordings are too short to be simulated.
    """
    margin = max(abs(delay), 1e-9)
    longest = max(m.end - m.start - m.interval for m in motions) - 2 * margin
    if longest < STEP:
        raise TrajectoryError(
            f'{motions[0].name}: it is too short for a simulation with a delay of {delay:g} s; give a longer recording'
        )
    ahead = STEP * int(min(AHEAD, longest) / STEP)
    candidates = []
    for motion in (m for m in motions if m.end - m.start - 2 * margin >= ahead):
        simulations = Simulations.of([motion], theta, delay, np.zeros(2), (ahead,), ahead)
        with np.errstate(all='ignore'):
            deviations, states = simulations.errors(theta)
            scaled = np.nan_to_num(np.abs(deviations[0] / scale[:, None]), nan=LOST, posinf=LOST)
        errors = (np.minimum(scaled, LOST) ** 2).mean(axis=0)
        count = min(len(errors), max(1, round(SHOWN / ahead)))
        sums = np.convolve(errors, np.ones(count), mode='valid') / count
        first = int(np.argmax(sums))
        candidates.append((float(sums[first]), motion, simulations, states, slice(first, first + count)))
    _, motion, simulations, states, shown = max(candidates, key=lambda candidate: candidate[0])
    states = np.where(np.isfinite(states), states, np.nan)[:: simulations.substeps, :, shown]
    starts = simulations.t
    t = starts[shown.start] + STEP * np.arange((len(states) - 1) * states.shape[2] + 1)
    return motion, t, states, len(motions) == 1 and len(starts) <= shown.stop - shown.start


def _autocorrelation(times: Sequence[Array], parts: Sequence[Array]) -> tuple[Array, Array]:
    """Return lags [s], shape (M,), and the autocorrelation, (M, C), of evenly spaced residuals of mean 0, (N, C)."""
    interval = float(np.median(np.concatenate([np.diff(t) for t in times])))
    lags = int(min(2 * AHEAD / interval, max(map(len, times)) // 2))
    sums = np.zeros((lags + 1, parts[0].shape[1]))
    for part in parts:
        padded = np.pad(part, ((0, lags), (0, 0)))
        sums += np.column_stack([np.correlate(a, b, 'valid') for a, b in zip(padded.T, part.T, strict=True)])
    return interval * np.arange(lags + 1.0), np.asarray(sums / np.maximum(sums[0], np.finfo(float).tiny))


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
        lines = [Line('', [low], COLOURS[0], style='band', upper=[high]), Line(name, [theta[:, k]], COLOURS[0])]
        within = (shown[0] - margin, shown[1] + margin) if margin > 0 else None
        panels.append(panel(name, UNITS[k], [t], lines, within))
    panels.append(panel('unexplained', 'N m', [t], [Line('', [np.array([s.unexplained for s in states])], MEASURED)]))
    spans = []
    for event in events:
        begin = max(event.begin, float(t[0]))
        end = max(event.end, begin + 0.003 * float(t[-1] - t[0]))  # wide enough to be seen
        changed = isinstance(event, Change)
        label = 'change' if changed else type(event).__name__.lower()
        spans.append(Span(begin, end, CHANGE if changed else VALIDATION, label))
    return Picture('track', TimePlot(panels, spans))


def _panels(height: float, rows: int, columns: int = 1, **shared: Any) -> tuple[Figure, NDArray[Any]]:
    """Return a figure, ``height`` inches high, and its axes, row by row."""
    figure = Figure(figsize=(COLUMN, height), layout='constrained')
    return figure, figure.subplots(rows, columns, squeeze=False, **shared).ravel()
