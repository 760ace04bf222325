# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Writes a bag as rosbag2 does, a folder with an .mcap file and metadata.yaml; SIGKILL does not damage it."""

from __future__ import annotations

import os
import shutil
import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Schema
from mcap.writer import CompressionType, Writer
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2.metadata import dump_qos_v9, parse_qos

from pendubot_identification.errors import BagError
from pendubot_identification.files import OVERWRITE, yaml_text

from .message_types import message_definition


@dataclass(frozen=True, slots=True)
class WriteSettings:
    """Limits of a chunk, and the file's largest overhead in addition to the message data."""

    chunk_size: int = 64 * 1024  #: Largest size of a chunk with more than one message [bytes].
    message_cost: int = 64  #: Largest overhead of a message [bytes].
    chunk_cost: int = 128  #: Largest overhead of a chunk, and of a topic in it [bytes].
    file_cost: int = 16384  #: Largest overhead of a file or topic [bytes].


SETTINGS = WriteSettings()
METADATA = 'metadata.yaml'
INFINITE = QosTime(9223372036, 854775807)
#: The default quality of service of a publisher.
RELIABLE = Qos(
    QosHistory.KEEP_LAST,
    1000,
    QosReliability.RELIABLE,
    QosDurability.VOLATILE,
    INFINITE,
    INFINITE,
    QosLiveliness.AUTOMATIC,
    INFINITE,
    False,
)


class RefusedError(BagError):
    """A bag can no longer be written; ``reason`` is the operating system's message."""

    def __init__(self, sentence: str, reason: str) -> None:
        super().__init__(sentence)
        self.reason = reason


