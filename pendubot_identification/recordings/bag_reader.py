# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Reading a bag: what is in it, and the motion of its joints in a window of time."""

from __future__ import annotations

import hashlib
import math
import os
import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.errors import BagError, LongRecordingError, TrajectoryError
from pendubot_identification.trajectories.conversion import Conversion
from pendubot_identification.trajectories.trajectory import Trajectory

from .joint_states import JOINT_NAMES, JOINT_STATE, JOINT_STATES_TOPIC, JointDecoder, decode_joint_state
from .mcap_file import FOREVER_NS, McapFile, Messages
from .table_reader import TableReader
from .tables import is_table

#: How far a message's stamp is looked for from where its log time would place it, before the whole bag is read [ns].
LATENCY_NS = 1_000_000_000
#: No recording is taken at once that lasts longer than the first [s], or with more than so many samples than the last.
LONGEST, MANY, LONGEST_OF_MANY = 600.0, 200_000, 180.0
#: What of such a recording is usually enough [s].
ENOUGH = 60.0
#: A window may end so long after the last sample without a warning [s]: one sampling interval, or a rounded duration.
LATE_END = 0.1


@dataclass(frozen=True, slots=True)
class BagWindow:
    """A bag, and which part of it: START <= t < END in seconds from its first sample; None leaves a side open."""

    path: Path
    start: float | None = None
    end: float | None = None

    def __post_init__(self) -> None:
        for bound in (self.start, self.end):
            if bound is not None and not 0 <= bound < math.inf:
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

    def of(self, motion: Trajectory) -> Trajectory:
        """Return what of a motion, t [s] from the bag's first sample, lies in the window; it may be nothing."""
        return motion[(motion.t >= (self.start or 0.0)) & (motion.t < (self.end or math.inf))]

    def cut(self, last: float) -> str:
        """Return a warning if the window ends after the last sample, at ``last`` [s]; else nothing."""
        if self.end is None or self.end <= last + LATE_END:
            return ''
        return (
            f'{self} ends at {self.end:g} s, but its last sample is at {last:.3f} s: the samples up to there are used; '
            'check END, or whether the recording stopped early'
        )

    def __str__(self) -> str:
        if self.start is None and self.end is None:
            return str(self.path)
        start, end = ('' if bound is None else f'{bound:.12g}' for bound in (self.start, self.end))
        return f'{self.path}@{start}:{end}'


@dataclass(frozen=True)
class RecordedTrajectory:
    """A motion from a bag, t [s] from the bag's first sample on the topic, and what a result must say of that bag.

    ``sha256`` is of its .mcap files, one after the other; ``closed`` and ``note`` are as of :class:`BagReader`.
    """

    trajectory: Trajectory
    window: BagWindow
    sha256: str
    closed: bool
    note: str


class BagReader:
    """A bag folder or a single .mcap file, closed or not; what metadata.yaml says is not relied upon.

    Attributes:
        files: its .mcap files in order.
        topics: type and number of messages of each, by name.
        first_ns, last_ns: earliest and latest log time [ns since the epoch], 0 in an empty bag.
        closed: whether its recording came to an end.
        note: what could be read, in a sentence, where it did not; else empty.

    Raises:
        BagError: there is no such bag, it is none, or it cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        self.files, unread = _opened(self.path)
        topics: dict[str, tuple[str, int]] = {}
        for file in self.files:
            for name, (type_name, count) in file.topics.items():
                topics[name] = type_name, topics.get(name, ('', 0))[1] + count
        self.topics = dict(sorted(topics.items()))
        self.first_ns = min((file.first_ns for file in self.files if file.first_ns is not None), default=0)
        self.last_ns = max((file.last_ns for file in self.files if file.last_ns is not None), default=0)
        self.closed = all(file.closed for file in self.files) and not unread
        self.note = '; '.join([*(file.note for file in self.files if file.note), *unread])

    @property
    def duration(self) -> float:
        """Seconds from the first to the last message."""
        return (self.last_ns - self.first_ns) / 1e9

    @property
    def count(self) -> int:
        """The number of messages on all topics."""
        return sum(count for _, count in self.topics.values())

    @cached_property
    def content_hash(self) -> str:
        """The SHA-256 of the bag's .mcap files, one after the other, in hexadecimal."""
        digest = hashlib.sha256()
        for file in self.files:
            with file.path.open('rb') as stream:
                while block := stream.read(1 << 20):
                    digest.update(block)
        return digest.hexdigest()

    def messages(self, topics: Collection[str], start_ns: int = 0, end_ns: int = FOREVER_NS) -> Iterator[Messages]:
        """Return the messages of some topics with START <= log time < END [ns], many at once, in the order of writing.

        Raises:
            BagError: a part of a closed file is damaged.
        """
        for file in self.files:
            yield from file.messages(topics, start_ns, end_ns)


