# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Which part of which bag estimates and which validates: the rules that command line and identifier share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

from pendubot_identification.errors import TrajectoryError
from pendubot_identification.identify.recipes import SHORTEST
from pendubot_identification.identify.result import Source
from pendubot_identification.trajectories.long import Long, Recording, gridded, sharing
from pendubot_identification.trajectories.trajectory import MINIMUM_SAMPLES, Trajectory

from .bag_reader import BagReader, BagWindow, RecordedTrajectory, read_recording
from .joint_states import JOINT_NAMES, JOINT_STATES_TOPIC


@dataclass(frozen=True, slots=True)
class Datasets:
    """Motions that estimate, motions that validate, where they came from, and what the user should know of that."""

    training: tuple[Recording, ...]
    validation: tuple[Recording, ...]
    sources: tuple[Source, ...]
    notes: tuple[str, ...]


def load_datasets(
    bags: Sequence[str],
    validate: Sequence[str] = (),
    *,
    topic: str = JOINT_STATES_TOPIC,
    joint_names: Sequence[str] = JOINT_NAMES,
) -> Datasets:
    """Read the bags, each ``BAG[@START:END]``, and divide them.

    Without ``validate``: of one bag without a window the first half estimates and the second validates; of bags with
    windows the rest validates, but for parts shorter than a second; of several bags without windows all estimate, and
    nothing is set apart.

    Raises:
        BagError: a bag that is missing or unreadable, or lacks the topic, the joints or their effort.
        TrajectoryError: a window that is empty or too short, or samples that cannot be used.
    """
    windows = [BagWindow.parse(text) for text in bags]
    read = _Reader(topic, joint_names)
    recordings = [read(window) for window in windows]
    judges = [read(BagWindow.parse(text)) for text in validate]
    alone = not judges and len(windows) == 1 and _whole(windows[0])
    if alone and isinstance(long := recordings[0].trajectory, Long):
        middle, path = round((long.start + long.last) / 2, 3), windows[0].path
        recordings, judges = [read(BagWindow(path, None, middle))], [read(BagWindow(path, middle, None))]
    training, validation = [r.trajectory for r in recordings], [r.trajectory for r in judges]
    if not judges:
        if alone and isinstance(whole := training[0], Trajectory):
            half = len(whole) // 2
            training, validation = [whole[:half]], [whole[half:]]
            judges = list(recordings)
        elif not all(map(_whole, windows)):
            judges = [r for window in _rest(windows) if (r := read.rest(window)) is not None]
            validation = [r.trajectory for r in judges]
    training, validation = sharing(training), sharing(validation)
    pairs = [('training', r, t) for r, t in zip(recordings, training, strict=True)]
    pairs += [('validation', r, t) for r, t in zip(judges, validation, strict=True)]
    notes = [r.note for _, r, _ in pairs if r.note]
    for (role, first, motion), (_, second, other) in combinations(pairs, 2):
        starts, ends = zip(span(motion), span(other), strict=True)
        if role == 'training' and first.sha256 == second.sha256 and max(starts) <= min(ends):
            notes.append(
                f'{first.window} and {second.window} share samples: they count twice, and standard errors and J on '
                'validation look better than they are'
            )
    sources = (
        Source(
            str(r.window),
            role,
            len(t),
            t.duration,
            r.sha256,
            r.closed,
            topic,
            list(joint_names),
            [round(float(s.t[0]), 3) for s in t.stretches] if isinstance(t, Long) else [],
        )
        for role, r, t in pairs
    )
    return Datasets(tuple(training), tuple(validation), tuple(sources), tuple(dict.fromkeys(notes)))


class _Reader:
    """Reads windows of bags, each of which is opened once."""

    def __init__(self, topic: str, joint_names: Sequence[str]) -> None:
        self._topic, self._joint_names = topic, joint_names
        self._opened: dict[Path, BagReader] = {}

    def __call__(self, window: BagWindow) -> RecordedTrajectory[Recording]:
        if window.path not in self._opened:
            self._opened[window.path] = BagReader(window.path)
        reader = self._opened[window.path]
        return read_recording(window, topic=self._topic, joint_names=self._joint_names, reader=reader)

    def rest(self, window: BagWindow) -> RecordedTrajectory[Recording] | None:
        """Return what lies outside the windows, or None where that is too little to judge by, or has gaps.

        Nobody chose it: what is too short for one of the criteria must not cost the result of all.
        """
        try:
            recording = self(window)
            gridded(recording.trajectory)
        except TrajectoryError:
            return None
        found = recording.trajectory
        return recording if len(found) >= MINIMUM_SAMPLES and found.duration >= SHORTEST else None


def span(recording: Recording) -> tuple[float, float]:
    """Return the first and the last stamp [s]."""
    if isinstance(recording, Long):
        return recording.start, recording.last
    return float(recording.t[0]), float(recording.t[-1])


def _whole(window: BagWindow) -> bool:
    return window.start is None and window.end is None


def _rest(windows: Sequence[BagWindow]) -> list[BagWindow]:
    """Return what each bag holds outside all of its windows."""
    rest = []
    for path in dict.fromkeys(window.path for window in windows):
        own = sorted((w.start or 0.0, w.end) for w in windows if w.path == path and not (w.end is None and not w.start))
        at = 0.0
        for start, end in own:
            if start > at:
                rest.append(BagWindow(path, at or None, start))
            at = float('inf') if end is None else max(at, end)
        if own and at < float('inf'):
            rest.append(BagWindow(path, at, None))
    return rest
