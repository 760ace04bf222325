# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Reads a bag: its topics and messages, and the motion of its joints in a time window."""

from __future__ import annotations

import math
import os
import weakref
from collections.abc import Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from pendubot_identification.arrays import Array, Indices
from pendubot_identification.errors import BagError, LongRecordingError, MissingFileError, TrajectoryError, noting
from pendubot_identification.files import content_hash
from pendubot_identification.trajectories.conversion import Conversion
from pendubot_identification.trajectories.trajectory import Trajectory

from .joint_states import JOINT_STATE, JointDecoder, decode_joint_state, stamp_of
from .mcap_file import FOREVER_NS, McapFile, Messages
from .table_reader import TableReader, without_repeats
from .tables import BLOCK, is_table


@dataclass(frozen=True, slots=True)
class ReadSettings:
    """Limits on recordings that are read at once; a longer one needs hundreds of megabytes and minutes."""

    longest: float = 600.0  #: Longest duration of a recording [s].
    many: int = 200_000  #: Number of samples above which ``longest_of_many`` applies.
    longest_of_many: float = 180.0  #: Longest duration of a recording with more than ``many`` samples [s].
    first_window: float = 60.0  #: Duration of the window that the error for a longer recording proposes [s].
    latency_ns: int = 1_000_000_000  #: Largest expected difference between stamp and log time [ns].
    late_end: float = 0.1  #: Largest time from the last sample to a window's end without a warning [s]: users round.

    def limit(self, samples: int) -> float:
        """Return the longest duration of a recording with this number of samples [s]."""
        return self.longest if samples <= self.many else self.longest_of_many


SETTINGS = ReadSettings()


@dataclass(frozen=True, slots=True)
class BagWindow:
    """A time window of a bag, START <= t < END [s] from its first sample; None leaves a side open."""

    path: Path
    start: float | None = None
    end: float | None = None

    def __post_init__(self) -> None:
        if not (0 <= (self.start or 0.0) < (math.inf if self.end is None else self.end) and self.end != math.inf):
            raise BagError(f'{self} names no window; seconds from the first sample are expected, START before END')

    @classmethod
    def parse(cls, text: str) -> BagWindow:
        """Return the window of a text ``BAG[@START:END]``; START or END may be omitted, as in ``BAG@2:``.

        Raises:
            BagError: the text is malformed, or the window empty or reversed.
        """
        # The name of a bag, and of a folder above it, may contain an @.
        if '@' not in os.path.basename(text) or os.path.exists(text):
            return cls(Path(text))
        path, _, window = text.rpartition('@')
        try:
            start, end = (float(bound) if bound.strip() else None for bound in window.split(':'))
        except ValueError:
            raise BagError(
                f'{text!r} names no window of a bag; BAG@START:END in seconds is expected, such as bag@0:9 or bag@9:'
            ) from None
        return cls(Path(path), start, end)

    @classmethod
    def named(cls, name: str) -> BagWindow:
        """Return the window in the name of a motion; all if the name of a lost file contains an @ and no window."""
        with suppress(BagError):
            return cls.parse(name)
        return cls(Path(name))

    def of(self, motion: Trajectory) -> Trajectory:
        """Return the samples of a motion in the window, possibly none; t [s] counts from the bag's first sample."""
        return motion[(motion.t >= (self.start or 0.0)) & (motion.t < (self.end or math.inf))]

    def cut(self, last: float) -> str:
        """Return a warning if the window ends after the last sample, at ``last`` [s], else an empty text."""
        if self.end is None or self.end <= last + SETTINGS.late_end:
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
    """A motion from a recording, with t [s] from its first sample, and the recording's metadata for a result."""

    trajectory: Trajectory
    window: BagWindow
    sha256: str  #: hash of the concatenated .mcap files or of the table.
    closed: bool  #: whether all files of the bag were closed.
    note: str  #: warnings, or empty.
    taken_as: str = ''  #: options inferred from the column names and units of a table.


