# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The tracker of a rig: its first motion starts the filter, and each further block is a step of it."""

import math
from collections.abc import Iterator

import numpy as np

from pendubot_identification.arrays import Array
from pendubot_identification.errors import ExcitationError, PendubotError
from pendubot_identification.model.parameters import MODELS, default_bounds
from pendubot_identification.trajectories.trajectory import Trajectory

from .blocks import STILL, Samples, SegmentSettings
from .events import Event, Lost, Start, State
from .following import Following, step
from .settings import TrackerSettings
from .start import start_following

#: Samples that are taken at once.
PORTION = 8192


class Tracker:
    """Follows a rig by its samples.

    Attributes:
        state: the newest parameters; None before tracking starts.
        reason: why it has not started yet, in a sentence.
    """

    def __init__(self, start: Start | None = None) -> None:
        self._settings = TrackerSettings()
        self._start = start or Start()
        self._bounds = default_bounds().of(MODELS[self._start.model])
        self._samples = Samples()
        self.state: State | None = None
        self.reset()

    def reset(self) -> None:
        """Start anew."""
        self._samples.clear()
        self._pause, self._attempted = self._settings.pause, -math.inf
        self._restart()

    def _restart(self) -> None:
        self._following: Following | None = None
        self.state, self.reason = None, f'{self._settings.first:g} s of motion without a gap are needed'

    @property
    def waiting(self) -> str:
        """What more samples are waited for, in a sentence; empty once a rig is followed."""
        return self.reason and f'{self.reason}; waiting for more motion'

    @property
    def segment_settings(self) -> SegmentSettings | None:
        """How samples become rows of the regression; None before tracking starts."""
        return None if self._following is None else self._following.segment

    @property
    def notes(self) -> dict[str, int]:
        """Faults of samples and their number."""
        return self._samples.notes

    def feed(self, samples: Array) -> Iterator[State | Event]:
        """Take samples, rows of t [s], q1, q2 [rad], tau1, tau2 [N m]; return states and events in order.

        Raises:
            PendubotError: the validation of the start does.
        """
        for begin in range(0, len(samples), PORTION):
            for _ in self._samples.append(samples[begin : begin + PORTION]):
                yield from self._follow()

    def _follow(self) -> Iterator[State | Event]:
        """Take the blocks that are complete."""
        if self._following is None:
            self._begin()
            yield from () if self._following is None else self._following.events
        while self._following is not None and (blocks := self._samples.take_blocks(self._following.segment)):
            for block in blocks:
                self._following, state = step(self._following, block)
                yield from self._following.events
                if any(isinstance(event, Lost) for event in self._following.events):
                    self._samples.clear()
                    self._restart()
                    return
                self.state = state
                yield state

    def _begin(self) -> None:
        """Start tracking at the first time at which the newest motion suffices."""
        s, t = self._settings, self._samples.newest[:, 0]
        if abs(t[0] - self._attempted) > s.longest_pause:
            self._pause, self._attempted = s.pause, -math.inf
        while self._following is None:
            due = max(t[0] + s.first, self._attempted + self._pause)
            newest = self._samples.newest = self._samples.newest[t > min(due, t[-1]) - s.longest_first]
            t = newest[:, 0]
            if t[-1] < due:
                return
            first, pause = newest[t <= due], self._pause
            # Attempts cost little, however often tracking restarts.
            self._attempted, self._pause = due, min(2 * pause, s.longest_pause)
            try:
                if (np.ptp(first[:, 1:3], axis=0) < STILL).all():
                    raise ExcitationError('nothing moves')
                motion = Trajectory(first[:, 0], first[:, 1:3], first[:, 3:5], name='the first motion')
                self._following = start_following(motion, self._start, self._bounds, s)
                self.reason = ''
            except PendubotError as error:
                self.reason = f'{np.ptp(first[:, 0]):.0f} s do not determine the parameters ({error})'
                if isinstance(error, ExcitationError):
                    self._pause = pause
