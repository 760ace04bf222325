"""Reading a bag: what is in it, and the motion of its joints in a window of time."""

from __future__ import annotations

import hashlib
import math
import os
import re
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Generic, TypeVar

import numpy as np
import yaml
from numpy.typing import NDArray

from pendubot_identification.errors import BagError, TrajectoryError
from pendubot_identification.trajectories.trajectory import MINIMUM_SAMPLES, Trajectory

from .bulk import Layout, Message, Samples
from .joint_states import JOINT_NAMES, JOINT_STATE, JOINT_STATES_TOPIC, JointState, decode_joint_state
from .mcap_file import McapFile

if TYPE_CHECKING:
    # Not for who only looks at a bag: scipy takes longer to import than the index of most to read.
    from pendubot_identification.trajectories.long import Recording

#: How far a message's stamp is looked for from where its log time would place it, before the whole bag is read [ns].
LATENCY_NS = 1_000_000_000

#: Samples of a long recording that are looked at together.
AT_ONCE = 4096
#: Longer than any bag [ns], and short enough to be added to a time.
FOREVER_NS = 2**63

Taken = TypeVar('Taken', bound='Recording', covariant=True)


@dataclass(frozen=True, slots=True)
class BagWindow:
    """A bag, and which part of it: START <= t < END in seconds from its first sample; None leaves a side open."""

    path: Path
    start: float | None = None
    end: float | None = None

    def __post_init__(self) -> None:
        for bound in (self.start, self.end):
            if bound is not None and not (math.isfinite(bound) and bound >= 0):
                raise BagError(
                    f'{self}: {bound:g} is no time in a bag; START and END are seconds from its first sample'
                )
        if self.start is not None and self.end is not None and not self.start < self.end:
            raise BagError(f'{self}: the window is empty or reversed; give START:END in seconds with START before END')

    @classmethod
    def parse(cls, text: str) -> BagWindow:
        """Return the window that ``BAG[@START:END]`` names; START or END may be left out, as in ``BAG@2:``.

        Raises:
            BagError: the text is malformed, or the window empty or reversed.
        """
        # A bag's own name may hold an @.
        if '@' not in text or os.path.exists(text):
            return cls(Path(text))
        path, _, window = text.rpartition('@')
        match = re.fullmatch(r'([^:]*):([^:]*)', window)
        if not (path and match):
            raise BagError(f'{text!r} names no window of a bag; BAG@START:END in seconds is expected, such as bag@0:9')
        try:
            start, end = (float(bound) if bound.strip() else None for bound in match.groups())
        except ValueError:
            raise BagError(
                f'{text!r}: START and END must be numbers of seconds; write it like bag@0:9, bag@9: or bag@:9'
            ) from None
        return cls(Path(path), start, end)

    def __str__(self) -> str:
        if self.start is None and self.end is None:
            return str(self.path)
        start, end = ('' if bound is None else f'{bound:.12g}' for bound in (self.start, self.end))
        return f'{self.path}@{start}:{end}'


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """A topic of a bag, its message type, and how many messages of it there are."""

    name: str
    type_name: str
    count: int


@dataclass(frozen=True, slots=True)
class BagInfo:
    """What is in a bag.

    Attributes:
        path: the bag's folder or file.
        files: its .mcap files in order.
        topics: by name.
        first_ns, last_ns: earliest and latest log time [ns since the epoch], None in an empty bag.
        closed: whether its recording came to an end.
        note: what could be read, in a sentence, where it did not; else empty.
    """

    path: Path
    files: tuple[Path, ...]
    topics: tuple[TopicInfo, ...]
    first_ns: int | None
    last_ns: int | None
    closed: bool
    note: str

    @property
    def duration(self) -> float:
        """Seconds from the first to the last message."""
        return 0.0 if self.first_ns is None or self.last_ns is None else (self.last_ns - self.first_ns) / 1e9

    @property
    def count(self) -> int:
        """The number of messages on all topics."""
        return sum(topic.count for topic in self.topics)


@dataclass(frozen=True)
class RecordedTrajectory(Generic[Taken]):
    """A motion from a bag, and what a result must say of that bag.

    Attributes:
        trajectory: t [s] from the bag's first sample on the topic, by ``header.stamp``; or what stands for a motion
            that is too long to be held.
        window: which part of which bag it is.
        sha256: of the bag's .mcap files, one after the other.
        closed: whether the bag's recording came to an end.
        note: what could be read, in a sentence, where it did not; else empty.
    """

    trajectory: Taken
    window: BagWindow
    sha256: str
    closed: bool
    note: str


