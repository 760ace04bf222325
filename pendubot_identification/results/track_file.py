# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Tracks the parameters of a rig through recordings; starts from a result file and ends with a result."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from pendubot_identification.errors import ResultError
from pendubot_identification.identification.estimate import Progress
from pendubot_identification.identification.pipeline import identify
from pendubot_identification.identification.settings import Settings
from pendubot_identification.level import NORMAL_95, Level
from pendubot_identification.model.parameters import MODELS, NAMES, UNITS
from pendubot_identification.recordings.bag_reader import BagWindow, open_recording, stream_samples
from pendubot_identification.tracking.blocks import SegmentSettings
from pendubot_identification.tracking.events import Change, Event, Start, State
from pendubot_identification.tracking.tracker import Tracker
from pendubot_identification.tracking.windows import InformativeWindows
from pendubot_identification.trajectories.conversion import Conversion
from pendubot_identification.trajectories.trajectory import Trajectory

from .result import EffortTiming, Parameter, Tracked, TrackedResult, known, read_result

#: Largest number of states in a track; above it, every second state is dropped.
KEPT = 4000
#: Time inserted between two recordings [s].
BETWEEN = 10.0


@dataclass
class Track:
    """The history of the parameters: states, thinned to at most :data:`KEPT`, events, notes and windows."""

    states: list[State] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)  #: remarks on the recordings.
    windows: list[str] = field(default_factory=list)  #: informative windows, BAG@START:END.
    _every: int = 1
    _seen: int = 0

    def add(self, update: State | Event) -> None:
        """Append a state or an event."""
        if not isinstance(update, State):
            self.events = [*self.events, update][-KEPT:]
            return
        if self._seen % self._every == 0:
            self.states.append(update)
        self._seen += 1
        if len(self.states) > KEPT:
            self.states, self._every = self.states[::2], 2 * self._every


def start_of(path: Path | None, model: str | None = None) -> Start:
    """Return the start of tracking: a result file, or a model alone.

    Without a file, an identification of the first motion by the criterion weak gives the level.

    Raises:
        ResultError: the file cannot be read, is of level ERROR, or has another model than requested.
        ParameterError: the file's parameters are not physical.
    """
    if path is None:
        chosen = model or 'coulomb'

        def assess(motion: Trajectory) -> tuple[Level, Sequence[str]]:
            found = identify([motion], (), Settings(criteria=('weak',), model=chosen, optimizer='lsq'))
            return found.level, found.warnings

        return Start(model=chosen, validate=assess)
    result = read_result(path)
    named = result.model if result.model in MODELS else result.theta.model
    if model not in (None, named):
        raise ResultError(f'{path} has the model {named}, but --model is {model}; leave one of the two out')
    if result.level is Level.ERROR:
        raise ResultError(f'{path} is of level ERROR: {"; ".join(result.warnings)}; begin with another result, or none')
    size = MODELS[named]
    # The filter's errors are normal, with the same 95 % interval.
    errors = {name: (e.std_error or 0.0) * e.quantile / NORMAL_95 for name, e in result.parameters.items()}
    level = Level.WARN if result.level is None else result.level
    warnings = [f'from the start {path}: {warning}' for warning in result.warnings]
    if result.level is None:
        warnings.append(f'the start {path} was never assessed')
    return Start(
        model=named,
        theta=result.theta.vector(named)[:size],
        std_error=np.array([errors.get(name, 0.0) for name in NAMES[:size]]),
        delays=(result.effort.delay, result.effort.delay),
        hold=result.effort.hold,
        validate=lambda motion: (level, warnings),
    )


def track_recordings(
    start: Start, windows: Sequence[BagWindow], conversion: Conversion, progress: Progress
) -> tuple[Tracker, Track]:
    """Track a rig through windows of recordings, one after the other, and return the tracker and its history.

    Raises:
        PendubotError: a recording cannot be read or tracked.
    """
    tracker, track, base = Tracker(start), Track(), 0.0
    for window in windows:
        reader, until, informative = open_recording(window.path, conversion), base, InformativeWindows()
        if reader.note:
            track.notes.append(f'{window}: {reader.note}')
        for samples in stream_samples(reader, window, conversion):
            informative.add(samples)
            samples[:, 0] += base
            until = max(until, float(samples[-1, 0]))
            progress(f'tracking {window}', round(until - base), 0, math.nan)
            for event in tracker.feed(samples):
                track.add(event)
                if not isinstance(event, State):
                    informative.happened(event, base)
        if until > base and (cut := window.cut(until - base)):
            track.notes.append(cut)
        track.windows += [str(BagWindow(window.path, *found)) for found in informative.best()]
        base = until + BETWEEN
    return tracker, track


def tracked_result(tracker: Tracker, track: Track, bags: Sequence[str]) -> TrackedResult | None:
    """Return the newest state as a result, with the history of the parameters; None if none are tracked at the end."""
    state = tracker.state
    if state is None or tracker.segment_settings is None:
        return None
    theta, errors = (known(np.transpose([getattr(s, name) for s in track.states])) for name in ('theta', 'std_error'))
    return TrackedResult(
        parameters=parameters(state),
        level=state.level,
        warnings=list(state.warnings),
        criterion='weak, tracked',
        model=tracker.segment_settings.model,
        effort=effort_timing(state, tracker.segment_settings),
        tracked=Tracked(
            bags=list(bags),
            until=known(state.t),
            notes=dict(tracker.notes),
            windows=track.windows,
            events=[_event(event) for event in track.events],
            t=known([s.t for s in track.states]),
            unexplained=known([s.unexplained for s in track.states]),
            values=dict(zip(state.names, theta, strict=True)),
            std_errors=dict(zip(state.names, errors, strict=True)),
        ),
    )


def _event(event: Event) -> dict[str, Any]:
    kind = event.kind if isinstance(event, Change) else type(event).__name__.lower()
    return {'kind': kind, **known(event._asdict()), 'text': str(event)}


def parameters(state: State) -> dict[str, Parameter]:
    """Return a state's parameters as entries of a result."""
    return {
        name: Parameter(
            value=float(value),
            std_error=known(error),
            interval=(known(value - NORMAL_95 * error), known(value + NORMAL_95 * error)),
            unit=unit,
            determined=bool(error < abs(value) / 2),
        )
        for name, value, error, unit in zip(state.names, state.theta, state.std_error, UNITS, strict=False)
    }


def effort_timing(state: State, segment: SegmentSettings) -> EffortTiming:
    """Return hold and delay of the effort."""
    return EffortTiming(hold=segment.hold, delay=known(state.delay), delay_std_error=known(state.delay_std_error))
