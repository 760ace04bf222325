"""Writing a bag: a folder with .mcap files and metadata.yaml, as rosbag2 writes it, that survives SIGKILL."""

from __future__ import annotations

import os
import resource
import shutil
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, NamedTuple

from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Schema
from mcap.writer import CompressionType, Writer

from pendubot_identification.errors import BagError

from .bag_metadata import METADATA, FileSpan, Qos, Topic, as_yaml, information, sync_folder, write_metadata
from .message_types import message_definition

#: At the latest after so much time between messages' log times, what was written is handed to the system [ns].
FLUSH_INTERVAL_NS = 100_000_000

#: A chunk is closed and handed to the system once it has grown to this [bytes].
CHUNK_SIZE = 64 * 1024

#: What a message, a chunk, a channel of a chunk and a whole file need beside the data, at most [bytes].
MESSAGE_COST, CHUNK_COST, INDEX_COST, FILE_COST = 64, 256, 64, 8192

#: What a publisher offers that asks for nothing special.
OFFERED = Qos()

#: A smaller file could not hold its own index.
SMALLEST_FILE = 64 * 1024


@dataclass(frozen=True, slots=True)
class Limits:
    """When a file ends and the next begins, and when the bag does.

    Attributes:
        max_size: of one file [bytes]; 0: any.
        max_duration: of one file [s]; 0: any.
        reserve: of the disk, that other programs are left with [bytes].
        flush_interval_ns: between handing what was written to the system, in log time [ns].
    """

    max_size: int = 0
    max_duration: float = 0.0
    reserve: int = 0
    flush_interval_ns: int = FLUSH_INTERVAL_NS


class _Kept(NamedTuple):
    """A message that is repeated in each file."""

    data: bytes
    publish_time_ns: int
    sequence: int