class BagReader:
    """Reads a bag folder or a single .mcap file, closed or not; ignores metadata.yaml.

    Attributes:
        files: readable .mcap files in order.
        unread: error by path of each unreadable file.
        topics: message type and number of messages by topic.
        first_ns, last_ns: earliest and latest log time [ns since the epoch], 0 in an empty bag.
        converted: whether it is a bag of ROS 1 or with storage sqlite3, whose JointStates alone are read.
        closed: whether all files were closed and can be read.
        note: sentences about the intact messages if ``closed`` is false, else empty.

    Raises:
        BagError: the bag does not exist or cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        converted = _converted(self.path)
        self.converted = converted is not None
        if converted:
            weakref.finalize(self, converted.cleanup)
        self.files, self.unread = _opened(Path(converted.name, 'bag') if converted else self.path)
        topics: dict[str, tuple[str, int]] = {}
        for file in self.files:
            for name, (type_name, count) in file.topics.items():
                topics[name] = type_name, topics.get(name, ('', 0))[1] + count
        self.topics = dict(sorted(topics.items()))
        self.first_ns = min((file.first_ns for file in self.files if file.first_ns is not None), default=0)
        self.last_ns = max((file.last_ns for file in self.files if file.last_ns is not None), default=0)
        self.closed = all(file.closed for file in self.files) and not self.unread
        self.note = '; '.join([*(file.note for file in self.files if file.note), *self.unread.values()])

    @property
    def duration(self) -> float:
        """Time from the first to the last message [s]."""
        return (self.last_ns - self.first_ns) / 1e9

    @property
    def count(self) -> int:
        """The number of messages on all topics."""
        return sum(count for _, count in self.topics.values())

    @cached_property
    def content_hash(self) -> str:
        """The SHA-256 of the bag's concatenated .mcap files, in hexadecimal."""
        return content_hash(file.path for file in self.files)

    def messages(self, topics: Collection[str], start_ns: int = 0, end_ns: int = FOREVER_NS) -> Iterator[Messages]:
        """Yield the messages of each file in turn, like ``ros2 bag play``; see :meth:`McapFile.messages`."""
        for file in self.files:
            yield from file.messages(topics, start_ns, end_ns)


def joint_samples(reader: BagReader, window: BagWindow, conversion: Conversion) -> Iterator[tuple[Indices, Array]]:
    """Yield the samples of two joints in a window, in blocks; values and their order are not checked.

    Each block is t [ns] by ``header.stamp`` from the topic's first sample, shape (N,), and position, effort and
    velocity before the conversion, NaN if absent, shape (N, 3, 2). If stamps and log times run alike, only messages
    with log times at most :attr:`ReadSettings.latency_ns` outside the window are read.

    Raises:
        BagError: the topic is missing or has another type; a joint is missing or has no position or effort; a
            required part of the file is damaged.
    """
    topic = conversion.topic
    types = {name: kind for name, (kind, count) in reader.topics.items() if count}
    if types.get(topic) != JOINT_STATE:
        states = [name for name, kind in types.items() if kind == JOINT_STATE]
        advice = f'its topics are {", ".join(types)}: record the joint states, too'
        if states:
            advice = f'add --topic {states[0]}{"".join(f", or {name}" for name in states[1:])}'
        elif not types and reader.closed:
            advice = 'it is empty: record again while something is published'
        elif not types:
            advice = 'it is truncated or damaged, without an intact message: copy it again from the recorder'
        remedy = {'topic': states[0]} if len(states) == 1 else {}
        raise BagError(f'{reader.path} holds no {JOINT_STATE} on {topic}; {advice}', **remedy)
    low, high = (round(min(bound * 1e9, FOREVER_NS)) for bound in (window.start or 0.0, window.end or math.inf))
    first = next(iter(next(reader.messages([topic]))))
    first_ns = stamp_of(decode_joint_state(first.data, f'{reader.path}: {topic}, sample 0'))
    decode = JointDecoder(conversion.joints, f'{reader.path}: {topic}', conversion.effort_names)
    from_ns, until_ns = 0, FOREVER_NS
    if (low or high < FOREVER_NS) and (last := [*reader.messages([topic], reader.last_ns - SETTINGS.latency_ns)]):
        (final,) = last[-1].part(slice(-1, None))
        passed_ns = stamp_of(decode_joint_state(final.data, f'{reader.path}: {topic}, last sample')) - first_ns
        if abs(final.log_time - first.log_time - passed_ns) < SETTINGS.latency_ns:
            from_ns = first.log_time + low - SETTINGS.latency_ns
            until_ns = first.log_time + high + SETTINGS.latency_ns
    for messages in reader.messages([topic], max(from_ns, 0), min(until_ns, FOREVER_NS)):
        stamps, values = decode(messages)
        elapsed_ns = stamps - first_ns
        # Without START, stamps before the first one stay, so that the check of the trajectory reports them.
        wanted = elapsed_ns < high if window.start is None else (low <= elapsed_ns) & (elapsed_ns < high)
        if wanted.any():
            yield elapsed_ns[wanted], values[wanted]


