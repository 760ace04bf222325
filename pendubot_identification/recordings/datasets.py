# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Divides recordings into training and validation, for the command line and the identifier."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import combinations

from pendubot_identification.errors import LongRecordingError, ParameterError, TrajectoryError
from pendubot_identification.identification.fitting import SETTINGS as FITTING
from pendubot_identification.trajectories.conventions import OF_FILES
from pendubot_identification.trajectories.conversion import Conversion, options
from pendubot_identification.trajectories.signals import resample
from pendubot_identification.trajectories.trajectory import Source, Trajectory

from .bag_reader import BagWindow, RecordedTrajectory, open_recording, read_trajectory
from .tables import is_table


@dataclass(frozen=True, slots=True)
class Datasets:
    """Motions for training and for validation, their sources, and notes for the user."""

    training: tuple[Trajectory, ...]
    validation: tuple[Trajectory, ...]
    sources: tuple[Source, ...]
    notes: tuple[str, ...]


def load_datasets(bags: Sequence[str], validate: Sequence[str] = (), conversion: Conversion | None = None) -> Datasets:
    """Read bags or files with columns, each ``BAG[@START:END]``, and divide them into training and validation.

    Without ``validate``, one bag without a window is halved. The parts of bags outside their windows are for
    validation, except parts shorter than a second; a long part gives its first minute. Several bags without windows
    are all for training.

    Raises:
        PendubotError: as :func:`.bag_reader.read_trajectory`.
    """
    conversion = conversion or Conversion()
    opened = cache(partial(open_recording, conversion=conversion))

    def read(window: BagWindow) -> RecordedTrajectory:
        return read_trajectory(window, conversion, opened(window.path))

    recorded = [read(window) for window in windows_of([*bags, *validate], conversion)]
    training, validation = recorded[: len(bags)], recorded[len(bags) :]
    windows = [each.window for each in training]
    if not validation and not all(window.start is None and window.end is None for window in windows):
        validation = [part for window in _rest(windows) if (part := _validation_part(window, read)) is not None]
    return divided(training, validation)


def divided(training: Sequence[RecordedTrajectory], validation: Sequence[RecordedTrajectory]) -> Datasets:
    """Return motions for training and validation, with sources and notes; a single one without a window is halved."""
    if not validation and len(training) == 1 and training[0].window == BagWindow(training[0].window.path):
        single, half = training[0], len(training[0].trajectory.require_samples()) // 2
        training = [replace(single, trajectory=single.trajectory[:half])]
        validation = [replace(single, trajectory=single.trajectory[half:])]
    pairs = [('training', r) for r in training] + [('validation', r) for r in validation]
    notes = [r.note for _, r in pairs if r.note]
    for (role, first), (_, second) in combinations(pairs, 2):
        starts, ends = zip(span(first.trajectory), span(second.trajectory), strict=True)
        if role == 'training' and first.sha256 == second.sha256 and max(starts) <= min(ends):
            notes.append(
                f'{first.window} and {second.window} share samples: they count twice, and standard errors and J on '
                'validation are too small'
            )
    sources = tuple(
        Source(str(r.window), role, len(r.trajectory), r.trajectory.duration, r.sha256, r.closed, r.taken_as)
        for role, r in pairs
    )
    trained, validated = (tuple(r.trajectory for r in part) for part in (training, validation))
    return Datasets(trained, validated, sources, tuple(dict.fromkeys(notes)))


def windows_of(texts: Sequence[str], conversion: Conversion) -> list[BagWindow]:
    """Parse the texts ``BAG[@START:END]`` of recordings.

    Raises:
        BagError: a text is malformed.
        ParameterError: the conversion has options of files with columns, and all recordings are bags.
    """
    windows = [BagWindow.parse(text) for text in texts]
    only = {name: word for name, word in conversion.words().items() if name in OF_FILES}
    if only and not any(is_table(window.path) for window in windows):
        raise ParameterError(
            f'{options(only)[0]} is for files with columns; the stamps of a bag are in nanoseconds, and its joints '
            'have names (--joints): leave it out'
        )
    return windows


def _validation_part(window: BagWindow, read: Callable[[BagWindow], RecordedTrajectory]) -> RecordedTrajectory | None:
    """Return a part outside of the windows, or None if it is too short for validation or has gaps."""
    try:
        try:
            recorded = read(window)
        except LongRecordingError as error:
            recorded = read(BagWindow.parse(error.first))
        resample(recorded.trajectory)
    except TrajectoryError:
        return None
    return recorded if recorded.trajectory.duration >= FITTING.shortest else None


def span(recording: Trajectory) -> tuple[float, float]:
    """Return the first and the last stamp [s]."""
    return float(recording.t[0]), float(recording.t[-1])


def _rest(windows: Sequence[BagWindow]) -> list[BagWindow]:
    """Return the parts of each bag outside all of its windows."""
    rest = []
    for path in dict.fromkeys(window.path for window in windows):
        spans = [(w.start or 0.0, w.end or math.inf) for w in windows if w.path == path]
        covered = 0.0
        for start, end in [*sorted(spans), (math.inf, math.inf)]:
            if start > covered:
                rest.append(BagWindow(path, covered or None, start if start < math.inf else None))
            covered = max(covered, end)
    return rest
