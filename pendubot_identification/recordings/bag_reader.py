# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Reads a bag: its topics and messages, and the motion of its joints in a window of time."""

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

from .joint_states import JOINT_NAMES, JOINT_STATE, JOINT_STATES_TOPIC, JointDecoder, decode_joint_state, stamp_of
from .mcap_file import FOREVER_NS, McapFile, Messages
from .table_reader import TableReader
from .tables import is_table

#: Largest expected difference of stamp and log time [ns]; beyond it, the whole bag is read.
LATENCY_NS = 1_000_000_000
#: Longest recording that is read at once [s]; the last holds for more than so many samples.
LONGEST, MANY, LONGEST_OF_MANY = 600.0, 200_000, 180.0
#: Length of the first window of a longer recording that its error message proposes [s].
ENOUGH = 60.0
#: A window may end this long after the last sample without a warning [s], as durations are rounded.
LATE_END = 0.1


@dataclass(frozen=True, slots=True)
class BagWindow:
    """A part of a bag: START <= t < END in seconds from its first sample; None leaves a side open."""

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
        """Return the samples of a motion, t [s] from the bag's first sample, in the window; there may be none."""
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
    """A motion from a bag, t [s] from the bag's first sample on the topic, and the bag's data for a result.

    ``sha256`` is of its .mcap files, one after the other; ``closed`` and ``note`` are as of :class:`BagReader`.
    """

    trajectory: Trajectory
    window: BagWindow
    sha256: str
    closed: bool
    note: str