Reader = BagReader | TableReader


def open_recording(path: Path, conversion: Conversion) -> Reader:
    """Return the reader of a bag or of a table. May raise BagError."""
    return TableReader(path, conversion) if is_table(path) else BagReader(path)


def read_trajectory(
    window: BagWindow | Path,
    conversion: Conversion | None = None,
    reader: Reader | None = None,
) -> RecordedTrajectory:
    """Read the motion of two joints from a recording or a window of it.

    Messages may list the joints in any order, among further joints. ``reader`` is the recording's reader, if it is
    open already.

    Raises:
        BagError: the bag, the topic or a joint is missing, or a joint has no effort or position.
        TableError: a table cannot be read, or lacks a column.
        TrajectoryError: the window holds no or too few samples; a value is not finite; stamps repeat or run backwards.
        LongRecordingError: the window is too long to be read at once.
    """
    window, conversion = BagWindow(window) if isinstance(window, Path) else window, conversion or Conversion()
    reader, taken_as, repeats = reader or open_recording(window.path, conversion), '', ''
    if isinstance(reader, TableReader):
        motion, taken_as = replace(window.of(reader.motion), name=str(window)), reader.taken_as
        _require_short(window, motion.t, reader.motion.duration)
    else:
        elapsed_ns, values = _collect(reader, window, conversion)
        _require_short(window, elapsed_ns / 1e9, reader.duration)
        new, repeats = without_repeats(elapsed_ns, str(window))
        elapsed_ns, values = elapsed_ns[new], values[new]
        # A velocity is optional in each message.
        velocities = values[:, 2] if np.isfinite(values[:, 2]).all() else None
        motion = conversion.motion(elapsed_ns / 1e9, values[:, 0], values[:, 1], velocities, str(window))
    notes = [*filter(None, [reader.note, repeats])]
    with noting(notes):
        end = float(motion.require_samples().t[-1])
    note = '; '.join(filter(None, [*notes, window.cut(end)]))
    return RecordedTrajectory(motion, window, reader.content_hash, reader.closed, note, taken_as)


def stream_samples(reader: Reader, window: BagWindow, conversion: Conversion) -> Iterator[Array]:
    """Yield blocks, shape (N, 5), of t [s] from the recording's first sample, q1, q2 [rad], tau1, tau2 [N m].

    Raises:
        BagError: as :func:`joint_samples`.
        TableError: a table cannot be read, or lacks a column.
    """
    if isinstance(reader, TableReader):
        motion = window.of(reader.motion)
        for k in range(0, len(motion), BLOCK):
            part = motion[k : k + BLOCK]
            yield np.column_stack([part.t, part.q, part.tau])
        return
    Q, c, T, d = conversion.affine
    before = np.empty((0, 2))  # the last angles of the block before
    for elapsed_ns, values in joint_samples(reader, window, conversion):
        q = values[:, 0]
        if conversion.unwrap:
            q = conversion.unwrapped(q, before)
            before = np.concatenate([before, q[np.isfinite(q).all(axis=1)]])[-1:]
        yield np.column_stack([elapsed_ns / 1e9, q @ Q.T + c, values[:, 1] @ T.T + d])


