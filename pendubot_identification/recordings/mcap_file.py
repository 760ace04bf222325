# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""One .mcap file: its topics and its messages; of an unclosed or damaged file, everything that is intact.

The mcap library parses records (https://mcap.dev/spec) and chunks; numpy reads many messages at once. A closed file
ends with an index of its chunks. For an unclosed file, an index is made of every intact chunk. Messages may also stand
outside of chunks.
"""

from __future__ import annotations

import os
import re
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
from typing import IO, Any, NamedTuple

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Footer, Message, Schema, Statistics
from numpy.typing import DTypeLike, NDArray

from pendubot_identification.errors import BagError

MAGIC = b'\x89MCAP0\r\n'
#: Opcode and length of a record.
HEAD = struct.Struct('<BQ')
#: A message's record up to its data.
MESSAGE = np.dtype('u1, <u8, <u2, <u4, <i8, <i8')
MESSAGE.names = ('opcode', 'length', 'channel', 'sequence', 'logged', 'published')
#: A message's length counts these bytes beside its data.
FIELDS = MESSAGE.itemsize - HEAD.size
#: The record before the last magic.
FOOTER_SIZE = HEAD.size + 20
#: Start of a chunk's index record: first and last log time, offset and length of the chunk's record.
INDEX = struct.Struct('<qqqq')
DEFINITIONS: dict[int, Any] = {Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel}
#: Records that a chunk may hold.
IN_CHUNKS = (*DEFINITIONS, Opcode.MESSAGE)
#: The opcodes of the specification; those from 128 on are private.
OPCODES = frozenset(map(int, Opcode)) | frozenset(range(128, 256))
#: Start of a message that rosbag2 compressed by itself; no CDR starts like this.
ZSTD = b'\x28\xb5\x2f\xfd'
#: Nothing that decompresses at once is larger than this [bytes], and no bag grows by more than this factor.
LARGEST, RATIO = 1 << 27, 1000
#: Size of the blocks of records that numpy reads at once [bytes]; they fit into a processor's cache.
BLOCK = 250_000
FOREVER_NS = 2**63 - 1


@dataclass(frozen=True, slots=True)
class Damage:
    """A damaged part of a file: its offset and its size [bytes]."""

    offset: int
    size: int


@dataclass(frozen=True, slots=True)
class Messages:
    """Messages of one block of records.

    Attributes:
        data: their records, perhaps with others in between.
        starts: offset of each record, shape (N,).
        heads: the records up to the data, each a :data:`MESSAGE`, shape (N,).
    """

    data: bytes
    starts: NDArray[np.int64]
    heads: NDArray[np.void]

    @classmethod
    def of(cls, contents: Sequence[bytes], heads: NDArray[np.void] | None = None) -> Messages:
        """Return messages with these data; their channels and times are those of ``heads``."""
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

    def part(self, which: NDArray[Any]) -> Messages:
        """Return some of them."""
        return Messages(self.data, self.starts[which], self.heads[which])

    def contents(self, kind: DTypeLike) -> NDArray[Any]:
        """Return the start of each message's data as one type, shape (N,)."""
        return _gathered(self.data, self.starts + MESSAGE.itemsize, np.dtype(kind))


class Part(NamedTuple):
    """A chunk, which has a checksum, or consecutive records outside of chunks: offset, size [bytes] and content."""

    offset: int
    size: int
    is_chunk: bool
    definitions: list[Schema | Channel]
    messages: Messages


class McapFile:
    """One .mcap file, closed or not, or .mcap.zstd, as rosbag2 compresses it.

    Attributes:
        path: of the file.
        closed: whether its writer closed it.
        note: for an unclosed or damaged file, a sentence about its intact messages; else empty.
        channels, schemas: by their numbers.
        topics: the schema's name and the number of messages of each topic.
        first_ns, last_ns: earliest and latest log time [ns since the epoch]; None where there is no message.

    Raises:
        BagError: the file is missing, empty or no MCAP file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.closed, self.note = True, ''
        self.channels: dict[int, Channel] = {}
        self.schemas: dict[int, Schema] = {}
        self.first_ns: int | None = None
        self.last_ns: int | None = None
        self._counts: Counter[int] = Counter()
        try:
            file = _opened(path)
            weakref.finalize(self, file.close)
            self._descriptor = file.fileno()
            self._size = os.fstat(self._descriptor).st_size
            if not self._size:
                raise BagError(f'{path} is empty: its recording ended before anything was written; record it again')
            if os.pread(self._descriptor, len(MAGIC), 0) != MAGIC:
                raise BagError(f'{path} is no MCAP file; give a bag folder or a .mcap file as rosbag2 writes them')
            try:
                self._index = self._read_summary()
            except Exception:
                self.closed = False
            if self.first_ns is None:
                self._index = self._scan()
        except OSError as error:
            reason = error.strerror or str(error)
            raise BagError(f'{path} cannot be read: {reason}; check its name, permissions and disk') from error
        self.topics: dict[str, tuple[str, int]] = {}
        for number, channel in self.channels.items():
            schema = self.schemas.get(channel.schema_id)
            _, before = self.topics.get(channel.topic, ('', 0))
            self.topics[channel.topic] = (schema.name if schema else '', before + self._counts[number])

    def messages(self, topics: Collection[str], start_ns: int = 0, end_ns: int = FOREVER_NS) -> Iterator[Messages]:
        """Return the messages of some topics with START <= log time < END [ns], many at once, in the order of writing.

        Only chunks with messages of these times are read. Intact messages before a damage come first.

        Raises:
            BagError: a part of a closed file is damaged, or the file changed after it was opened.
        """
        channels = np.array([number for number, channel in self.channels.items() if channel.topic in topics], np.uint16)
        within = (self._index[:, 1] >= start_ns) & (self._index[:, 0] < end_ns)
        for found in self._indexed(self._index[within]):
            logged, wanted = found.heads['logged'], np.isin(found.heads['channel'], channels, kind='table')
            wanted &= (start_ns <= logged) & (logged < end_ns)
            if wanted.any():
                yield found.part(wanted)

    def _indexed(self, rows: NDArray[np.int64]) -> Iterator[Messages]:
        """Return the messages of parts of the index; several small parts are read together."""
        waiting, size = list[bytes](), 0
        for k, (first_ns, _, offset, length) in enumerate(map(np.ndarray.tolist, rows)):
            try:
                waiting.append(_unpacked(self._read(offset, length)))
                size += len(waiting[-1])
                found = parse_records(b''.join(waiting))[1] if size >= BLOCK or k + 1 == len(rows) else None
            except Exception as error:
                with suppress(Exception):
                    yield parse_records(b''.join(waiting))[1]
                after = (first_ns - (self.first_ns or 0)) / 1e9
                raise BagError(
                    f'{self.path} is damaged {offset} bytes from its start, {after:.3f} s after its first message, or '
                    'changed after it was opened; copy it again from the recorder, choose a window without that time, '
                    f'or save its intact messages with pendubot repair {self.path.parent}'
                ) from error
            if found is not None:
                yield found
                waiting, size = [], 0

    def intact_parts(self, damages: list[Damage]) -> Iterator[Part]:
        """Return the intact parts from the start of the file to its end, without the index.

        Damaged parts are appended to ``damages`` on the way.

        Raises:
            OSError: the system refuses to read.
        """
        tail = os.pread(self._descriptor, len(MAGIC), max(self._size - len(MAGIC), len(MAGIC)))
        end = self._size - len(MAGIC) * (tail == MAGIC)
        at = checked = len(MAGIC)
        while at < end:
            size, part = self._part(at, end)
            if part is not None:
                yield part
                checked = at + size
            elif not size:
                # A wrong length leads past intact chunks: search from the last intact part on.
                found = self._next_chunk(checked + 1, end)
                at = checked if found < at else at
                size = found - at
                damages.append(Damage(at, size))
            at += size

    def _part(self, at: int, end: int) -> tuple[int, Part | None]:
        """Return the size of the record at an offset, 0 if it is damaged, and its part if it may hold messages."""
        try:
            opcode, length = HEAD.unpack(self._read(at, HEAD.size))
            size = HEAD.size + length
            if at + size > end or opcode not in OPCODES:
                return 0, None
            if opcode in IN_CHUNKS:
                # Records outside of chunks mostly follow each other.
                size = _end_of_run(self._read(at, max(size, min(BLOCK, end - at))))
            elif opcode != Opcode.CHUNK:
                return size, None
            part = Part(at, size, opcode == Opcode.CHUNK, *parse_records(_unpacked(self._read(at, size))))
            # A chunk with a damaged opcode looks like a message of an unknown channel.
            known = {*self.channels, *(each.id for each in part.definitions if isinstance(each, Channel))}
            if part.is_chunk or known.issuperset(part.messages.heads['channel'].tolist()):
                return size, part
        except OSError:
            raise
        except Exception:  # the parsers raise many types for damaged bytes
            pass
        return 0, None

    def _next_chunk(self, start: int, end: int) -> int:
        """Return the offset of the next intact chunk; the end where there is none."""
        while start < end:
            block = self._read(start, min(BLOCK, end - start))
            for found in re.finditer(bytes([Opcode.CHUNK]), block):
                if self._part(start + found.start(), end)[1] is not None:
                    return start + found.start()
            start += len(block)
        return end

    def _read_summary(self) -> NDArray[np.int64]:
        """Take counts and definitions from the end of the file; return its index of chunks, or raise anything."""
        at = self._size - len(MAGIC) - FOOTER_SIZE
        record = self._read(at, FOOTER_SIZE + len(MAGIC))
        footer = _parsed(Footer, record[HEAD.size : FOOTER_SIZE])
        if record[0] != Opcode.FOOTER or record[FOOTER_SIZE:] != MAGIC:
            raise ValueError('there is no footer')
        start = footer.summary_start or at
        summary = self._read(start, at + FOOTER_SIZE - start)
        # An index with a wrong time would hide messages.
        if footer.summary_crc and zlib.crc32(summary[:-4]) != footer.summary_crc:
            raise ValueError('the summary is damaged')
        numbers, statistics = array('q'), None
        for opcode, begin, content_end in _records(summary):
            # The library would need ten times as long for these as a window of ten seconds.
            if opcode == Opcode.CHUNK_INDEX:
                numbers.extend(INDEX.unpack_from(summary, begin))
            elif opcode == Opcode.STATISTICS:
                statistics = _parsed(Statistics, summary[begin:content_end])
            elif opcode in DEFINITIONS:
                self._define(_parsed(DEFINITIONS[opcode], summary[begin:content_end]))
        index = np.array(numbers, np.int64).reshape(-1, 4)
        if statistics is not None and statistics.message_count and statistics.chunk_count == len(index) > 0:
            self.first_ns, self.last_ns = statistics.message_start_time, statistics.message_end_time
            self._counts.update(statistics.channel_message_counts)
        return index[np.argsort(index[:, 2], kind='stable')]

    def _scan(self) -> NDArray[np.int64]:
        """Make the index, the counts and the definitions by reading the whole file."""
        damages: list[Damage] = []
        numbers = array('q')
        for part in self.intact_parts(damages):
            for each in part.definitions:
                self._define(each, part.is_chunk)
            if part.messages:
                logged = part.messages.heads['logged']
                numbers.extend((int(logged.min()), int(logged.max()), part.offset, part.size))
                self._counts.update(part.messages.heads['channel'].tolist())
        index = np.array(numbers, np.int64).reshape(-1, 4)
        if len(index):
            self.first_ns, self.last_ns = int(index[:, 0].min()), int(index[:, 1].max())
        self.closed = self.closed and not damages
        if not self.closed:
            count = sum(self._counts[number] for number in self.channels)
            seconds = ((self.last_ns or 0) - (self.first_ns or 0)) / 1e9
            self.note = (
                f'{self.path.name} was never closed, or is truncated or damaged: its {count} intact messages, within '
                f'{seconds:.3f} s, are used'
            )
            if inside := [damage for damage in damages if damage.offset + damage.size < self._size]:
                lost = sum(damage.size for damage in inside)
                self.note += f'; {lost} bytes among them are damaged, first at byte {inside[0].offset}'
        return index

    def _define(self, each: Schema | Channel, checked: bool = True) -> None:
        known: dict[int, Any] = self.schemas if isinstance(each, Schema) else self.channels
        if checked or each.id not in known:
            known[each.id] = each

    def _read(self, at: int, size: int) -> bytes:
        data = os.pread(self._descriptor, size, at) if 0 <= size <= self._size - at else b''
        if len(data) != size:
            raise ValueError('the file has no such part')
        return data


def parse_records(data: bytes) -> tuple[list[Schema | Channel], Messages]:
    """Return the definitions and the messages in the records of a chunk, or raise anything."""
    definitions: list[Schema | Channel] = []
    size = HEAD.size + int.from_bytes(data[1 : HEAD.size], 'little')
    if _equally_long(data, size):
        starts = np.arange(0, len(data), size)
    else:
        places = array('q')
        for opcode, begin, end in _records(data):
            if opcode == Opcode.MESSAGE:
                places.append(begin - HEAD.size)
            else:
                definitions.append(_parsed(DEFINITIONS[opcode], data[begin:end]))
        starts = np.array(places, np.int64)
    heads = _gathered(data, starts, MESSAGE)
    if (heads['length'] < FIELDS).any():
        raise ValueError('a message is too short')
    messages = Messages(data, starts, heads)
    if len(starts) and data.startswith(ZSTD, int(starts[0]) + MESSAGE.itemsize):
        # rosbag2's compression mode ``message``.
        contents, room = list[bytes](), LARGEST
        for message in messages:
            data = _decompressed('zstd', message.data, room) if message.data.startswith(ZSTD) else message.data
            contents, room = [*contents, data], room - len(data)
        messages = Messages.of(contents, heads)
    return definitions, messages


def _equally_long(data: bytes, size: int) -> bool:
    """Tell whether all records are messages of this size, the usual case."""
    if data[:1] != bytes([Opcode.MESSAGE]) or len(data) % size:
        return False
    rows = np.frombuffer(data, np.uint8).reshape(-1, size)[:, : HEAD.size]
    return bool((rows == rows[0]).all())


def _records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Return opcode, start and end of each record's content; ValueError or struct.error where there is none."""
    end = 0
    while end < len(data):
        opcode, length = HEAD.unpack_from(data, end)
        begin = end + HEAD.size
        end = begin + length
        if end > len(data):
            raise ValueError('a record reaches beyond the end')
        yield opcode, begin, end


def _end_of_run(data: bytes) -> int:
    """Return the end of the leading records that may stand in a chunk."""
    at = 0
    with suppress(ValueError, struct.error):
        for opcode, _, end in _records(data):
            if opcode not in IN_CHUNKS:
                break
            at = end
    return at


def _parsed(kind: Any, content: bytes) -> Any:
    """Return a record as the library parses it; ValueError if that leaves bytes over."""
    stream = ReadDataStream(BytesIO(content))
    record = kind.read(stream)
    if stream.count != len(content):
        raise ValueError('the lengths in a record contradict each other')
    return record


def _gathered(data: bytes, places: NDArray[np.int64], kind: np.dtype[Any]) -> NDArray[Any]:
    """Return the values of one type at some offsets in bytes, shape (N,)."""
    everywhere = np.ndarray((max(len(data) - kind.itemsize + 1, 0), kind.itemsize), np.uint8, data, 0, (1, 1))
    return everywhere[places].view(kind)[:, 0]


def _unpacked(record: bytes) -> bytes:
    """Return the records in a chunk, decompressed and checked, or raise anything; other records as they are."""
    if record[0] != Opcode.CHUNK:
        return record
    chunk = _parsed(Chunk, record[HEAD.size :])
    data = _decompressed(chunk.compression, chunk.data, chunk.uncompressed_size) if chunk.compression else chunk.data
    if len(data) != chunk.uncompressed_size or chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise ValueError('a chunk is damaged')
    return bytes(data)


def _decompressed(compression: str, data: bytes, limit: int) -> bytes:
    """Return data of at most ``limit`` bytes: a small file that claims gigabytes must not fill the memory."""
    if limit > LARGEST:
        raise ValueError('too large')
    if compression == 'lz4':
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, limit + 1))
    if compression != 'zstd' or zstandard.frame_content_size(data) > limit:
        raise ValueError('unknown compression, or too large')
    return zstandard.ZstdDecompressor().decompress(data, max_output_size=limit)


def _opened(path: Path) -> IO[bytes]:
    """Return an .mcap file open for reading; of an .mcap.zstd, a decompressed temporary copy."""
    if path.suffix != '.zstd':
        return path.open('rb')
    plain = tempfile.TemporaryFile()  # noqa: SIM115
    # A truncated file is decompressed as far as possible.
    with path.open('rb') as packed, suppress(zstandard.ZstdError):
        limit = RATIO * os.fstat(packed.fileno()).st_size
        for block in zstandard.ZstdDecompressor().read_to_iter(packed):
            plain.write(block)
            if plain.tell() > limit:
                raise BagError(f'{path} is no bag: decompressed it would be over {RATIO} times as large')
    if not plain.tell():
        raise BagError(f'{path} cannot be decompressed: it is truncated or damaged; copy it again from the recorder')
    plain.flush()
    return plain
