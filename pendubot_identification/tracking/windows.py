# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The informative windows of a long recording: much motion between two changes, without a gap or a disturbance."""

from collections import defaultdict

import numpy as np

from pendubot_identification.arrays import Array
from pendubot_identification.trajectories.signals import LONGEST_GAP

from .events import Disturbance, Event

#: Duration of a window and step between the times at which one may begin [s]; largest number of windows.
LENGTH, STEP, NAMED = 60, 10, 3
#: Smallest work in a window, as a fraction of the largest.
DRIVEN = 0.1


class InformativeWindows:
    """Selects windows by the work in each second of a recording, its faults and its changes."""

    def __init__(self) -> None:
        self._work = defaultdict[int, float](float)
        self._bad = set[int]()
        self._events: list[tuple[int, int]] = []
        self._changes: list[float] = []
        self._last = np.empty((0, 5))

    def add(self, samples: Array) -> None:
        """Add rows of t [s] from the first sample, q1, q2 [rad], tau1, tau2 [N m]."""
        rows = np.concatenate([self._last, samples])
        self._last = rows[-1:]
        steps, seconds = np.diff(rows, axis=0), np.floor(rows[:, 0]).astype(int)
        # Without a torque, the motion itself is the measure.
        work = (np.abs(steps[:, 1:3]) * (np.abs(rows[:-1, 3:5]) + 1e-9)).sum(axis=1)
        broken = ~(np.isfinite(work) & (steps[:, 0] > 0) & (steps[:, 0] <= LONGEST_GAP))
        self._bad.update(seconds[:-1][broken].tolist(), seconds[1:][broken].tolist())
        whole, number = np.unique(seconds[:-1], return_inverse=True)
        for second, done in zip(whole.tolist(), np.bincount(number, np.where(broken, 0.0, work)), strict=True):
            self._work[second] += float(done)

    def happened(self, event: Event, since: float) -> None:
        """Add an event of a tracker, whose time at the first sample was ``since`` [s]."""
        begin, end = max(event.begin - since, 0.0), event.end - since
        self._events.append((int(begin), int(end)))
        if not isinstance(event, Disturbance):
            self._changes.append(end)

    def best(self) -> list[tuple[int, int]]:
        """Return begin and end [s] of the windows with the most work between two changes, in the order of time."""
        between: dict[int, list[tuple[float, int]]] = {}
        # Stamps may jump by years, so only seconds with samples are examined.
        good = {s for s in self._work if s not in self._bad and not any(b <= s <= e for b, e in self._events)}
        for begin in sorted(second for second in good if second >= 0 and second % STEP == 0):
            seconds = range(begin, begin + LENGTH)
            if good.issuperset(seconds):
                work = sum(self._work[second] for second in seconds)
                between.setdefault(sum(change <= begin for change in self._changes), []).append((work, begin))
        # Select the longest time between two changes: it contains the most windows.
        longest = max(between.values(), key=len, default=[])
        longest.sort(reverse=True)
        chosen = list[int]()
        for work, begin in longest:
            if work >= DRIVEN * longest[0][0] and all(abs(begin - other) >= LENGTH for other in chosen):
                chosen.append(begin)
        return [(begin, begin + LENGTH) for begin in sorted(chosen[:NAMED])]