def _collect(reader: BagReader, window: BagWindow, conversion: Conversion) -> tuple[Indices, Array]:
    """Return the samples of a window as one block; reading stops as soon as they are too many or too long."""
    times, values, count = [np.empty(0, np.int64)], [np.empty((0, 3, 2))], 0
    for elapsed_ns, block in joint_samples(reader, window, conversion):
        times.append(elapsed_ns)
        values.append(block)
        count += len(elapsed_ns)
        if min((elapsed_ns[-1] - times[1][0]) / 1e9, reader.duration) > SETTINGS.limit(count):
            break
    return np.concatenate(times), np.concatenate(values)


def _require_short(window: BagWindow, t: Array, duration: float) -> None:
    """Raise TrajectoryError if a window of samples at t [s], from a recording of ``duration`` [s], is empty or long."""
    if not len(t):
        raise TrajectoryError(f'{window} holds no sample; choose a time within the {duration:.3f} s of the recording')
    start, longest = window.start or 0.0, SETTINGS.limit(len(t))
    if min(float(t[-1] - t[0]), duration) <= longest:
        return
    lasts = min(window.end or math.inf, duration) - start
    first = str(BagWindow(window.path, window.start, start + SETTINGS.first_window))
    error = LongRecordingError(
        f'{window} is too long: it lasts {lasts:.0f} s, and at most {longest:g} s are read at once; take windows of '
        f'it, such as {first}: pendubot track {window.path} lists informative ones'
    )
    error.first = first
    raise error


def _converted(path: Path) -> TemporaryDirectory[str] | None:
    """Convert the JointStates of a ROS 1 or sqlite3 bag to MCAP, in the folder ``bag``; return None for other paths."""
    if os.path.isdir(path):
        sources = [] if any(path.glob('*.mcap*')) else sorted(path.glob('*.db3'))
    else:
        sources = [path] if path.suffix in ('.bag', '.db3') and os.path.isfile(path) else []
    if not sources:
        return None
    # The recorder writes metadata.yaml when it closes a bag.
    folder = sources[0].parent
    if sources[0].suffix == '.db3' and (folder / 'metadata.yaml').exists():
        sources = [folder]
    from rosbags.convert import ConverterError, convert
    from rosbags.highlevel import AnyReaderError
    from rosbags.typesys import Stores, get_typestore

    target, jazzy = TemporaryDirectory(prefix='pendubot-'), get_typestore(Stores.ROS2_JAZZY)
    try:
        convert(sources, Path(target.name, 'bag'), 'mcap', 9, None, 'none', jazzy, jazzy, [], [], [], [JOINT_STATE])
    except (ConverterError, AnyReaderError, OSError, ValueError) as error:
        target.cleanup()
        raise BagError(
            f'{path} is no bag with messages of type {JOINT_STATE} that can be read ({error}); look at it with '
            'rosbag info or ros2 bag info'
        ) from error
    return target


def _opened(path: Path) -> tuple[list[McapFile], dict[Path, str]]:
    """Return the readable files of a bag in order, and the errors of others by path; BagError if none is readable."""
    if os.path.isfile(path):
        return [McapFile(path)], {}
    try:
        names = os.listdir(path)
    except PermissionError as error:
        why = f'{error.strerror}; check the permissions of this folder and of those above'
        raise BagError(f'{path} cannot be read: {why}') from error
    except OSError:
        raise MissingFileError(f'there is no bag {path}; give a bag folder or a .mcap file') from None
    # Compression of a file may have been interrupted: prefer the original.
    found = {name.removesuffix('.zstd') for name in names if name.endswith(('.mcap', '.mcap.zstd'))}
    if not found:
        expected = 'name the folder that holds one, or a .bag file'
        raise BagError(f'{path} is no bag: it holds no .mcap or .db3 file; {expected}')
    files, unread = list[McapFile](), dict[Path, str]()
    # NAME_2.mcap comes before NAME_10.mcap.
    for name in sorted(found, key=lambda name: (len(name), name)):
        file = path / (name if name in names else f'{name}.zstd')
        try:
            files.append(McapFile(file))
        except BagError as error:
            unread[file] = str(error)
    # A power cut may leave a file empty, but not all files.
    if not files:
        raise BagError(next(iter(unread.values())))
    return files, unread
