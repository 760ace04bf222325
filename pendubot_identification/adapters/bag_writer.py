"""Writing a bag: a folder with one .mcap and metadata.yaml, as rosbag2 writes it, that survives SIGKILL."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO

import yaml
from mcap.writer import CompressionType, Writer

from pendubot_identification.core.errors import BagError

from .message_types import message_definition

#: At the latest after so much time between messages' log times, what was written is handed to the system [ns].
FLUSH_INTERVAL_NS = 100_000_000

#: A chunk is closed, but not handed over, once it has grown to this [bytes].
CHUNK_SIZE = 64 * 1024

METADATA = 'metadata.yaml'


@dataclass(frozen=True, slots=True)
class Qos:
    """What a topic's publisher offered, in rosbag2's words."""

    reliability: str = 'reliable'
    durability: str = 'volatile'
    history: str = 'keep_last'
    depth: int = 1000

    def profile(self) -> dict[str, Any]:
        """Return every key of rosbag2's YAML form; deadline, lifespan and lease are infinite."""

        def infinite() -> dict[str, int]:
            return {'sec': 9223372036, 'nsec': 854775807}

        return {
            'history': self.history,
            'depth': self.depth,
            'reliability': self.reliability,
            'durability': self.durability,
            'deadline': infinite(),
            'lifespan': infinite(),
            'liveliness': 'automatic',
            'liveliness_lease_duration': infinite(),
            'avoid_ros_namespace_conventions': False,
        }


@dataclass
class _Topic:
    name: str
    type_name: str
    type_hash: str
    profile: dict[str, Any]
    count: int = 0


@dataclass
class _Span:
    """How many messages, from when to when."""

    count: int = 0
    first_ns: int = 0
    last_ns: int = 0

    def add(self, time_ns: int) -> None:
        self.first_ns = min(self.first_ns, time_ns) if self.count else time_ns
        self.last_ns = max(self.last_ns, time_ns) if self.count else time_ns
        self.count += 1

    def metadata(self) -> dict[str, Any]:
        return {
            'starting_time': {'nanoseconds_since_epoch': self.first_ns},
            'duration': {'nanoseconds': self.last_ns - self.first_ns},
            'message_count': self.count,
        }


