# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Tracked parameters as a result file, and a result file as the start of tracking."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pendubot_identification import __version__
from pendubot_identification.errors import ResultError
from pendubot_identification.identify.pipeline import identify
from pendubot_identification.identify.result import SCHEMA, EffortTaken, Parameter
from pendubot_identification.identify.settings import Settings
from pendubot_identification.level import NORMAL_95, Level
from pendubot_identification.model.parameters import MODELS, UNITS
from pendubot_identification.tracking.blocks import SegmentSettings
from pendubot_identification.tracking.events import Change, Event, Start, State
from pendubot_identification.tracking.tracker import Tracker
from pendubot_identification.trajectories.trajectory import Trajectory

from .result_file import read_result, result_text

#: Largest number of states in a track; of more, every other one is dropped.
KEPT = 4000


@dataclass
class Track:
    """The history of the parameters: states, thinned out as they become many, events, notes and windows."""

    states: list[State] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)  #: on the recordings.
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

    Without a file, the first motion is identified by the criterion weak, which gives the level.

    Raises:
        ResultError: the file cannot be read, is of level ERROR, or another model is asked for than it has.
        ParameterError: its parameters are not physical.
    """
    if path is None:
        chosen = model or 'coulomb'
        return Start(model=chosen, validate=lambda motion: _assessed(motion, chosen))
    result = read_result(path)
    named = result.model if result.model in MODELS else result.theta.model
    if model not in (None, named):
        raise ResultError(f'{path} has the model {named}, and {model} is asked for; leave one of the two out')
    if result.level is Level.ERROR:
        raise ResultError(f'{path} is of level ERROR: {"; ".join(result.warnings)}; begin with another result, or none')
    size = MODELS[named]
    names = list(result.parameters)
    # The filter's errors are normal, with the same 95 % interval.
    errors = {name: (e.std_error or 0.0) * e.quantile / NORMAL_95 for name, e in result.parameters.items()}
    theta = result.theta.vector(named)[:size]
    level = Level.WARN if result.level is None else result.level
    why = [f'of {path}, with which it began: {warning}' for warning in result.warnings]
    if result.level is None:
        why.append(f'{path}, with which it began, was never judged')
    return Start(
        model=named,
        theta=theta,
        std_error=np.array([errors.get(name, 0.0) for name in names] + [0.0] * (size - len(names)))[:size],
        delays=(result.effort.delay, result.effort.delay),
        hold=result.effort.hold,
        validate=lambda motion: (level, why),
    )


def _assessed(motion: Trajectory, model: str) -> tuple[Level, Sequence[str]]:
    settings = Settings(criteria=('weak',), model=model, optimizer='lsq')
    found = identify([motion], (), settings)
    return found.level, found.warnings


def track_text(tracker: Tracker, track: Track, bags: Sequence[str]) -> str:
    """Return the newest state as a result file, with the events and the history of the parameters.

    Raises:
        ResultError: there is no state yet.
    """
    state = tracker.state
    if state is None or tracker.segment_settings is None:
        raise ResultError(f'there are no parameters to be written: {tracker.reason}')
    return result_text(
        {
            'schema': SCHEMA,
            'parameters': parameters(state),
            'level': state.level,
            'warnings': state.warnings,
            'criterion': 'weak, tracked',
            'model': tracker.segment_settings.model,
            'effort': effort_taken(state, tracker.segment_settings),
            'made_by': {'version': __version__},
            'tracked': {
                'bags': bags,
                'until': state.t,
                'notes': tracker.notes,
                'windows': track.windows,
                'events': [{'kind': kind_of(event), **event._asdict(), 'text': str(event)} for event in track.events],
                't': [s.t for s in track.states],
                'unexplained': [s.unexplained for s in track.states],
                'values': {n: [float(s.theta[k]) for s in track.states] for k, n in enumerate(state.names)},
                'std_errors': {n: [float(s.std_error[k]) for s in track.states] for k, n in enumerate(state.names)},
            },
        }
    )


def parameters(state: State) -> Mapping[str, Parameter]:
    """Return a state's parameters as they stand in a result."""
    return {
        name: Parameter(
            value=float(value),
            std_error=float(error),
            interval=(float(value - NORMAL_95 * error), float(value + NORMAL_95 * error)),
            unit=unit,
            determined=bool(error < abs(value) / 2),
        )
        for name, value, error, unit in zip(state.names, state.theta, state.std_error, UNITS, strict=False)
    }


def effort_taken(state: State, segment_settings: SegmentSettings) -> EffortTaken:
    """Return hold and delay of the effort."""
    return EffortTaken(hold=segment_settings.hold, delay=state.delay, delay_std_error=state.delay_std_error)


def kind_of(event: Event) -> str:
    """Return the type of an event in a word."""
    return event.kind if isinstance(event, Change) else type(event).__name__.lower()