class BagReader:
    """A bag folder or a single .mcap file, closed or not; metadata.yaml is not read.

    Attributes:
        files: its .mcap files in order.
        topics: type and number of messages of each, by name.
        first_ns, last_ns: earliest and latest log time [ns since the epoch], 0 in an empty bag.
        closed: whether all files were closed and can be read.
        note: for other bags, sentences about the intact messages; else empty.

    Raises:
        BagError: there is no such bag, or it cannot be read.
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
    """The samples of two joints in a window; each iteration reads them anew.

    Iterating gives blocks, each of t [ns] from the bag's first sample on the topic by ``header.stamp``, shape (N,), and
    of position [rad], effort [N m] and velocity [rad/s], NaN where there is none, shape (N, 3, 2). Efforts are those of
    ``effort_names``, by default of the joints themselves.

    Attributes:
        missed: whether the last iteration may have missed samples.

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
        self.missed = False

    def __iter__(self) -> Iterator[tuple[NDArray[np.int64], NDArray[np.float64]]]:
        return self._blocks(LATENCY_NS)

    def _blocks(self, margin_ns: int) -> Iterator[tuple[NDArray[np.int64], NDArray[np.float64]]]:
        """Read the window, and ``margin_ns`` around it by log time, the time of the index."""
        low, high, topics = self._low, self._high, [self._topic]
        first = next(iter(next(self._reader.messages(topics))))
        first_ns = stamp_of(decode_joint_state(first.data))
        decode = JointDecoder(self._joint_names, f'{self._reader.path}: {self._topic}', self._effort_names)
        from_ns, until_ns = first.log_time + low - margin_ns, first.log_time + high + margin_ns
        earliest, latest = FOREVER_NS, -FOREVER_NS
        for messages in self._reader.messages(topics, max(from_ns, 0), min(until_ns, FOREVER_NS)):
            stamps, values = decode(messages)
            elapsed_ns = stamps - first_ns
            earliest, latest = min(earliest, int(elapsed_ns.min())), max(latest, int(elapsed_ns.max()))
            # With no START, a trajectory reports stamps that run back beyond the first.
            wanted = elapsed_ns < high if self._from_start else (low <= elapsed_ns) & (elapsed_ns < high)
            if wanted.any():
                yield elapsed_ns[wanted], values[wanted]
        covered = earliest <= low and (latest >= high or until_ns > self._reader.last_ns)
        self.missed = margin_ns < FOREVER_NS and not covered

    def samples(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return all samples as one block; of a recording that is too long, enough samples to recognise that."""
        for margin_ns in (LATENCY_NS, FOREVER_NS):
            times, values, count = [np.empty(0, np.int64)], [np.empty((0, 3, 2))], 0
            self.missed = False
            for elapsed_ns, block in self._blocks(margin_ns):
                times.append(elapsed_ns)
                values.append(block)
                count += len(elapsed_ns)
                if is_long(count, min((elapsed_ns[-1] - times[1][0]) / 1e9, self._reader.duration)):
                    break
            if not self.missed:
                break
        return np.concatenate(times), np.concatenate(values)


Reader = BagReader | TableReader


def open_recording(path: Path, conversion: Conversion) -> Reader:
    """Return the reader of a bag or of a file with columns.

    Raises:
        BagError: there is no such bag, or it cannot be read.
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

    Messages of a bag may hold the joints in any order, among others. ``reader`` is the recording's reader, if it is
    open already.

    Raises:
        BagError: the bag, the topic or a joint is not there, or without effort or position.
        TableError: a file with columns cannot be read, or lacks one.
        TrajectoryError: the window holds no or too few samples; values that are not finite; stamps that repeat or
            run backwards.
        LongRecordingError: it is too long to be read at once.
    """
    window, conversion = BagWindow(window) if isinstance(window, Path) else window, conversion or Conversion()
    reader = reader or open_recording(window.path, conversion)
    if isinstance(reader, TableReader):
        motion, duration = replace(window.of(reader.motion), name=str(window)), reader.motion.duration
        t = motion.t
    else:
        elapsed_ns, values = _stream(reader, window, topic, joint_names, conversion).samples()
        t, duration = elapsed_ns / 1e9, reader.duration
    if not len(t):
        raise TrajectoryError(
            f'{window}: the window holds no sample; the recording lasts {duration:.3f} s: choose a time within it'
        )
    _require_short(window, t, duration)
    if not isinstance(reader, TableReader):
        # A velocity is optional in each message.
        velocities = values[:, 2] if np.isfinite(values[:, 2]).all() else None
        motion = conversion.motion(t, values[:, 0], values[:, 1], velocities, str(window))
    return RecordedTrajectory(motion.require_samples(), window, reader.content_hash, reader.closed, reader.note)


def stream_samples(
    reader: Reader, window: BagWindow, topic: str, joint_names: Sequence[str], conversion: Conversion
) -> Iterator[NDArray[np.float64]]:
    """Return rows of t [s] from the recording's first sample, q1, q2 [rad], tau1, tau2 [N m], many at a time.

    All samples of a bag come as they are: not finite, late, or out of order.

    Raises:
        BagError: the bag, the topic or a joint is not there; the window cannot be found in it.
        TableError: a file with columns cannot be read, or lacks one.
    """
    if isinstance(reader, TableReader):
        motion = window.of(reader.motion)
        if len(motion):
            yield np.column_stack([motion.t, motion.q, motion.tau])
        return
    stream = _stream(reader, window, topic, joint_names, conversion)
    Q, c, T, d = conversion.affine
    for elapsed_ns, values in stream:
        yield np.column_stack([elapsed_ns / 1e9, values[:, 0] @ Q.T + c, values[:, 1] @ T.T + d])
    if stream.missed:
        raise BagError(f'{window}: its stamps are of another clock than its log times; follow the whole bag')


def _stream(
    reader: BagReader, window: BagWindow, topic: str, joint_names: Sequence[str], conversion: Conversion
) -> Stream:
    efforts = conversion.effort_names(joint_names)
    return Stream(reader, topic, joint_names, window.start, window.end, effort_names=efforts)


def is_long(samples: int, duration: float) -> bool:
    """Tell whether so many samples over so many seconds [s] would take hundreds of megabytes and minutes."""
    return duration > (LONGEST if samples <= MANY else LONGEST_OF_MANY)


def _require_short(window: BagWindow, t: NDArray[np.float64], duration: float) -> None:
    """Raise LongRecordingError for too long a window, with samples at t [s], of a recording of ``duration`` [s]."""
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


def _require(reader: BagReader, topic: str) -> None:
    """Raise BagError for a topic without messages, or of another type."""
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
    """Return the readable files of a bag in order, and an error for each other one; BagError if none is readable."""
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
    # Compression of a file may have been interrupted: prefer the original.
    found = {name.removesuffix('.zstd') for name in names if name.endswith(('.mcap', '.mcap.zstd'))}
    if not found:
        raise BagError(
            f'{path} is no bag that can be read here: it holds no .mcap file; give a bag recorded with storage mcap '
            '(ros2 bag convert makes one of any other)'
        )
    files, unread = list[McapFile](), list[str]()
    # NAME_2.mcap comes before NAME_10.mcap.
    for name in sorted(found, key=lambda name: (len(name), name)):
        try:
            files.append(McapFile(path / (name if name in names else f'{name}.zstd')))
        except BagError as error:
            unread.append(str(error))
    # A power cut may leave one empty, but not all.
    if not files:
        raise BagError(unread[0])
    return files, unread