class BagWriter:
    """A bag being written, from the moment this is made until :meth:`close`; also a context manager.

    What was written is with the operating system at the latest when a message 0.1 s younger arrives, and on the disk
    after :meth:`sync`: a program that is killed loses only what came after.

    Args:
        path: the bag's folder; it is made, with the folders above it.
        overwrite: replace a bag of this name. Anything that is not a bag is never touched.

    Raises:
        BagError: the name is taken, or the system refuses to write.
    """

    def __init__(self, path: Path, *, overwrite: bool = False) -> None:
        self.path = Path(path)
        self._topics: dict[int, _Topic] = {}
        self._schemas: dict[str, int] = {}
        self._span = _Span()
        self._flushed_ns: int | None = None
        self._whole_size = 0
        self._closed = False
        with self._explained():
            _make_room(self.path, overwrite)
            self.path.mkdir(parents=True, exist_ok=overwrite)
            self._file_name = f'{self.path.absolute().name}_0.mcap'
            self._write_metadata()
            # It stays open for as long as the bag does.
            self._file: BinaryIO = open(self.path / self._file_name, 'xb')  # noqa: SIM115
            self._mcap = Writer(self._file, chunk_size=CHUNK_SIZE, compression=CompressionType.NONE)
            self._mcap.start(profile='ros2')
            self._flush()

    def add_topic(self, topic: str, type_name: str, qos: Qos = Qos()) -> int:
        """Announce a topic of a type such as ``std_msgs/msg/Float64``; return the channel to write to.

        Raises:
            BagError: the type's definition is not installed.
        """
        definition = message_definition(type_name)
        profile = qos.profile()
        with self._explained():
            if type_name not in self._schemas:
                self._schemas[type_name] = self._mcap.register_schema(
                    name=type_name, encoding='ros2msg', data=definition.text.encode()
                )
            channel = self._mcap.register_channel(
                topic=topic,
                message_encoding='cdr',
                schema_id=self._schemas[type_name],
                metadata={
                    'offered_qos_profiles': yaml.safe_dump([profile], sort_keys=False),
                    'topic_type_hash': definition.type_hash,
                },
            )
        self._topics[channel] = _Topic(topic, type_name, definition.type_hash, profile)
        return channel

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
            BagError: the system refuses to write; the bag is closed then, as far as it is whole.
        """
        with self._explained():
            self._mcap.add_message(
                channel_id=channel,
                log_time=log_time_ns,
                data=data,
                publish_time=log_time_ns if publish_time_ns is None else publish_time_ns,
                sequence=sequence & 0xFFFFFFFF,
            )
            self._topics[channel].count += 1
            self._span.add(log_time_ns)
            if self._flushed_ns is None:
                self._flushed_ns = log_time_ns
            # A clock that was set back must not stop the flushing.
            elif abs(log_time_ns - self._flushed_ns) >= FLUSH_INTERVAL_NS:
                self._flush()
                self._flushed_ns = log_time_ns

    def sync(self) -> None:
        """Put everything written so far on the disk; to be called about once a second.

        Raises:
            BagError: the system refuses to write; the bag is closed then, as far as it is whole.
        """
        if not self._closed:
            with self._explained():
                self._flush()
                os.fsync(self._file.fileno())

    def close(self) -> None:
        """Write the index and metadata.yaml, and close the bag; a second time does nothing.

        Raises:
            BagError: the system refuses to write.
        """
        if self._closed:
            return
        with self._explained():
            self._mcap.flush()
            information = self._metadata()['rosbag2_bagfile_information']
            self._mcap.add_metadata('rosbag2', {'serialized_metadata': yaml.safe_dump(information, sort_keys=False)})
            self._mcap.finish()
            self._file.flush()
            os.fsync(self._file.fileno())
            self._whole_size = self._file.tell()
            self._file.close()
            self._closed = True
            self._write_metadata()

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _flush(self) -> None:
        self._mcap.flush()
        self._whole_size = self._file.tell()

    @contextmanager
    def _explained(self) -> Iterator[None]:
        """Turn what the operating system refuses into a sentence, and leave a bag that is whole as far as it goes."""
        if self._closed:
            raise BagError(f'{self.path} is closed; nothing more can be written to it')
        try:
            yield
        except OSError as error:
            self._abandon()
            raise BagError(
                f'{self.path} cannot be written ({error.strerror or error}); free some space or choose another place'
            ) from error

    def _abandon(self) -> None:
        self._closed = True
        if hasattr(self, '_file'):
            with suppress(OSError):
                self._file.close()
            # Half a chunk at the end helps nobody.
            with suppress(OSError):
                os.truncate(self.path / self._file_name, self._whole_size)

    def _metadata(self) -> dict[str, Any]:
        span = self._span.metadata()
        return {
            'rosbag2_bagfile_information': {
                'version': 9,
                'storage_identifier': 'mcap',
                'duration': span['duration'],
                'starting_time': span['starting_time'],
                'message_count': self._span.count,
                'topics_with_message_count': [
                    {
                        'topic_metadata': {
                            'name': topic.name,
                            'type': topic.type_name,
                            'serialization_format': 'cdr',
                            'offered_qos_profiles': [topic.profile],
                            'type_description_hash': topic.type_hash,
                        },
                        'message_count': topic.count,
                    }
                    for topic in self._topics.values()
                ],
                'compression_format': '',
                'compression_mode': '',
                'relative_file_paths': [self._file_name],
                'files': [{'path': self._file_name, **self._span.metadata()}],
                'custom_data': None,
                'ros_distro': 'jazzy',
            }
        }

    def _write_metadata(self) -> None:
        temporary = self.path / f'{METADATA}.tmp'
        with temporary.open('w', encoding='utf-8') as file:
            yaml.safe_dump(self._metadata(), file, sort_keys=False)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, self.path / METADATA)


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
