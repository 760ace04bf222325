# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The plots over time of a report, and of a swing-up."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from pendubot_identification.criteria.prediction_error import STEP
from pendubot_identification.level import NORMAL_95
from pendubot_identification.model.parameters import NAMES, UNITS
from pendubot_identification.tracking.events import Change, Event, State
from pendubot_identification.trajectories.trajectory import Trajectory

from .figure_data import Residuals, Simulation, UnexplainedTorque
from .style import GREY, SMALL, rendered, style
from .time_plot import Line, Panel, Span, TimePlot

Array = NDArray[np.float64]

MEASURED, SIMULATED = '#1a1a1a', '#d55e00'
#: Of spans, and their opacity.
ESTIMATION, VALIDATION, CHANGE = '#56b4e92e', '#e69f002e', '#d55e002e'
#: Colours that can be told apart by everyone (Okabe and Ito).
COLOURS = ('#0072b2', '#d55e00', '#009e73', '#cc79a7')
STATES = (('q1', 'rad'), ('q2', 'rad'), ("q1'", 'rad/s'), ("q2'", 'rad/s'))


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

    def shift(self, name: str) -> float:
        """Return what to add to the times [s] of a recording, or of a part of it."""
        return self.shifts.get(_recording(name), 0.0)


def _recording(name: str) -> str:
    """Return the recording of a part with the name ``BAG@START:END``."""
    return name.rpartition('@')[0] or name


def plot_recordings(training: Sequence[Trajectory], validation: Sequence[Trajectory]) -> Picture:
    """Plot the torques and both angles, and which part estimates and which validates."""
    motions = [*training, *validation]
    timeline = Timeline.of(motions)
    times = [motion.t + timeline.shift(motion.name) for motion in motions]
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
    return Picture('recordings', TimePlot(panels, [*spans, *timeline.marks]), about)


def plot_simulation(simulation: Simulation, timeline: Timeline, *, validation: bool) -> Picture:
    """Plot measured states, states simulated from measured ones on, and their difference."""
    t, pieces = [simulation.t + timeline.shift(simulation.name)], simulation.simulated
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
    return Picture('simulation', TimePlot(panels, timeline.marks, live), about)


def plot_residuals(residuals: Residuals, timeline: Timeline) -> Picture:
    """Plot the residuals of a criterion."""
    times = [t + timeline.shift(name) for name, t, _ in residuals.parts]
    lines = [
        Line(channel, [y[:, k] for _, _, y in residuals.parts], COLOURS[k], 0.7)
        for k, channel in enumerate(residuals.names)
    ]
    plot = TimePlot([Panel('', residuals.unit, times, lines)], timeline.marks)
    return Picture(f'residuals_{residuals.criterion}', plot, {'cumulative': residuals.cumulative})


def plot_unexplained_torque(left: UnexplainedTorque, timeline: Timeline) -> Picture:
    """Plot the unexplained torque of both joints."""
    times = [t + timeline.shift(name) for name, t in zip(left.names, left.times, strict=True)]
    panels = [
        Panel(joint, 'N m', times, [Line('', [torque[:, k] for torque in left.torque], COLOURS[k], 0.7)])
        for k, joint in enumerate(('shoulder', 'elbow'))
    ]
    return Picture('torque_left', TimePlot(panels, timeline.marks))


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
