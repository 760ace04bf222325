# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A rig that is followed: its first motion tells how to listen, every further block what is true now."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.errors import ExcitationError, PendubotError
from pendubot_identification.model.parameters import MODELS, Bounds, default_bounds
from pendubot_identification.trajectories.trajectory import Trajectory

from .blocks import Samples, SegmentSettings
from .events import Event, Lost, Start, State
from .following import Following
from .residuals import STILL
from .settings import TrackerSettings

Array = NDArray[np.float64]

#: Samples that are taken at once: little is lost of them where all begins anew; before it begins, so many seconds.
PORTION, FIRST_PORTION = 8192, 0.5


class Tracker:
    """Follows a rig by its samples.

    Attributes:
        state: what is true now; None as long as nothing is known.
        reason: why nothing is known yet, in a sentence.
    """

    def __init__(
        self, start: Start | None = None, bounds: Bounds | None = None, settings: TrackerSettings | None = None
    ) -> None:
        self._settings = settings or TrackerSettings()
        self._start = start or Start()
        self._bounds = (bounds or default_bounds()).of(MODELS[self._start.model])
        self._samples = Samples()
        self.state: State | None = None
        self.reset()

    def reset(self) -> None:
        """Forget all but how it began."""
        self._pause, self._attempted = self._settings.pause, math.nan
        self._restart()

    def _restart(self) -> None:
        self._samples.held = np.empty((0, 5))
        self._following: Following | None = None
        self.state, self.reason = None, f'{self._settings.first:g} s of motion without a gap are needed'

    @property
    def waiting(self) -> str:
        """What more samples are waited for, in a sentence; empty once a rig is followed."""
        return self.reason and f'{self.reason}; waiting for more motion'

    @property
    def segment_settings(self) -> SegmentSettings | None:
        """How samples are made weak-form residuals of, once that is known."""
        return None if self._following is None else self._following.segment_settings

    @property
    def notes(self) -> dict[str, int]:
        """What was wrong with samples, and how often."""
        return self._samples.notes

    def feed(self, samples: Array) -> Iterator[State | Event]:
        """Take samples, rows of t [s], q1, q2 [rad], tau1, tau2 [N m]; return what follows from them, in order.

        Raises:
            PendubotError: ``judge`` of the start does.
        """
        while len(samples):
            count = PORTION
            if self._following is None:
                # Up to a gap, if there is one: it may be enough.
                with np.errstate(invalid='ignore'):
                    later = np.abs(samples[:, 0] - samples[0, 0]) >= FIRST_PORTION
                count = int(np.argmax(later)) if later.any() else PORTION
            for gap in self._samples.append(samples[:count]):
                if gap and self._following is not None:
                    self._following.blocks.begin = math.nan
                yield from self._follow()
            samples = samples[count:]

    def _follow(self) -> Iterator[State | Event]:
        """Learn from what is held."""
        if self._following is None:
            self._begin()
        if self._following is None:
            return
        for block in self._following.blocks.complete(self._samples):
            for event in self._following.take(block):
                yield event
                if isinstance(event, Lost):
                    if abs(event.end - self._attempted) > self._settings.longest_pause:
                        self._pause = self._settings.pause
                    self._restart()
                    return
            self.state = self._following.state(block)
            yield self.state

    def _begin(self) -> None:
        """Begin to follow as soon as the first motion suffices."""
        held = self._samples.held
        held = self._samples.held = held[held[:, 0] >= held[-1, 0] - self._settings.longest_first]
        span, now = float(held[-1, 0] - held[0, 0]), float(held[-1, 0])
        if span < self._settings.first or 0 <= now - self._attempted < self._pause:
            return
        self._attempted, too_little = now, False
        try:
            if (np.ptp(held[:, 1:3], axis=0) < STILL).all():
                raise ExcitationError('nothing moves')
            motion = Trajectory(held[:, 0], held[:, 1:3], held[:, 3:5], name='the first motion')
            self._following, self.reason = Following(motion, self._start, self._bounds, self._settings), ''
        except PendubotError as error:
            too_little = isinstance(error, ExcitationError)
            self.reason = f'{span:.0f} s do not determine the parameters ({error})'
        if not too_little:
            # However often all begins anew, it costs little.
            self._pause = min(2 * self._pause, self._settings.longest_pause)