class Stream:
    """The samples of two joints with START <= t < END, read anew at every iteration.

    Efforts are those of ``effort_names``, by default of the joints themselves.

    Iterating gives blocks, each of t [ns] from the bag's first sample on the topic by ``header.stamp``, shape (N,), and
    of position [rad], effort [N m] and velocity [rad/s], NaN where there is none, shape (N, 3, 2).

    Raises:
        BagError: the topic is not there or not of JointStates; when read, a joint is missing or has no position or
            effort, or a part that is needed is damaged.
    """

    def __init__(
        self,
        reader: BagReader,
        topic: str,
        joint_names: Sequence[str],
        start: float | None = None,
        end: float | None = None,
        *,
        effort_names: Sequence[str] | None = None,
    ) -> None:
        _require(reader, topic)
        self._reader, self._topic, self._joint_names, self._effort_names = reader, topic, joint_names, effort_names
        self._from_start = start is None
        self._low = round(min((start or 0.0) * 1e9, FOREVER_NS))
        self._high = FOREVER_NS if end is None else round(min(end * 1e9, FOREVER_NS))
        # The index is of log times. Stamps are a latency older, so a little more is read; and where it turns out that
        # they are of quite another clock, everything.
        self._margin = LATENCY_NS
        self._missed = False

    def __iter__(self) -> Iterator[tuple[NDArray[np.int64], NDArray[np.float64]]]:
        low, high, topics = self._low, self._high, [self._topic]
        first = next(iter(next(self._reader.messages(topics))))
        first_ns = decode_joint_state(first.data).stamp_ns
        decode = JointDecoder(self._joint_names, f'{self._reader.path}: {self._topic}', self._effort_names)
        from_ns, until_ns = first.log_time + low - self._margin, first.log_time + high + self._margin
        earliest, latest = FOREVER_NS, -FOREVER_NS
        for messages in self._reader.messages(topics, max(from_ns, 0), min(until_ns, FOREVER_NS)):
            stamps, values = decode(messages)
            elapsed_ns = stamps - first_ns
            earliest, latest = min(earliest, int(elapsed_ns.min())), max(latest, int(elapsed_ns.max()))
            # With no START, stamps that run back beyond the first are there to be complained of.
            wanted = elapsed_ns < high if self._from_start else (low <= elapsed_ns) & (elapsed_ns < high)
            if wanted.any():
                yield elapsed_ns[wanted], values[wanted]
        self._missed = not (earliest <= low and (latest >= high or until_ns > self._reader.last_ns))

    def missed(self) -> bool:
        """Tell whether the last reading may have missed samples; if so, the next one misses none."""
        missed = self._missed and self._margin < FOREVER_NS
        if missed:
            self._margin = FOREVER_NS
        return missed

    def samples(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return all of them as one block; of what is too long, so many more than can be taken that it shows."""
        while True:
            times, values, count = list[NDArray[np.int64]](), list[NDArray[np.float64]](), 0
            for elapsed_ns, block in self:
                times.append(elapsed_ns)
                values.append(block)
                count += len(elapsed_ns)
                if is_long(count, min((elapsed_ns[-1] - times[0][0]) / 1e9, self._reader.duration)):
                    break
            else:
                if self.missed():
                    continue
            return np.concatenate([np.empty(0, np.int64), *times]), np.concatenate([np.empty((0, 3, 2)), *values])


Reader = BagReader | TableReader


def open_recording(path: Path, conversion: Conversion) -> Reader:
    """Return what reads a bag or a file with columns.

    Raises:
        BagError: there is no such bag, it is none, or it cannot be read.
    """
    return TableReader(path, conversion) if is_table(path) else BagReader(path)


def read_trajectory(
    window: BagWindow | Path,
    *,
    topic: str = JOINT_STATES_TOPIC,
    joint_names: Sequence[str] = JOINT_NAMES,
    conversion: Conversion | None = None,
    reader: Reader | None = None,
) -> RecordedTrajectory:
    """Read the motion of two joints from a window of a recording, or from all of it.

    Messages of a bag may hold the joints in any order, among others. ``conversion`` says what the numbers mean;
    ``reader`` is of the recording, where there is one already, and read alike.

    Raises:
        BagError: the bag, the topic or a joint is not there, or without effort or position.
        TableError: a file with columns cannot be read, or lacks one.
        TrajectoryError: the window holds no or too few samples; values that are not finite; stamps that repeat or
            run backwards.
        LongRecordingError: there is more in it than is taken at once.
    """
    window, conversion = BagWindow(window) if isinstance(window, Path) else window, conversion or Conversion()
    reader = reader or open_recording(window.path, conversion)
    if isinstance(reader, TableReader):
        motion = _of_table(reader, window)
    else:
        efforts = conversion.effort_names(joint_names)
        stream = Stream(reader, topic, joint_names, window.start, window.end, effort_names=efforts)
        motion = _of_bag(reader, window, stream, conversion)
    return RecordedTrajectory(motion, window, reader.content_hash, reader.closed, reader.note)


def is_long(samples: int, duration: float) -> bool:
    """Tell whether so many samples over so many seconds are more than are taken at once.

    Held, with all that is made of them, they would take hundreds of megabytes and minutes.
    """
    return duration > (LONGEST if samples <= MANY else LONGEST_OF_MANY)


def _require_short(window: BagWindow, t: NDArray[np.float64], duration: float) -> None:
    """Refuse a recording, of ``duration`` [s] altogether, that begins with samples at t [s], if it is too long.

    Raises:
        LongRecordingError: so it is.
    """
    # Stamps that jump are complained of by others.
    if not is_long(len(t), min(float(t[-1] - t[0]), duration)):
        return
    start = window.start or 0.0
    at_once = f'{LONGEST:g} s'
    if len(t) > MANY:
        at_once += f', or {LONGEST_OF_MANY:g} s of more than {MANY} samples,'
    lasts = min(window.end or np.inf, duration) - start
    raise LongRecordingError(
        f'{window} is too long: it lasts {lasts:.0f} s, and at most {at_once} are taken at once',
        str(window),
        str(BagWindow(window.path, window.start, start + ENOUGH)),
    )


def _of_bag(reader: BagReader, window: BagWindow, stream: Stream, conversion: Conversion) -> Trajectory:
    elapsed_ns, values = stream.samples()
    if not len(values):
        raise _nothing(window, reader.duration)
    t = elapsed_ns / 1e9
    _require_short(window, t, reader.duration)
    # A velocity is a convenience that not every message need hold.
    velocities = values[:, 2] if np.isfinite(values[:, 2]).all() else None
    return conversion.motion(t, values[:, 0], values[:, 1], velocities, str(window)).require_samples()


def _of_table(reader: TableReader, window: BagWindow) -> Trajectory:
    part = window.of(reader.motion)
    if not len(part):
        raise _nothing(window, reader.motion.duration)
    _require_short(window, part.t, reader.motion.duration)
    return replace(part, name=str(window)).require_samples()


def _nothing(window: BagWindow, duration: float) -> TrajectoryError:
    return TrajectoryError(
        f'{window}: the window holds no sample; the recording lasts {duration:.3f} s: choose a time within it'
    )


def _require(reader: BagReader, topic: str) -> None:
    """Refuse a topic without messages, or of another type."""
    there = {name: kind for name, (kind, count) in reader.topics.items() if count}
    if not there:
        raise BagError(f'{reader.path} holds no message; record again while something is published')
    if topic not in there:
        named = ', '.join(f'{name} [{kind}]' for name, kind in there.items())
        raise BagError(
            f'{reader.path} holds nothing on {topic}; its topics are {named}: name one of type {JOINT_STATE}'
        )
    if there[topic] != JOINT_STATE:
        raise BagError(f'{reader.path}: {topic} is of type {there[topic]}; name a topic of type {JOINT_STATE}')


def _opened(path: Path) -> tuple[list[McapFile], list[str]]:
    """Return the files of a bag in order, and of those that cannot be read, why not; BagError if that is all."""
    # Path's own methods raise where a name is too long or a folder above is closed.
    if os.path.isfile(path):
        return [McapFile(path)], []
    try:
        names = os.listdir(path)
    except PermissionError as error:
        raise BagError(
            f'{path} cannot be read: {error.strerror}; check the permissions of this folder and of those above'
        ) from error
    except OSError:
        raise BagError(f'there is no bag {path}; give a bag folder or a .mcap file') from None
    # Of one that was being compressed, the one that is not removed yet.
    found = {name.removesuffix('.zstd') for name in names if name.endswith(('.mcap', '.mcap.zstd'))}
    if not found:
        raise BagError(
            f'{path} is no bag that can be read here: it holds no .mcap file; give a bag recorded with storage mcap '
            '(ros2 bag convert makes one of any other)'
        )
    files, unread = list[McapFile](), list[str]()
    # They are numbered, NAME_0.mcap to NAME_10.mcap.
    for name in sorted(found, key=lambda name: (len(name), name)):
        try:
            files.append(McapFile(path / (name if name in names else f'{name}.zstd')))
        except BagError as error:
            unread.append(str(error))
    # A power cut may leave one empty, but not all.
    if not files:
        raise BagError(unread[0])
    return files, unread
