# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The tracker of a rig: a first motion starts the filter, and each further block updates it."""

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

#: Largest number of samples that are appended at once.
PORTION = 8192


class Tracker:
    """Estimates the current parameters of a rig from its samples.

    Attributes:
        state: the newest parameters; None before tracking starts.
        reason: the reason why tracking has not started.
    """

    def __init__(self, start: Start | None = None) -> None:
        self._settings = TrackerSettings()
        self._start = start or Start()
        self._bounds = default_bounds().of(MODELS[self._start.model])
        self._samples = Samples()
        self.state: State | None = None
        self.reset()

    def reset(self) -> None:
        """Restart tracking without any samples."""
        self._samples.clear()
        self._pause, self._attempted = self._settings.pause, -math.inf
        self._restart()

    def _restart(self) -> None:
        self._following: Following | None = None
        self.state, self.reason = None, f'{self._settings.first:g} s of motion without a gap are needed'

    @property
    def waiting(self) -> str:
        """The reason why more samples are needed, as a sentence; empty after tracking has started."""
        return self.reason and f'{self.reason}; waiting for more motion'

    @property
    def segment_settings(self) -> SegmentSettings | None:
        """The settings of the regression rows; None before tracking starts."""
        return None if self._following is None else self._following.segment

    @property
    def notes(self) -> dict[str, int]:
        """The count of each fault of samples."""
        return self._samples.notes

    def feed(self, samples: Array) -> Iterator[State | Event]:
        """Process samples, rows of t [s], q1, q2 [rad], tau1, tau2 [N m]; yield states and events in order.

        Raises:
            PendubotError: by the validation of the start.
        """
        for begin in range(0, len(samples), PORTION):
            for _ in self._samples.append(samples[begin : begin + PORTION]):
                yield from self._follow()

    def _follow(self) -> Iterator[State | Event]:
        """Process the complete blocks."""
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
        """Start tracking as soon as the newest motion determines the parameters."""
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
            # Growing pauses limit the cost of attempts.
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
