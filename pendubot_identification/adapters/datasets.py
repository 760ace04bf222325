"""Which part of which bag estimates and which validates: the rules that command line and identifier share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from pendubot_identification.core.errors import TrajectoryError
from pendubot_identification.core.signals import resample
from pendubot_identification.core.trajectory import MINIMUM_SAMPLES, Trajectory

from .bag_reader import BagWindow, RecordedTrajectory, read_trajectory
from .joint_states import JOINT_NAMES, JOINT_STATES_TOPIC


@dataclass(frozen=True, slots=True)
class Source:
    """What a result says of a bag it used."""

    bag: str
    role: str
    samples: int
    duration: float
    sha256: str
    closed: bool
    topic: str = JOINT_STATES_TOPIC
    joint_names: list[str] = field(default_factory=lambda: list(JOINT_NAMES))


@dataclass(frozen=True, slots=True)
class Datasets:
    """Motions that estimate, motions that validate, where they came from, and what the user should know of that."""

    training: tuple[Trajectory, ...]
    validation: tuple[Trajectory, ...]
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
    windows the rest validates; of several bags without windows all estimate, and nothing is set apart.

    Raises:
        BagError: a bag that is missing or unreadable, or lacks the topic, the joints or their effort.
        TrajectoryError: a window that is empty or too short, or samples that cannot be used.
    """
    windows = [BagWindow.parse(text) for text in bags]
    recordings = [_read(window, topic, joint_names) for window in windows]
    judges = [_read(BagWindow.parse(text), topic, joint_names) for text in validate]
    training = [r.trajectory for r in recordings]
    validation = [r.trajectory for r in judges]
    if not judges:
        if len(windows) == 1 and _whole(windows[0]):
            half = len(training[0]) // 2
            training, validation = [training[0][:half]], [training[0][half:]]
            judges = list(recordings)
        elif not all(map(_whole, windows)):
            judges = [r for window in _rest(windows) if (r := _read_rest(window, topic, joint_names)) is not None]
            validation = [r.trajectory for r in judges]
    pairs = [('training', r, t) for r, t in zip(recordings, training, strict=True)]
    pairs += [('validation', r, t) for r, t in zip(judges, validation, strict=True)]
    notes = [r.note for _, r, _ in pairs if r.note]
    for k, (role, first, motion) in enumerate(pairs):
        for _, second, other in pairs[k + 1 :]:
            common = first.sha256 == second.sha256 and motion.t[0] <= other.t[-1] and other.t[0] <= motion.t[-1]
            if common and role == 'training':
                notes.append(
                    f'{first.window} and {second.window} share samples: they count twice, and standard errors and J on '
                    'validation look better than they are'
                )
    sources = (
        Source(str(r.window), role, len(t), t.duration, r.sha256, r.closed, topic, list(joint_names))
        for role, r, t in pairs
    )
    return Datasets(
        training=tuple(training),
        validation=tuple(validation),
        sources=tuple(sources),
        notes=tuple(dict.fromkeys(notes)),
    )


def _read(window: BagWindow, topic: str, joint_names: Sequence[str]) -> RecordedTrajectory:
    return read_trajectory(window, topic=topic, joint_names=joint_names)


def _read_rest(window: BagWindow, topic: str, joint_names: Sequence[str]) -> RecordedTrajectory | None:
    """Return what lies outside the windows, or None where that is too little to judge by, or has gaps."""
    try:
        recording = _read(window, topic, joint_names)
        resample(recording.trajectory)
    except TrajectoryError:
        return None
    return recording if len(recording.trajectory) >= MINIMUM_SAMPLES else None


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