class BagReader:
    """A bag folder or a single .mcap file, closed or not; what metadata.yaml counts is never relied upon.

    Raises:
        BagError: there is no such bag, it is none, or it cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        self._hash: str | None = None
        self._files, unread = _open_all(_mcap_files(self.path))
        topics: dict[str, TopicInfo] = {}
        for file in self._files:
            for name, (type_name, count) in file.topics.items():
                before = topics[name].count if name in topics else 0
                topics[name] = TopicInfo(name, type_name, before + count)
        self.info = BagInfo(
            path=self.path,
            files=tuple(file.path for file in self._files),
            topics=tuple(topics[name] for name in sorted(topics)),
            first_ns=min((file.first_ns for file in self._files if file.first_ns is not None), default=None),
            last_ns=max((file.last_ns for file in self._files if file.last_ns is not None), default=None),
            closed=all(file.closed for file in self._files) and not unread,
            note='; '.join([*(file.note for file in self._files if file.note), *unread]),
        )

    @property
    def files(self) -> list[McapFile]:
        """The bag's files in order."""
        return self._files

    def is_long(self, topic: str, duration: float) -> bool:
        """Tell whether about so many seconds of a topic are too many samples to be held."""
        from pendubot_identification.trajectories.long import is_long

        count = sum(t.count for t in self.info.topics if t.name == topic)
        return self.info.duration > 0 and is_long(count * duration / self.info.duration, duration)

    def content_hash(self) -> str:
        """Return the SHA-256 of the bag's .mcap files, one after the other, in hexadecimal."""
        if self._hash is None:
            digest = hashlib.sha256()
            for file in self._files:
                with file.path.open('rb') as stream:
                    while block := stream.read(1 << 20):
                        digest.update(block)
            self._hash = digest.hexdigest()
        return self._hash

    def joint_samples(
        self, topic: str, joint_names: Sequence[str], start: float | None = None, end: float | None = None
    ) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the samples of two joints with START <= t < END.

        Returns:
            t [ns] from the bag's first sample on the topic by ``header.stamp``, shape (N,); and position [rad],
            effort [N m] and velocity [rad/s], NaN where there is none, shape (N, 3, 2).

        Raises:
            BagError: the topic or a joint is not there or without position or effort, or a part that is needed is
                damaged.
        """
        stream = self.stream(topic, joint_names, start, end)
        while True:
            # Arrays of the standard library grow in place, and are not copied to become numpy's.
            times, values = array('q'), array('d')
            for elapsed_ns, block in stream:
                times.frombytes(elapsed_ns.tobytes())
                values.frombytes(block.tobytes())
            if not stream.missed():
                return np.frombuffer(times, dtype=np.int64), np.frombuffer(values).reshape(-1, 3, 2)

    def stream(
        self, topic: str, joint_names: Sequence[str], start: float | None = None, end: float | None = None
    ) -> Stream:
        """Return the same samples, block by block, to be read again and again.

        Raises:
            BagError: the topic is not there.
        """
        self._require(topic)
        return Stream(self, topic, joint_names, start, end)

    def blocks(
        self, topic: str, joint_names: Sequence[str], from_ns: int, until_ns: int
    ) -> Iterator[Samples | Message]:
        """Return the topic's messages of these log times, as many at once as are laid out alike."""
        for file in self._files:
            first, channel = next(file.messages(topic), None), file.channel(topic)
            if first is None:
                continue
            layout = None if channel is None else Layout.of(first.data, channel, joint_names)
            chunks = None if layout is None else file.chunks(topic, max(from_ns, 0), until_ns)
            if layout is None or chunks is None:
                for message in file.messages(topic, from_ns, until_ns):
                    yield Message(message.log_time, message.data)
                continue
            for block in chain.from_iterable(map(layout.read, chunks)):
                if isinstance(block, Message):
                    if from_ns <= block.log_ns < until_ns:
                        yield block
                    continue
                within = (from_ns <= block.log_ns) & (block.log_ns < until_ns)
                if within.any():
                    yield block.part(within)

    def first(self, topic: str) -> tuple[int, JointState]:
        """Return the first message of a topic that there is, and its log time [ns]."""
        message = next(message for file in self._files for message in file.messages(topic))
        return message.log_time, decode_joint_state(message.data)

    def _require(self, topic: str) -> None:
        if not self.info.count:
            raise BagError(f'{self.path} holds no message; record again while something is published')
        found = next((t for t in self.info.topics if t.name == topic), None)
        if found is None or not found.count:
            there = ', '.join(f'{t.name} [{t.type_name}]' for t in self.info.topics if t.count)
            raise BagError(
                f'{self.path} holds nothing on {topic}; its topics are {there}: name one of type {JOINT_STATE}'
            )
        if found.type_name != JOINT_STATE:
            raise BagError(f'{self.path}: {topic} is of type {found.type_name}; name a topic of type {JOINT_STATE}')