class BagWriter:
    """A bag being written, from the moment this is made until :meth:`close`; also a context manager.

    What was written is with the operating system at the latest when a message ``flush_interval_ns`` younger arrives,
    and on the disk after :meth:`sync`: a program that is killed loses only what came after. The bag closes itself while
    there is still room to do so. All methods may be called from any thread.

    Args:
        path: the bag's folder; it is made, with the folders above it.
        overwrite: replace a bag of this name. Anything that is not a bag is never touched.
        limits: of its files, and of the disk.

    Raises:
        BagError: the name is taken, the reserve is not there, or the system refuses to write.
    """

    def __init__(self, path: Path, *, overwrite: bool = False, limits: Limits = Limits()) -> None:
        if 0 < limits.max_size < SMALLEST_FILE:
            raise BagError(f'max_size is {limits.max_size}; 0 or at least {SMALLEST_FILE} bytes are expected')
        self.path = Path(path)
        self._limits = limits
        self._lock = threading.RLock()
        self._topics: dict[int, Topic] = {}
        self._kept: dict[int, deque[_Kept]] = {}
        self._files: list[FileSpan] = []
        self._file: BinaryIO | None = None
        self._closed = False
        self._ended_by = ''
        with self._explained():
            _make_room(self.path, overwrite)
            above = next(folder for folder in self.path.absolute().parents if folder.exists())
            if reason := _shortage(above, FILE_COST, limits.reserve):
                raise BagError(f'{self.path} is not begun: {reason}; free some space, or lower the reserve')
            self.path.mkdir(parents=True, exist_ok=overwrite)
            self._begin_file()
            sync_folder(self.path.absolute().parent)

    @property
    def files(self) -> tuple[str, ...]:
        """The names of its files so far."""
        return tuple(file.name for file in self._files)

    @property
    def free(self) -> int:
        """How much room its disk has left [bytes]."""
        return shutil.disk_usage(self.path).free

    def add_topic(self, topic: str, type_name: str, qos: Qos = OFFERED) -> int:
        """Announce a topic of a type such as ``std_msgs/msg/Float64``; return the channel to write to.

        The last message of a topic that is ``transient_local`` is repeated at the beginning of each later file.

        Raises:
            BagError: the type's definition is not installed.
        """
        definition = message_definition(type_name)
        channel = self.add_channel(
            Topic(topic, type_name, definition.text.encode(), definition.type_hash, as_yaml([qos.profile()]))
        )
        if qos.durability == 'transient_local':
            self.keep(channel, 1)
        return channel

    def add_channel(self, topic: Topic) -> int:
        """Announce a topic by its full description; return the channel to write to."""
        with self._explained():
            if self._file is None:
                self._begin_file()
            channel = self._register(topic)
            self._topics[channel] = topic
        return channel

    def keep(self, channel: int, count: int) -> None:
        """Repeat the last ``count`` messages of a channel at the beginning of each later file."""
        with self._lock:
            self._kept[channel] = deque(self._kept.get(channel, ()), maxlen=count)

    def write(
        self, channel: int, data: bytes, log_time_ns: int, publish_time_ns: int | None = None, sequence: int = 0
    ) -> None:
        """Write one message.

        Args:
            channel: from :meth:`add_topic`.
            data: the message as CDR, with its encapsulation header.
            log_time_ns: when it was received [ns since the epoch].
            publish_time_ns: when it was published; the same, where that is not known.
            sequence: its number, of those on this channel.

        Raises:
            BagError: there is no room, or the system refuses to write; the bag is closed then, as far as it is whole.
        """
        message = _Kept(data, log_time_ns if publish_time_ns is None else publish_time_ns, sequence & 0xFFFFFFFF)
        with self._explained():
            if self._is_full(log_time_ns, len(data) + MESSAGE_COST):
                self._end_file()
            if self._file is None:
                self._begin_file()
                for each, kept in self._kept.items():
                    for old in kept:
                        # What it repeats was published long ago, but is logged here.
                        self._add(each, old, log_time_ns)
            if self._pending + len(data) >= CHUNK_SIZE:
                self._flush(len(data) + MESSAGE_COST)
            self._add(channel, message, log_time_ns)
            if channel in self._kept:
                self._kept[channel].append(message)
            # A clock that was set back must not stop the flushing.
            if abs(log_time_ns - self._flushed_ns) >= self._limits.flush_interval_ns:
                self._flush()

    def flush(self) -> None:
        """Hand everything written so far to the system.

        Raises:
            BagError: there is no room, or the system refuses to write; the bag is closed then, as far as it is whole.
        """
        with self._lock:
            if not self._closed and self._file is not None:
                with self._explained():
                    self._flush()

    def sync(self) -> None:
        """Put everything written so far on the disk; to be called about once a second. Others may write meanwhile.

        Raises:
            BagError: as :meth:`flush`.
        """
        with self._lock:
            self.flush()
            if self._closed or self._file is None:
                return
            descriptor = os.dup(self._file.fileno())
        try:
            os.fsync(descriptor)
        except OSError as error:
            with self._explained():
                raise error
        finally:
            os.close(descriptor)

    def split(self) -> bool:
        """End the present file; the next message begins another. Return False where the present file is empty.

        Raises:
            BagError: as :meth:`flush`.
        """
        with self._explained():
            if self._file is None or not self._files[-1].count:
                return False
            self._end_file()
            return True

    def close(self) -> None:
        """Write the index and metadata.yaml, and close the bag; a second time does nothing.

        Raises:
            BagError: the system refuses to write.
        """
        with self._lock:
            if not self._closed:
                with self._explained():
                    self._close()

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _begin_file(self) -> None:
        """Begin the next file. metadata.yaml names it first, so that a reader misses none after a power cut."""
        self._files.append(FileSpan(name=f'{self.path.absolute().name}_{len(self._files)}.mcap'))
        self._schemas: dict[str, int] = {}
        self._whole_size = self._chunks = self._pending = self._flushed_ns = 0
        write_metadata(self.path, information(self._files, self._topics.values()))
        # It stays open for as long as the file grows.
        self._file = open(self.path / self._files[-1].name, 'xb')  # noqa: SIM115
        self._mcap = Writer(self._file, chunk_size=1 << 62, compression=CompressionType.NONE)
        self._mcap.start(profile='ros2')
        for topic in self._topics.values():
            self._register(topic)
        self._hand_over()
        sync_folder(self.path)

    def _register(self, topic: Topic) -> int:
        schema = Schema(0, topic.definition, topic.definition_encoding, topic.type_name)
        if topic.type_name not in self._schemas:
            self._schemas[topic.type_name] = self._mcap.register_schema(schema.name, schema.encoding, schema.data)
        schema.id = self._schemas[topic.type_name]
        number = self._mcap.register_channel(topic.name, topic.encoding, schema.id, topic.channel_metadata())
        # The library writes both into the next chunk. Were that one damaged in a file without an end, nobody could read
        # the others: so here once more.
        self._hand_over()
        records = RecordBuilder()
        schema.write(records)
        Channel(number, topic.name, topic.encoding, topic.channel_metadata(), schema.id).write(records)
        assert self._file is not None
        self._file.write(records.end())
        self._hand_over()
        return number

    def _add(self, channel: int, message: _Kept, log_time_ns: int) -> None:
        self._mcap.add_message(channel, log_time_ns, message.data, message.publish_time_ns, message.sequence)
        file = self._files[-1]
        if not file.count:
            self._flushed_ns = log_time_ns
        file.add(log_time_ns)
        name = self._topics[channel].name
        file.topics[name] = file.topics.get(name, 0) + 1
        self._pending += len(message.data) + MESSAGE_COST

    def _is_full(self, log_time_ns: int, size: int) -> bool:
        file, limits = self._files[-1], self._limits
        if self._file is None or not file.count:
            return False
        if limits.max_size and self._whole_size + self._closing_size() + size > limits.max_size:
            return True
        return bool(limits.max_duration) and abs(log_time_ns - file.first_ns) >= limits.max_duration * 1e9

    def _closing_size(self) -> int:
        """Return how much is still to be written to the file if it is to be closed now, at most [bytes]."""
        described = sum(len(t.definition) + 2 * len(t.profiles) + 1024 for t in self._topics.values())
        chunks = (self._chunks + 1) * (CHUNK_COST + INDEX_COST * len(self._topics))
        return self._pending + described + chunks + FILE_COST * (1 + len(self._files) // 16)

    def _flush(self, coming: int = 0) -> None:
        """Hand over what is pending; where the room is needed to close the bag, close it without what is coming."""
        needed = self._closing_size() + coming
        if reason := _shortage(self.path, needed, self._limits.reserve, self._whole_size):
            self._close()
            self._ended_by = f'{self.path} is closed with all that was received before: {reason}; free some space'
            raise BagError(self._ended_by)
        self._hand_over()
        self._flushed_ns = self._files[-1].last_ns

    def _hand_over(self) -> None:
        assert self._file is not None
        self._chunks += self._pending > 0
        self._mcap.flush()
        self._file.flush()
        self._whole_size = self._file.tell()
        self._pending = 0

    def _end_file(self) -> None:
        assert self._file is not None
        self._hand_over()
        content = as_yaml(information(self._files, self._topics.values()))
        self._mcap.add_metadata('rosbag2', {'serialized_metadata': content})
        self._mcap.finish()
        self._file.flush()
        os.fsync(self._file.fileno())
        self._whole_size = self._file.tell()
        self._file.close()
        self._file = None

    def _close(self) -> None:
        if self._file is not None:
            self._end_file()
        self._closed = True
        write_metadata(self.path, information(self._files, self._topics.values()))

    @contextmanager
    def _explained(self) -> Iterator[None]:
        """Turn what the operating system refuses into a sentence, and leave a bag that is whole as far as it goes."""
        with self._lock:
            if self._closed:
                raise BagError(self._ended_by or f'{self.path} is closed; nothing more can be written to it')
            try:
                yield
            except OSError as error:
                self._abandon()
                reason = error.strerror or str(error)
                self._ended_by = f'{self.path} cannot be written ({reason}); free some space or choose another place'
                raise BagError(self._ended_by) from error

    def _abandon(self) -> None:
        self._closed = True
        if self._file is not None:
            with suppress(OSError):
                self._file.close()
            # Half a chunk at the end helps nobody.
            with suppress(OSError):
                os.truncate(self.path / self._files[-1].name, self._whole_size)
            with suppress(OSError):
                write_metadata(self.path, information(self._files, self._topics.values()))


def _shortage(folder: Path, needed: int, reserve: int, size: int = 0) -> str:
    """Say why so many bytes cannot be added to a file of this size in a folder, with the reserve left; or nothing."""
    disk = os.statvfs(folder)
    free = disk.f_bavail * disk.f_frsize
    # Some file systems do not know.
    if disk.f_blocks and free < needed + reserve:
        return f'its disk has {free / 1e6:.1f} MB left, of which {reserve / 1e6:.1f} MB are the reserve'
    limit, _ = resource.getrlimit(resource.RLIMIT_FSIZE)
    if limit != resource.RLIM_INFINITY and size + needed > limit:
        return f'the system limits files to {limit / 1e6:.3f} MB (ulimit -f)'
    return ''


def _make_room(path: Path, overwrite: bool) -> None:
    """Remove the bag at ``path`` if it may be overwritten.

    Raises:
        BagError: something is there that may not be removed.
    """
    if not os.path.lexists(path):
        return
    if not overwrite:
        raise BagError(f'{path} exists already; give another name, or replace it with --force where that is offered')
    content = sorted(path.iterdir()) if path.is_dir() else []
    parts = [file for file in content if file.name in (METADATA, f'{METADATA}.tmp') or file.suffix == '.mcap']
    if not any(file.suffix == '.mcap' for file in parts):
        raise BagError(f'{path} exists and is no bag, so it is not overwritten; give another name')
    if foreign := [file.name for file in content if file not in parts]:
        raise BagError(f'{path} holds {foreign[0]!r} beside its bag, so it is not overwritten; give another name')
    for file in parts:
        file.unlink()
