"""Reading one .mcap file through its index; where it was not closed, through one that is made of what is whole."""

from __future__ import annotations

import os
import struct
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import BytesIO
from itertools import chain
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

from mcap.data_stream import ReadDataStream
from mcap.exceptions import UnsupportedCompressionError
from mcap.records import Channel, Chunk, DataEnd, Message, Schema, Statistics
from mcap.stream_reader import StreamReader, get_chunk_data_stream

from pendubot_identification.errors import BagError

from .chunk_index import RECORD, ChunkIndex, FoundChunk
from .mcap_salvage import (
    MAGIC,
    Damage,
    MessageHead,
    chunk_parts,
    chunk_records,
    is_chunk_of,
    whole_parts,
    whole_records,
)

Unpacked = TypeVar('Unpacked')

#: Bytes of records that are looked at together: enough for numpy, and still in a processor's cache.
TOGETHER = 250_000

#: What stands before the last magic: where the summary starts, where its offsets start, and its CRC (0: none).
FOOTER = struct.Struct('<QQL')


class McapFile:
    """One .mcap file, closed or not.

    Attributes:
        path: of the file.
        closed: whether whoever wrote it came to the end.
        note: what could be read, in a sentence, where it was not closed; else empty.
        topics: the schema's name and the number of messages of each topic.
        first_ns, last_ns: earliest and latest log time [ns since the epoch]; None where there is no message.

    Raises:
        BagError: the file is missing, empty, no MCAP file, or compressed in a way that cannot be read here.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.note = ''
        self.topics: dict[str, tuple[str, int]] = {}
        self.first_ns: int | None = None
        self.last_ns: int | None = None
        self._channels: dict[int, Channel] = {}
        self._schemas: dict[int, Schema] = {}
        self._chunks = ChunkIndex.of([])
        counts: Counter[int] = Counter()
        self._check_magic()
        self.closed = self._read_summary(counts)
        if self.first_ns is None:
            self._scan(counts)
        for channel_id, channel in self._channels.items():
            schema = self._schemas.get(channel.schema_id)
            _, before = self.topics.get(channel.topic, ('', 0))
            self.topics[channel.topic] = (schema.name if schema else '', before + counts[channel_id])

    def messages(self, topic: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[Message]:
        """Return the messages of a topic in the order of writing, without those logged outside the times [ns].

        Only what holds messages of the topic and of these times is read, where there are chunks.

        Raises:
            BagError: a part of a closed file is damaged, or the file is not any more what it was.
        """
        low = 0 if start_ns is None else start_ns
        high = 2**64 if end_ns is None else end_ns
        channels = {k for k, channel in self._channels.items() if channel.topic == topic}
        indexed = chain.from_iterable(self._indexed(channels, low, high, _records))
        for record in indexed if self._chunks else self._whole_records():
            if isinstance(record, Message) and record.channel_id in channels and low <= record.log_time < high:
                yield record

    def chunks(self, topic: str, start_ns: int, end_ns: int) -> Iterator[bytes] | None:
        """Return the records in the chunks that hold messages of a topic and of these times [ns], many chunks at once.

        Returns:
            None where messages stand outside of chunks.

        Raises:
            BagError: as :meth:`messages`.
        """
        if not self._chunks:
            return None
        channels = {k for k, channel in self._channels.items() if channel.topic == topic}
        return _joined(self._indexed(channels, start_ns, end_ns, _unpacked))

    def channel(self, topic: str) -> int | None:
        """Return the number of a topic's only channel; None where it has several."""
        numbers = [k for k, channel in self._channels.items() if channel.topic == topic]
        return numbers[0] if len(numbers) == 1 else None

    def encoding(self, topic: str) -> str:
        """Return how a topic's messages are encoded: ``cdr`` in every bag of ROS 2."""
        return next(c.message_encoding for c in self._channels.values() if c.topic == topic)

    @property
    def channels(self) -> dict[int, Channel]:
        """The channels by their number."""
        return self._channels

    @property
    def schemas(self) -> dict[int, Schema]:
        """The message definitions by their number."""
        return self._schemas

    def _check_magic(self) -> None:
        try:
            with self.path.open('rb') as file:
                magic = file.read(len(MAGIC))
        except OSError as error:
            raise BagError(f'{self.path} cannot be read: {error.strerror}; check its name and permissions') from error
        if not magic:
            raise BagError(f'{self.path} is empty: its recording ended before anything was written; record it again')
        # A single damaged byte does not make it another kind of file.
        alike = sum(a == b for a, b in zip(magic, MAGIC, strict=False))
        if magic != MAGIC and (alike < len(MAGIC) - 1 or next(whole_parts(self.path), None) is None):
            raise BagError(f'{self.path} is no MCAP file; give a bag folder or a .mcap file as rosbag2 writes them')

    def _read_summary(self, counts: Counter[int]) -> bool:
        """Take what the end of the file says of the rest; return whether the file has an end."""
        try:
            with self.path.open('rb') as file:
                file.seek(-len(MAGIC), os.SEEK_END)
                if file.tell() == 0 or file.read() != MAGIC:
                    return False
                chunks, others = ChunkIndex.split(_summary(file))
            records = list(StreamReader(BytesIO(others + MAGIC), skip_magic=True).records)
        except Exception:
            return False
        channels = {r.id: r for r in records if isinstance(r, Channel)}
        statistics = next((r for r in records if isinstance(r, Statistics)), None)
        if statistics is None or not channels:
            return True
        self._chunks, self._channels = chunks, channels
        self._schemas = {r.id: r for r in records if isinstance(r, Schema)}
        if statistics.message_count:
            self.first_ns, self.last_ns = statistics.message_start_time, statistics.message_end_time
            counts.update(statistics.channel_message_counts)
        return True

    def _scan(self, counts: Counter[int]) -> None:
        """Learn by reading everything what no index says, and make the index."""
        ended = loose = False
        damages: list[Damage] = []
        chunks: list[FoundChunk] = []
        with self._explained():
            for offset, size, part in whole_parts(self.path, damages):
                heads: list[MessageHead] = []
                if isinstance(part, bytes):
                    for record, _, _ in chunk_parts(part):
                        if isinstance(record, tuple):
                            heads.append(record)
                        else:
                            self._learn(record, vouched=True)
                elif isinstance(part, Message):
                    loose = True
                    heads.append((part.channel_id, part.sequence, part.log_time, part.publish_time))
                else:
                    self._learn(part, vouched=False)
                    ended = ended or isinstance(part, DataEnd)
                if not heads:
                    continue
                channels, _, times, _ = zip(*heads, strict=True)
                counts.update(channels)
                first, last = min(times), max(times)
                self.first_ns = first if self.first_ns is None else min(self.first_ns, first)
                self.last_ns = last if self.last_ns is None else max(self.last_ns, last)
                # An index has no place for what stands outside of chunks.
                if not loose:
                    chunks.append(FoundChunk(first, last, offset, size, tuple(set(channels))))
        self._chunks = ChunkIndex.of([] if loose else chunks)
        self.closed = self.closed and ended
        if not self.closed:
            self.note = self._found(sum(counts[k] for k in self._channels), damages)

    def _learn(self, record: Any, *, vouched: bool) -> None:
        if isinstance(record, (Schema, Channel)):
            known: dict[int, Any] = self._schemas if isinstance(record, Schema) else self._channels
            # What a checksum vouches for is right, where the two differ.
            if vouched or record.id not in known:
                known[record.id] = record

    def _found(self, count: int, damages: list[Damage]) -> str:
        seconds = ((self.last_ns or 0) - (self.first_ns or 0)) / 1e9
        size = self.path.stat().st_size
        inside = [damage for damage in damages if damage.offset + damage.size < size]
        note = f'{self.path.name} was never closed, or is cut or damaged: its '
        if not inside:
            return note + f'first {count} messages, {seconds:.3f} s, are whole and are used'
        lost = sum(damage.size for damage in inside)
        return note + (
            f'{count} messages that are whole, within {seconds:.3f} s, are used; {lost} bytes among them are not, '
            f'first at byte {inside[0].offset}'
        )

    def _whole_records(self) -> Iterator[Any]:
        """Every record that is whole, of a file with messages outside of chunks."""
        with self._explained():
            for _, record in whole_records(self.path):
                yield record

    def _indexed(
        self, channels: set[int], low: int, high: int, unpack: Callable[[Chunk], Unpacked]
    ) -> Iterator[Unpacked]:
        with self._explained(), self.path.open('rb') as file:
            for k in self._chunks.holding(channels, low, high):
                offset = int(self._chunks.offset[k])
                try:
                    file.seek(offset)
                    content = file.read(int(self._chunks.length[k]))[RECORD.size :]
                    # As for the index: a checksum proves a chunk, even where its opcode was hit.
                    if not is_chunk_of(len(content), content):
                        raise ValueError('something else stands there')
                    unpacked = unpack(Chunk.read(ReadDataStream(BytesIO(content))))
                except UnsupportedCompressionError:
                    raise
                except Exception as error:
                    raise self._damaged(offset, int(self._chunks.first_ns[k])) from error
                yield unpacked

    def _damaged(self, offset: int, first_ns: int) -> BagError:
        if not self.closed:
            return BagError(
                f'{self.path} was whole {offset} bytes from its start when it was opened and is not now; read it again'
            )
        after = (first_ns - (self.first_ns or 0)) / 1e9
        return BagError(
            f'{self.path} is damaged {offset} bytes from its start, {after:.3f} s after its first message; '
            'copy it again from where it was recorded, choose a window without that time, or save what is '
            f'whole with pendubot repair {self.path.parent}'
        )

    @contextmanager
    def _explained(self) -> Iterator[None]:
        """Turn what cannot be read here into a sentence."""
        try:
            yield
        except UnsupportedCompressionError as error:
            raise BagError(f'{self.path} cannot be read: {error}; install that package with pip') from error
        except OSError as error:
            raise BagError(f'{self.path} cannot be read: {error.strerror or error}; copy it to another disk') from error