class Stream:
    """The samples of two joints with START <= t < END, read anew at every iteration.

    Iterating gives blocks, each of t [ns] from the bag's first sample, shape (N,), and values, shape (N, 3, 2), as
    :meth:`BagReader.joint_samples` returns them.
    """

    def __init__(
        self, reader: BagReader, topic: str, joint_names: Sequence[str], start: float | None, end: float | None
    ) -> None:
        self._reader, self._topic, self._joint_names = reader, topic, joint_names
        self._from_start = start is None
        self._low = 0 if start is None else round(min(start * 1e9, FOREVER_NS))
        self._high = FOREVER_NS if end is None else round(min(end * 1e9, FOREVER_NS))
        # The index is of log times. Stamps are a latency older, so a little more is read; and where it turns out that
        # they are of quite another clock, everything.
        self._margin = LATENCY_NS
        self._missed = False

    def __iter__(self) -> Iterator[tuple[NDArray[np.int64], NDArray[np.float64]]]:
        reader, low, high = self._reader, self._low, self._high
        logged_ns, first = reader.first(self._topic)
        earliest, latest, count = FOREVER_NS, -FOREVER_NS, 0
        until_ns = logged_ns + high + self._margin
        for block in reader.blocks(self._topic, self._joint_names, logged_ns + low - self._margin, until_ns):
            if isinstance(block, Samples):
                stamps, values = block.stamp_ns, block.values
            else:
                state = decode_joint_state(block.data)
                where = f'{reader.path}: sample {count} of {self._topic}'
                stamps = np.array([state.stamp_ns])
                values = np.array(_of_joints(state, self._joint_names, where)).reshape(1, 3, 2)
            elapsed_ns = stamps - first.stamp_ns
            earliest, latest = min(earliest, int(elapsed_ns.min())), max(latest, int(elapsed_ns.max()))
            # With no START, stamps that run back beyond the first are there to be complained of.
            wanted = elapsed_ns < high if self._from_start else (low <= elapsed_ns) & (elapsed_ns < high)
            count += int(wanted.sum())
            yield elapsed_ns[wanted], values[wanted]
        self._missed = not (earliest <= low and (latest >= high or until_ns > (reader.info.last_ns or 0)))

    def missed(self) -> bool:
        """Tell whether the last reading may have missed samples; if so, the next one misses none."""
        missed = self._missed and self._margin < FOREVER_NS
        if missed:
            self._margin = FOREVER_NS
        return missed

    def trajectories(self, name: str) -> Iterator[Trajectory]:
        """Return the same as motions without velocities, of a few thousand samples each."""
        waiting: list[tuple[NDArray[np.int64], NDArray[np.float64]]] = []
        count = 0

        def together() -> Trajectory:
            times, values = (np.concatenate(parts) for parts in zip(*waiting, strict=True))
            return Trajectory(times / 1e9, values[:, 0], values[:, 1], name=name)

        for block in self:
            waiting.append(block)
            count += len(block[0])
            if count >= AT_ONCE:
                yield together()
                waiting, count = [], 0
        if count:
            yield together()


def read_recording(
    window: BagWindow,
    *,
    topic: str = JOINT_STATES_TOPIC,
    joint_names: Sequence[str] = JOINT_NAMES,
    reader: BagReader | None = None,
) -> RecordedTrajectory[Recording]:
    """Read the motion of two joints from a window of a bag; what is too long to be held is read through once.

    Args:
        window: the bag, and which part of it.
        topic: as in :func:`read_trajectory`.
        joint_names: as in :func:`read_trajectory`.
        reader: of the bag, where there is one already.

    Raises:
        BagError: as :func:`read_trajectory`.
        TrajectoryError: as :func:`read_trajectory`; a long recording with gaps.
    """
    from pendubot_identification.trajectories.long import Long

    reader = reader or BagReader(window.path)
    duration = min(window.end or math.inf, reader.info.duration) - (window.start or 0.0)
    long = None
    stream = reader.stream(topic, joint_names, window.start, window.end)
    while reader.is_long(topic, duration):
        long = Long.survey(
            str(window),
            lambda: stream.trajectories(str(window)),
            duration,
            lambda begin, end: str(BagWindow(window.path, begin, end)),
        )
        if not stream.missed():
            break
    if long is None:
        # Other topics may have lasted longer.
        return read_trajectory(window, topic=topic, joint_names=joint_names, reader=reader)
    return RecordedTrajectory(long, window, reader.content_hash(), reader.info.closed, reader.info.note)