class BagWriter:
    """Writes a bag from its construction until :meth:`close`; also a context manager.

    Messages reach the operating system with :meth:`flush`, or when a chunk is full, and the disk with :meth:`sync`. A
    killed program loses only messages that did not reach the operating system. The bag is closed before the disk is
    full. All methods may be called from any thread.

    Args:
        path: the bag's folder, which must not exist; it is created with its parents.
        reserve: free disk space that is left to other programs [bytes].
        folder: the folder to write to; None: ``path``.

    Raises:
        BagError: the folder exists.
        RefusedError: the free space is below the reserve, or writing fails. Every later call raises it again, and the
            bag keeps its complete chunks.
    """

    def __init__(self, path: Path, *, reserve: int = 0, folder: Path | None = None) -> None:
        self.path = Path(path)
        self._folder, self._reserve = folder or self.path, reserve
        self.file = self._folder / f'{self.path.absolute().name}_0.mcap'
        self._lock, self._describing = threading.RLock(), threading.Lock()
        self._closed: BagError | None = None
        self._topics: dict[int, tuple[Schema, Channel]] = {}
        self._counts: Counter[int] = Counter()
        self._described = (-1, -1)
        self._first_ns = self._last_ns = 0
        self._complete_size = self._chunks = self._pending = 0
        if os.path.lexists(self._folder):
            raise BagError(f'{self._folder} exists already; give another name')
        with self._explained():
            above = next(folder for folder in self._folder.absolute().parents if folder.exists())
            if reason := _shortage(above, SETTINGS.file_cost, reserve):
                raise RefusedError(f'{self.path} is not begun: {reason}; free some space, or lower the reserve', reason)
            self._folder.mkdir(parents=True)
            self._file = self.file.open('xb')
            self._mcap = Writer(self._file, chunk_size=1 << 62, compression=CompressionType.NONE)
            self._mcap.start(profile='ros2')
            self._hand_over()
            self._describe()
            sync_folder(above)

    @property
    def free(self) -> int:
        """Free space of the bag's disk [bytes]."""
        return shutil.disk_usage(self._folder).free

    def add_topic(self, topic: str, type_name: str, *offered: Qos) -> int:
        """Add a topic of a type such as ``std_msgs/msg/Float64`` and return its channel.

        ``offered`` are the qualities of service of its publishers.

        Raises:
            BagError: the type's definition is not installed.
        """
        text, type_hash = message_definition(type_name)
        profiles = yaml_text(dump_qos_v9(list(offered) or [RELIABLE]))
        metadata = {'offered_qos_profiles': profiles, 'topic_type_hash': type_hash}
        return self.add_channel(Schema(0, text.encode(), 'ros2msg', type_name), Channel(0, topic, 'cdr', metadata, 0))

    def add_channel(self, schema: Schema, channel: Channel) -> int:
        """Add a topic with the schema and channel of another bag and return its channel; equal topics share one."""
        metadata = {'offered_qos_profiles': '', 'topic_type_hash': ''} | channel.metadata
        with self._explained():
            same = [known for known, _ in self._topics.values() if replace(known, id=schema.id) == schema]
            schema_id = same[0].id if same else self._mcap.register_schema(schema.name, schema.encoding, schema.data)
            schema, channel = replace(schema, id=schema_id), replace(channel, metadata=metadata, schema_id=schema_id)
            for number, (_, known) in self._topics.items():
                if replace(known, id=channel.id) == channel:
                    return number
            channel.id = self._mcap.register_channel(channel.topic, channel.message_encoding, schema_id, metadata)
            # The library writes both into the next chunk alone. If that chunk is damaged in an unclosed file, this
            # copy keeps the others readable.
            self._hand_over()
            records = RecordBuilder()
            schema.write(records)
            channel.write(records)
            self._file.write(records.end())
            self._hand_over()
            self._topics[channel.id] = schema, channel
        return channel.id

    def write(
        self, channel: int, data: bytes, log_time_ns: int, publish_time_ns: int | None = None, sequence: int = 0
    ) -> None:
        """Write one message, as CDR with its encapsulation header.

        The times are of receiving and publishing [ns since the epoch]; ``sequence`` numbers the channel's messages.
        """
        published_ns = log_time_ns if publish_time_ns is None else publish_time_ns
        size = len(data) + SETTINGS.message_cost
        with self._explained():
            if self._pending + size > SETTINGS.chunk_size:
                self._flush(size)
            self._mcap.add_message(channel, log_time_ns, data, published_ns, sequence & 0xFFFFFFFF)
            if not self._counts:
                self._first_ns = self._last_ns = log_time_ns
            self._first_ns, self._last_ns = min(self._first_ns, log_time_ns), max(self._last_ns, log_time_ns)
            self._counts[channel] += 1
            self._pending += size

    def flush(self) -> None:
        """Pass all written messages to the operating system."""
        with self._lock:
            if self._closed is None:
                with self._explained():
                    self._flush()

    def sync(self) -> None:
        """Force all chunks to the disk and update metadata.yaml; other threads may write meanwhile."""
        with self._lock:
            self.flush()
            if self._closed is not None:
                return
            descriptor = os.dup(self._file.fileno())
        try:
            os.fsync(descriptor)
            self._describe()
        except OSError as error:
            with self._explained():
                raise error
        finally:
            os.close(descriptor)

    def close(self) -> None:
        """Write the index and metadata.yaml, and close the bag; a second call does nothing."""
        with self._lock:
            if self._closed is None:
                with self._explained():
                    self._close()

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _flush(self, coming: int = 0) -> None:
        """Write the pending chunk; close the bag if the index and ``coming`` more bytes would not fit on the disk."""
        overhead = (self._chunks + 1) * SETTINGS.chunk_cost + SETTINGS.file_cost
        needed = self._pending + coming + overhead * (1 + len(self._topics))
        if reason := _shortage(self.file, needed, self._reserve):  # raises if the file was removed
            self._close()
            sentence = f'{self.path} is closed with all earlier messages: {reason}; free some space'
            self._closed = RefusedError(sentence, reason)
            raise self._closed
        self._hand_over()

    def _hand_over(self) -> None:
        self._chunks += self._pending > 0
        self._mcap.flush()
        self._complete_size, self._pending = self._file.tell(), 0

    def _close(self) -> None:
        self._hand_over()
        self._mcap.add_metadata('rosbag2', {'serialized_metadata': yaml_text(self._information())})
        self._mcap.finish()
        self._file.flush()
        os.fsync(self._file.fileno())
        self._file.close()
        self._closed = BagError(f'{self.path} is closed; write to another bag')
        self._describe()

    def _information(self) -> dict[str, object]:
        """Return the content of metadata.yaml."""
        span = {
            'starting_time': {'nanoseconds_since_epoch': self._first_ns},
            'duration': {'nanoseconds': self._last_ns - self._first_ns},
            'message_count': self._counts.total(),
        }
        return {
            'version': 9,
            'storage_identifier': 'mcap',
            **span,
            'topics_with_message_count': [
                {
                    'topic_metadata': {
                        'name': channel.topic,
                        'type': schema.name,
                        'serialization_format': channel.message_encoding,
                        'offered_qos_profiles': dump_qos_v9(offered_profiles(channel.metadata['offered_qos_profiles'])),
                        'type_description_hash': channel.metadata['topic_type_hash'],
                    },
                    'message_count': self._counts[number],
                }
                for number, (schema, channel) in self._topics.items()
            ],
            'compression_format': '',
            'compression_mode': '',
            'relative_file_paths': [self.file.name],
            'files': [{'path': self.file.name, **span}],
            'custom_data': None,
            'ros_distro': 'jazzy',
        }

    def _describe(self) -> None:
        """Write metadata.yaml, unless it is up to date."""
        with self._lock:
            content, known = self._information(), (len(self._topics), self._counts.total())
        # Without the lock, so that other threads can write messages.
        with self._describing:
            if known > self._described:
                # The file is replaced atomically, even if the power fails.
                temporary = self._folder / f'{METADATA}.tmp'
                with temporary.open('w', encoding='utf-8') as file:
                    file.write(yaml_text({'rosbag2_bagfile_information': content}))
                    file.flush()
                    os.fsync(file.fileno())
                os.replace(temporary, self._folder / METADATA)
                sync_folder(self._folder)
                self._described = known

    @contextmanager
    def _explained(self) -> Iterator[None]:
        """Raise an OSError as a RefusedError with a sentence, and truncate the file to its complete chunks."""
        with self._lock:
            if self._closed is not None:
                raise self._closed
            try:
                yield
            except OSError as error:
                reason = error.strerror or str(error)
                sentence = f'{self.path} cannot be written ({reason}); free some space or choose another place'
                self._closed = RefusedError(sentence, reason)
                with suppress(OSError, AttributeError):
                    self._file.close()
                with suppress(OSError):
                    os.truncate(self.file, self._complete_size)
                    self._describe()
                raise self._closed from error


