# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Reads one .mcap file, and the intact chunks of an unclosed or damaged one.

The mcap library parses single records (https://mcap.dev/spec); numpy reads the messages of many records at once. A
closed file ends with an index of its chunks. For any other file, a scan makes the index.
"""

from __future__ import annotations

import os
import struct
import tempfile
import weakref
import zlib
from array import array
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import IO, Any

import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Schema, Statistics
from mcap.stream_reader import get_chunk_data_stream
from numpy.typing import DTypeLike, NDArray

from pendubot_identification.arrays import Flags, Indices
from pendubot_identification.errors import BagError

MAGIC = b'\x89MCAP0\r\n'
#: Opcode and length of a record.
HEAD = struct.Struct('<BQ')
#: The footer's record: offset of the summary, offset of the summary offsets, and checksum.
FOOTER = struct.Struct('<9xQQI')
#: The start of a chunk's index: first and last log time, offset and size of the chunk.
INDEX = struct.Struct('<4q')
#: A message's record up to its data; ``length`` is the size of the last four fields and the data.
MESSAGE = np.dtype('u1, <u8, <u2, <u4, <i8, <i8')
MESSAGE.names = ('opcode', 'length', 'channel', 'sequence', 'logged', 'published')
FIELDS = MESSAGE.itemsize - HEAD.size
#: Records of a chunk other than messages.
DEFINITIONS: dict[int, Any] = {Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel}
#: Start of a message in rosbag2's compression mode ``message``; no CDR starts with these bytes.
ZSTD = b'\x28\xb5\x2f\xfd'
#: Size of the records that numpy reads at once [bytes]; fits into a processor's cache.
BLOCK = 250_000
FOREVER_NS = 2**63 - 1


@dataclass(frozen=True, slots=True)
class Damage:
    """A damaged part of a file: its offset and its size [bytes]."""

    offset: int
    size: int


@dataclass(frozen=True, slots=True)
class Messages:
    """Messages of one block of records."""

    data: bytes  #: the records of the messages, perhaps with others in between.
    starts: Indices  #: offset of each record [bytes], shape (N,).
    heads: NDArray[np.void]  #: the records up to the data, dtype :data:`MESSAGE`, shape (N,).

    @classmethod
    def of(cls, contents: Sequence[bytes], heads: NDArray[np.void] | None = None) -> Messages:
        """Return messages with these data and the channels and times of ``heads``."""
        heads = np.zeros(len(contents), MESSAGE) if heads is None else heads.copy()
        sizes = np.array([len(content) for content in contents], np.int64)
        heads['length'] = FIELDS + sizes
        ends = np.cumsum(sizes + MESSAGE.itemsize)
        padding = bytes(MESSAGE.itemsize)
        return cls(padding + padding.join(contents), ends - sizes - MESSAGE.itemsize, heads)

    def __len__(self) -> int:
        return len(self.starts)

    def __iter__(self) -> Iterator[Message]:
        for start, head in zip(self.starts.tolist(), self.heads.tolist(), strict=True):
            _, length, channel, sequence, logged, published = head
            data = self.data[start + MESSAGE.itemsize : start + HEAD.size + length]
            yield Message(channel, logged, data, published, sequence)

    def part(self, selected: NDArray[Any] | slice) -> Messages:
        """Return the selected messages."""
        return Messages(self.data, self.starts[selected], self.heads[selected])

    def contents(self, kind: DTypeLike) -> NDArray[Any]:
        """Return the start of each message's data as one dtype, shape (N,)."""
        return _gathered(self.data, self.starts + MESSAGE.itemsize, np.dtype(kind))


class McapFile:
    """Reads one .mcap file, closed or not, or .mcap.zstd, as rosbag2 compresses it.

    Attributes:
        path: path of the file.
        closed: whether its writer closed it.
        channels, schemas: channels and schemas by number.
        topics: schema name and number of messages by topic.
        first_ns, last_ns: earliest and latest log time [ns since the epoch]; None if there is no message.
        damages: unreadable parts, if the file was scanned.

    Raises:
        BagError: the file is missing, empty or no MCAP file.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.closed = path, True
        self.channels: dict[int, Channel] = {}
        self.schemas: dict[int, Schema] = {}
        self.first_ns: int | None = None
        self.last_ns: int | None = None
        self.damages: list[Damage] = []
        self._counts: Counter[int] = Counter()
        try:
            file = _opened(path)
            weakref.finalize(self, file.close)
            self._descriptor = file.fileno()
            self._size = os.fstat(self._descriptor).st_size
            if not self._size:
                raise BagError(f'{path} is empty: its recording ended before anything was written; record it again')
            if os.pread(self._descriptor, len(MAGIC), 0) != MAGIC:
                raise BagError(
                    f'{path} is no MCAP file; give a bag folder or a .mcap file as rosbag2 writes them, or a file with '
                    'columns and a name in .csv, .txt, .tsv, .npz, .mat, .xlsx or .parquet'
                )
            try:
                self._read_summary()
            except Exception:  # the parsers raise many types for damaged bytes
                self.closed = False
            if self.first_ns is None:
                self._make_index()
        except OSError as error:
            reason = error.strerror or str(error)
            raise BagError(f'{path} cannot be read: {reason}; check its name, permissions and disk') from error
        self.topics: dict[str, tuple[str, int]] = {}
        for number, channel in self.channels.items():
            schema = self.schemas.get(channel.schema_id)
            _, before = self.topics.get(channel.topic, ('', 0))
            self.topics[channel.topic] = (schema.name if schema else '', before + self._counts[number])

    @property
    def note(self) -> str:
        """A sentence about the intact messages of an unclosed or damaged file, else empty."""
        if self.closed:
            return ''
        count = sum(count for _, count in self.topics.values())
        seconds = ((self.last_ns or 0) - (self.first_ns or 0)) / 1e9
        lost = sum(damage.size for damage in self.damages if damage.offset + damage.size < self._size)
        return (
            f'{self.path.name} was never closed, or is truncated or damaged: its {count} intact messages, within '
            f'{seconds:.3f} s, are used' + (f'; {lost} bytes among them are damaged' if lost else '')
        )

    def messages(self, topics: Collection[str], start_ns: int = 0, end_ns: int = FOREVER_NS) -> Iterator[Messages]:
        """Yield blocks of messages of some topics with START <= log time < END [ns], in the order of writing.

        Only chunks with messages of these times are read.

        Raises:
            BagError: a chunk is damaged, or the file changed after it was opened.
        """
        channels = np.array([number for number, channel in self.channels.items() if channel.topic in topics], np.uint16)
        for block in self._blocks((self._index[:, 1] >= start_ns) & (self._index[:, 0] < end_ns)):
            wanted = np.isin(block.heads['channel'], channels, kind='table')
            wanted &= (start_ns <= block.heads['logged']) & (block.heads['logged'] < end_ns)
            if wanted.any():
                yield block.part(wanted)

    def scan(self) -> Iterator[Messages]:
        """Yield the messages of all intact chunks in the order of writing, and list the damaged chunks."""
        yield from self._blocks(np.full(len(self._index), True), skip=True)

    def _blocks(self, selected: Flags, *, skip: bool = False) -> Iterator[Messages]:
        """Yield the messages of the selected chunks; several small chunks are read together. Skip damaged ones."""
        waiting, size = list[bytes](), 0
        for first_ns, _, offset, length in self._index[selected].tolist():
            try:
                record = self._read(offset, length)
                waiting.append(record if record[0] == Opcode.MESSAGE else _unpacked(record))
            except Exception as error:  # as above
                if skip:
                    self.damages.append(Damage(offset, length))
                    continue
                if waiting:
                    yield self._parsed(waiting)
                after = (first_ns - (self.first_ns or 0)) / 1e9
                where = f' {offset} bytes from its start, {after:.3f} s after its first message,'
                raise self._damaged(where) from error
            size += len(waiting[-1])
            if size >= BLOCK:
                yield self._parsed(waiting)
                waiting, size = [], 0
        if waiting:
            yield self._parsed(waiting)

    def _parsed(self, contents: Sequence[bytes]) -> Messages:
        try:
            return parse_records(b''.join(contents))[0]
        except Exception as error:
            raise self._damaged('') from error

    def _damaged(self, where: str) -> BagError:
        return BagError(
            f'{self.path} is damaged{where} or changed after it was opened; copy it again from the recorder, choose a '
            f'window without that time, or save its intact messages with pendubot repair {self.path.parent}'
        )

    def _read_summary(self) -> None:
        """Read definitions, counts and the index of chunks from the end of the file, or raise any exception."""
        end = self._size - FOOTER.size - len(MAGIC)
        footer = self._read(end, FOOTER.size + len(MAGIC))
        # In an unclosed file, any bytes would be the offset of the summary.
        if not footer.endswith(MAGIC):
            raise ValueError('the file was never closed')
        start, _, checksum = FOOTER.unpack_from(footer)
        # An index with a wrong time would hide messages.
        summary = self._read(start or end, end + FOOTER.size - (start or end))
        if checksum and zlib.crc32(summary[:-4]) != checksum:
            raise ValueError('the summary is damaged')
        index, statistics = array('q'), None
        for opcode, begin, stop in _records(summary):
            # The library would need most of the time of a short window for the indices of an hour.
            if opcode == Opcode.CHUNK_INDEX:
                index.extend(INDEX.unpack_from(summary, begin))
            elif opcode == Opcode.STATISTICS:
                statistics = _record(Statistics, summary[begin:stop])
            elif opcode in DEFINITIONS:
                self._define(_record(DEFINITIONS[opcode], summary[begin:stop]))
        counts = statistics.channel_message_counts if statistics else {}
        defined = {number for number, channel in self.channels.items() if channel.schema_id in {0, *self.schemas}}
        # Without counts, an index or definitions, which are optional, the file is scanned.
        if statistics and counts and defined.issuperset(counts) and statistics.chunk_count == len(index) // 4 > 0:
            self._index = np.array(index).reshape(-1, 4)
            self.first_ns, self.last_ns = statistics.message_start_time, statistics.message_end_time
            self._counts.update(counts)

    def _make_index(self) -> None:
        """Read the complete file to make the index of its intact parts: chunks, and records outside of chunks."""
        rows, at = list[tuple[int, int, int, int]](), len(MAGIC)
        while at < self._size:
            size = self._size - at  # the rest is lost, unless the length of this record is known
            try:
                opcode, length = HEAD.unpack(self._read(at, HEAD.size))
                if Opcode(opcode) == Opcode.DATA_END:  # only the summary follows
                    break
                record = self._read(at, HEAD.size + length)
                size = len(record)
                if opcode == Opcode.CHUNK:
                    record = _unpacked(record)
                elif opcode == Opcode.MESSAGE:  # most records of a file without chunks
                    record = self._read(at, max(size, min(BLOCK, self._size - at)))
                elif opcode not in DEFINITIONS:
                    at += size
                    continue
                messages, definitions, end = parse_records(record, whole=opcode != Opcode.MESSAGE)
            except Exception:  # as above
                self.damages.append(Damage(at, size))
                self.closed = False
            else:
                for definition in definitions:
                    self._define(definition)
                size = end if opcode == Opcode.MESSAGE else size
                if messages:
                    logged = messages.heads['logged']
                    rows.append((int(logged.min()), int(logged.max()), at, size))
                    self._counts.update(messages.heads['channel'].tolist())
            at += size
        self._index = np.array(rows, np.int64).reshape(-1, 4)
        if rows:
            self.first_ns, self.last_ns = int(self._index[:, 0].min()), int(self._index[:, 1].max())

    def _define(self, definition: Schema | Channel) -> None:
        known: dict[int, Any] = self.schemas if isinstance(definition, Schema) else self.channels
        known[definition.id] = definition

    def _read(self, at: int, size: int) -> bytes:
        data = os.pread(self._descriptor, size, at) if 0 <= size <= self._size - at else b''
        if len(data) != size:
            raise ValueError('the file has no such part')
        return data


def parse_records(data: bytes, *, whole: bool = True) -> tuple[Messages, list[Schema | Channel], int]:
    """Return the messages and definitions at the start of records, and the size of these.

    May raise any exception; ``whole``: raise if other records or bytes follow.
    """
    definitions: list[Schema | Channel] = []
    end, size = 0, HEAD.size + int.from_bytes(data[1 : HEAD.size], 'little')
    heads = np.frombuffer(data, np.uint8, len(data) // size * size).reshape(-1, size)[:, : HEAD.size]
    equal = data.startswith(bytes([Opcode.MESSAGE])) and bool((heads == heads[:1]).all())
    if equal and not (whole and len(data) % size):
        # Messages of equal length are the usual case.
        starts, end = np.arange(0, len(heads) * size, size), len(heads) * size
    else:
        places = array('q')
        for opcode, begin, stop in _records(data):
            if opcode == Opcode.MESSAGE:
                places.append(end)
            elif opcode in DEFINITIONS:
                definitions.append(_record(DEFINITIONS[opcode], data[begin:stop]))
            else:
                break
            end = stop
        starts = np.array(places, np.int64)
    messages = Messages(data, starts, _gathered(data, starts, MESSAGE))
    if (whole and end != len(data)) or (messages.heads['length'] < FIELDS).any():
        raise ValueError('the lengths of records are wrong')
    if len(starts) and data.startswith(ZSTD, int(starts[0]) + MESSAGE.itemsize):
        # rosbag2's compression mode ``message``.
        packed = [message.data for message in messages]
        contents = [zstandard.decompress(each) if each.startswith(ZSTD) else each for each in packed]
        messages = Messages.of(contents, messages.heads)
    return messages, definitions, end


def _records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, start and end of the content of each complete record."""
    end = 0
    while end + HEAD.size <= len(data):
        opcode, length = HEAD.unpack_from(data, end)
        begin = end + HEAD.size
        end = begin + length
        if end > len(data):
            return
        yield opcode, begin, end


def _record(kind: Any, content: bytes) -> Any:
    """Return a record as the library parses it; raise ValueError if bytes remain, as in a chunk of zeros."""
    stream = ReadDataStream(BytesIO(content))
    record = kind.read(stream)
    if stream.count != len(content):
        raise ValueError('the lengths in a record contradict each other')
    return record


def _gathered(data: bytes, places: Indices, kind: np.dtype[Any]) -> NDArray[Any]:
    """Return the values of one dtype at the offsets ``places`` in bytes, shape (N,)."""
    everywhere = np.ndarray((max(len(data) - kind.itemsize + 1, 0), kind.itemsize), np.uint8, data, 0, (1, 1))
    return everywhere[places].view(kind)[:, 0]


def _unpacked(record: bytes) -> bytes:
    """Return the records in a chunk, decompressed and checked, or raise any exception."""
    chunk = _record(Chunk, record[HEAD.size :])
    stream, size = get_chunk_data_stream(chunk, validate_crc=True)
    data = stream.read(size)
    if not chunk.uncompressed_crc:
        parse_records(data)
    return data


def _opened(path: Path) -> IO[bytes]:
    """Open an .mcap file for reading, or a decompressed temporary copy of an .mcap.zstd."""
    if path.suffix != '.zstd':
        return path.open('rb')
    plain = tempfile.TemporaryFile()  # noqa: SIM115
    # A truncated file is decompressed as far as possible.
    with path.open('rb') as packed, suppress(zstandard.ZstdError):
        zstandard.ZstdDecompressor().copy_stream(packed, plain)
    if not plain.tell():
        raise BagError(f'{path} cannot be decompressed: it is truncated or damaged; copy it again from the recorder')
    plain.seek(0)
    return plain