def read_trajectory(
    window: BagWindow | Path,
    *,
    topic: str = JOINT_STATES_TOPIC,
    joint_names: Sequence[str] = JOINT_NAMES,
    minimum: int = MINIMUM_SAMPLES,
    reader: BagReader | None = None,
) -> RecordedTrajectory[Trajectory]:
    """Read the motion of two joints from a window of a bag.

    Args:
        window: the bag, and which part of it.
        topic: of type ``sensor_msgs/msg/JointState``.
        joint_names: the shoulder's and the elbow's; messages may hold them in any order, among others.
        minimum: fewer samples than this are refused.
        reader: of the bag, where there is one already.

    Raises:
        BagError: the bag, the topic or a joint is not there, or without effort or position.
        TrajectoryError: the window holds no or too few samples; values that are not finite; stamps that repeat or
            run backwards.
    """
    if isinstance(window, Path):
        window = BagWindow(window)
    reader = reader or BagReader(window.path)
    elapsed_ns, values = reader.joint_samples(topic, joint_names, window.start, window.end)
    if not len(values):
        raise TrajectoryError(
            f'{window}: the window holds no sample; the bag lasts {reader.info.duration:.3f} s: choose a time within it'
        )
    # A velocity is a convenience that not every message need hold.
    known = bool(np.isfinite(values[:, 2]).all())
    t = elapsed_ns / 1e9
    del elapsed_ns  # of an hour at 1 kHz all of this is 0.2 GB
    trajectory = Trajectory(
        t=t,
        q=values[:, 0],
        tau=values[:, 1],
        qd=values[:, 2] if known else None,
        name=str(window),
    ).require_samples(minimum)
    return RecordedTrajectory(trajectory, window, reader.content_hash(), reader.info.closed, reader.info.note)


def _of_joints(state: JointState, joint_names: Sequence[str], where: str) -> list[float]:
    """Return position, effort and velocity (NaN where there is none) of the two joints."""
    n = len(state.names)
    try:
        joints = [state.names.index(name) for name in joint_names]
    except ValueError:
        missing = next(name for name in joint_names if name not in state.names)
        there = ', '.join(state.names) or 'none'
        raise BagError(f'{where} has no joint {missing!r}; its joints are {there}: name two of these') from None
    if len(state.position) != n:
        raise BagError(f'{where} has {len(state.position)} positions for {n} joints; each joint needs one')
    if len(state.effort) != n:
        raise BagError(
            f'{where} has {len(state.effort)} efforts for {n} joints; each joint needs one, 0 where it is not driven'
        )
    velocity = [state.velocity[j] for j in joints] if len(state.velocity) == n else [math.nan, math.nan]
    return [*(state.position[j] for j in joints), *(state.effort[j] for j in joints), *velocity]


def _mcap_files(path: Path) -> list[Path]:
    """Return the .mcap files of a bag, in order.

    Raises:
        BagError: there is no such bag, it is none, or it may not be read.
    """
    # Path's own methods raise where a name is too long or a folder above is closed.
    if os.path.isfile(path):
        return [path]
    try:
        found = {name: path / name for name in os.listdir(path) if name.endswith('.mcap')}
    except PermissionError as error:
        raise BagError(
            f'{path} cannot be read: {error.strerror}; check the permissions of this folder and of those above'
        ) from error
    except OSError:
        raise BagError(f'there is no bag {path}; give a bag folder or a .mcap file') from None
    listed = _listed_files(path)
    # Splits are numbered, NAME_0.mcap to NAME_10.mcap; metadata.yaml may be missing or stale.
    names = listed if listed and found.keys() >= set(listed) else sorted(found, key=lambda name: (len(name), name))
    if not names:
        raise BagError(
            f'{path} is no bag that can be read here: it holds no .mcap file; give a bag recorded with storage mcap '
            '(ros2 bag convert makes one of any other)'
        )
    return [found[name] for name in names]


def _open_all(paths: list[Path]) -> tuple[list[McapFile], list[str]]:
    """Return the files of a bag that can be read, and of the others why not.

    Raises:
        BagError: none can.
    """
    files, unread = [], []
    for path in paths:
        try:
            files.append(McapFile(path))
        except BagError as error:
            # A power cut may leave the last of several files empty.
            if path == paths[-1] and not files:
                raise
            unread.append(str(error))
    return files, unread


def _listed_files(path: Path) -> list[str]:
    try:
        metadata = yaml.safe_load((path / 'metadata.yaml').read_text(encoding='utf-8'))
        return [PurePath(name).name for name in metadata['rosbag2_bagfile_information']['relative_file_paths']]
    except (OSError, ValueError, TypeError, KeyError, yaml.YAMLError):
        return []