@contextmanager
def complete_bag(path: Path, *, overwrite: bool = False) -> Iterator[BagWriter]:
    """Write a complete bag or none: its folder is ``NAME.PID.partial`` until it is complete.

    With ``overwrite`` it then replaces a bag of this name, or the bag that a link of this name leads to, but no other
    file or folder.

    Raises:
        BagError: the name is taken, or writing fails.
    """
    path = Path(path)
    if os.path.lexists(path) and not overwrite:
        raise BagError(f'{path} exists already; give another name or {OVERWRITE}')
    try:
        _bag_files(path)
        target = path.resolve()
        # Two programs that write the same bag must not share a folder.
        partial = target.with_name(f'{target.name}.{os.getpid()}.partial')
        try:
            with BagWriter(path, folder=partial) as bag:
                yield bag
            if overwrite:
                for file in _bag_files(path):
                    file.unlink()
            os.rename(partial, target)
            sync_folder(partial.parent)
        finally:
            shutil.rmtree(partial, ignore_errors=True)
    except (RefusedError, OSError) as error:
        reason = error.reason if isinstance(error, RefusedError) else error.strerror
        raise BagError(f'{path} is not written: {reason}; free some space or choose another place') from error


def _shortage(path: Path, needed: int, reserve: int) -> str:
    """Return why ``needed`` bytes cannot be added to the disk of a path with ``reserve`` bytes left, or ''."""
    disk = os.statvfs(path)
    free = disk.f_bavail * disk.f_frsize
    # Some file systems report no size.
    if disk.f_blocks and free < needed + reserve:
        reserved = f', including the reserve of {reserve / 1e6:.1f} MB' if reserve else ''
        return f'its disk has {free / 1e6:.1f} MB left{reserved}'
    return ''


def _bag_files(path: Path) -> list[Path]:
    """Return the files of a bag that may be replaced; raise BagError if the path is no bag."""
    if not os.path.lexists(path):
        return []
    content = sorted(path.iterdir()) if path.is_dir() else []
    parts = [file for file in content if file.name in (METADATA, f'{METADATA}.tmp') or file.suffix == '.mcap']
    if not any(file.suffix == '.mcap' for file in parts):
        raise BagError(f'{path} exists and is no bag, so it is not overwritten; give another name')
    if foreign := [file.name for file in content if file not in parts]:
        raise BagError(f'{path} holds {foreign[0]!r} beside its bag, so it is not overwritten; give another name')
    return parts


@cache
def offered_profiles(text: str) -> list[Qos]:
    """Return the qualities of service in a channel's metadata; none if the text is damaged."""
    with suppress(Exception):  # the parser raises many types
        return parse_qos(text)
    return []


def sync_folder(folder: Path) -> None:
    """Force the names of a folder's files to the disk: the fsync of a file omits its name."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