def _unpacked(chunk: Chunk) -> bytes:
    """Return a chunk's records as bytes, decompressed and checked."""
    stream, length = get_chunk_data_stream(chunk, validate_crc=True)
    return stream.read(length)


def _records(chunk: Chunk) -> list[Any]:
    return list(chunk_records(_unpacked(chunk)))


def _joined(parts: Iterator[bytes]) -> Iterator[bytes]:
    """Return the same bytes in longer parts: chunks that were flushed ten times a second are short."""
    together, size = list[bytes](), 0
    for part in parts:
        together.append(part)
        size += len(part)
        if size >= TOGETHER:
            yield b''.join(together)
            together, size = [], 0
    yield b''.join(together)


def _summary(file: BinaryIO) -> bytes:
    """Return the records of an MCAP file's summary and its footer.

    Raises:
        ValueError: they are not what was written: an index with a wrong time would hide messages.
    """
    end = file.seek(-len(MAGIC) - FOOTER.size, os.SEEK_END)
    start, _, crc = FOOTER.unpack(file.read(FOOTER.size))
    start = start or end - RECORD.size
    file.seek(start)
    summary = file.read(end + FOOTER.size - start)
    # The CRC covers all from the summary's start to the CRC itself.
    if crc != 0 and zlib.crc32(summary[:-4]) != crc:
        raise ValueError('the summary is damaged')
    return summary
