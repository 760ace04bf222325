# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""One .mcap file: its topics and its messages; of one that was never closed, or is damaged, all that is whole.

The mcap library parses the records (https://mcap.dev/spec), but for messages, which numpy reads many at once. A closed
file ends with an index of its chunks. Where there is none, one is made of every chunk whose checksum is right. Messages
may also stand outside of chunks. What a length claims is held against a bound before it is believed.
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
#: What a message's length counts beside its data.
FIELDS = MESSAGE.itemsize - HEAD.size
#: The record before the last magic.
FOOTER_SIZE = HEAD.size + 20
#: How the index of a chunk begins: first and last log time, where its record stands, how long that is.
INDEX = struct.Struct('<qqqq')
DEFINITIONS: dict[int, Any] = {Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel}
#: What may stand in a chunk.
IN_CHUNKS = (*DEFINITIONS, Opcode.MESSAGE)
#: The kinds of records that there are; opcodes from 128 on are anybody's.
KINDS = frozenset(map(int, Opcode)) | frozenset(range(128, 256))
#: With what a message begins that rosbag2 compressed by itself; no CDR does.
ZSTD = b'\x28\xb5\x2f\xfd'
#: Nothing that is decompressed at once is longer than this [bytes].
LARGEST = 1 << 27
#: No bag becomes so many times as long when it is decompressed.
RATIO = 1000
#: Bytes of records that are looked at together: enough for numpy, and still in a processor's cache.
TOGETHER = 250_000
FOREVER_NS = 2**63 - 1


@dataclass(frozen=True, slots=True)
class Damage:
    """A part of a file that is not understood: where it begins and how long it is [bytes]."""

    offset: int
    size: int


@dataclass(frozen=True, slots=True)
class Messages:
    """Messages that stand together.

    Attributes:
        data: their records, perhaps with others in between.
        starts: where each record begins, shape (N,).
        heads: the records up to the data, each a :data:`MESSAGE`, shape (N,).
    """

    data: bytes
    starts: NDArray[np.int64]
    heads: NDArray[np.void]

    @classmethod
    def of(cls, contents: Sequence[bytes]) -> Messages:
        """Return messages that were never in a file."""
        heads = np.zeros(len(contents), MESSAGE)
        sizes = np.array([len(content) for content in contents], np.int64)
        heads['length'] = FIELDS + sizes
        ends = np.cumsum(sizes + MESSAGE.itemsize)
        none = bytes(MESSAGE.itemsize)
        return cls(none + none.join(contents), ends - sizes - MESSAGE.itemsize, heads)

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
        """Return the beginning of each message's data, read as one type, shape (N,)."""
        return _gathered(self.data, self.starts + MESSAGE.itemsize, np.dtype(kind))


class Part(NamedTuple):
    """A chunk, for which a checksum vouches, or records outside of chunks: where, how long [bytes], and what."""

    offset: int
    size: int
    vouched: bool
    definitions: list[Schema | Channel]
    messages: Messages


class McapFile:
    """One .mcap file, closed or not, or .mcap.zstd, as rosbag2 compresses it.

    Attributes:
        path: of the file.
        closed: whether whoever wrote it came to the end.
        note: what could be read, in a sentence, where it was not closed; else empty.
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

        Only what holds messages of these times is read; what is whole before a damage is given first.

        Raises:
            BagError: a part of a closed file is damaged, or the file is not any more what it was.
        """
        channels = np.array([number for number, channel in self.channels.items() if channel.topic in topics], np.uint16)
        within = (self._index[:, 1] >= start_ns) & (self._index[:, 0] < end_ns)
        for found in self._indexed(self._index[within]):
            logged, wanted = found.heads['logged'], np.isin(found.heads['channel'], channels, kind='table')
            wanted &= (start_ns <= logged) & (logged < end_ns)
            if wanted.any():
                yield found.part(wanted)

    def _indexed(self, rows: NDArray[np.int64]) -> Iterator[Messages]:
        """Return the messages of parts of the index; what is short is looked at together with what follows."""
        waiting, size = list[bytes](), 0
        for k, (first_ns, _, offset, length) in enumerate(map(np.ndarray.tolist, rows)):
            try:
                waiting.append(_unpacked(self._read(offset, length)))
                size += len(waiting[-1])
                found = understood(b''.join(waiting))[1] if size >= TOGETHER or k + 1 == len(rows) else None
            except Exception as error:
                with suppress(Exception):
                    yield understood(b''.join(waiting))[1]
                after = (first_ns - (self.first_ns or 0)) / 1e9
                raise BagError(
                    f'{self.path} is damaged {offset} bytes from its start, {after:.3f} s after its first message, or '
                    'is not any more what it was when it was opened; copy it again from where it was recorded, choose '
                    f'a window without that time, or save what is whole with pendubot repair {self.path.parent}'
                ) from error
            if found is not None:
                yield found
                waiting, size = [], 0

    def whole_parts(self, damages: list[Damage]) -> Iterator[Part]:
        """Return what is whole from the beginning of the file to its end, whatever an index says.

        What is not whole is added to ``damages`` as it is passed.

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
                # A wrong length leads past what is whole, so that is searched for from the last part on.
                found = self._next_chunk(checked + 1, end)
                at = checked if found < at else at
                size = found - at
                damages.append(Damage(at, size))
            at += size

    def _part(self, at: int, end: int) -> tuple[int, Part | None]:
        """Return the size of the record at an offset, and what it is, if it may hold messages; 0 if it is broken."""
        try:
            opcode, length = HEAD.unpack(self._read(at, HEAD.size))
            size = HEAD.size + length
            if at + size > end or opcode not in KINDS:
                return 0, None
            if opcode in IN_CHUNKS:
                # Outside of chunks, mostly among others.
                size = _end_of_run(self._read(at, max(size, min(TOGETHER, end - at))))
            elif opcode != Opcode.CHUNK:
                return size, None
            part = Part(at, size, opcode == Opcode.CHUNK, *understood(_unpacked(self._read(at, size))))
            # Of a channel that was never heard of: it may well be a chunk whose first byte is damaged.
            known = {*self.channels, *(each.id for each in part.definitions if isinstance(each, Channel))}
            if part.vouched or known.issuperset(part.messages.heads['channel'].tolist()):
                return size, part
        except OSError:
            raise
        except Exception:  # whatever is raised here means that it is broken
            pass
        return 0, None

    def _next_chunk(self, start: int, end: int) -> int:
        """Return where the next whole chunk begins; the end where there is none."""
        while start < end:
            block = self._read(start, min(TOGETHER, end - start))
            for found in re.finditer(bytes([Opcode.CHUNK]), block):
                if self._part(start + found.start(), end)[1] is not None:
                    return start + found.start()
            start += len(block)
        return end

    def _read_summary(self) -> NDArray[np.int64]:
        """Take what the end of the file says of the rest; return its index of chunks, or raise anything."""
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
            # The library would take longer for these than for all else that a window needs.
            if opcode == Opcode.CHUNK_INDEX:
                numbers.extend(INDEX.unpack_from(summary, begin))
            elif opcode == Opcode.STATISTICS:
                statistics = _parsed(Statistics, summary[begin:content_end])
            elif opcode in DEFINITIONS:
                self._learn(_parsed(DEFINITIONS[opcode], summary[begin:content_end]))
        index = np.array(numbers, np.int64).reshape(-1, 4)
        if statistics is not None and statistics.message_count and statistics.chunk_count == len(index) > 0:
            self.first_ns, self.last_ns = statistics.message_start_time, statistics.message_end_time
            self._counts.update(statistics.channel_message_counts)
        return index[np.argsort(index[:, 2], kind='stable')]

    def _scan(self) -> NDArray[np.int64]:
        """Learn by reading everything what no index says; return the index."""
        damages: list[Damage] = []
        numbers = array('q')
        for part in self.whole_parts(damages):
            for each in part.definitions:
                self._learn(each, part.vouched)
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
                f'{self.path.name} was never closed, or is cut or damaged: its {count} messages that are whole, within '
                f'{seconds:.3f} s, are used'
            )
            if inside := [damage for damage in damages if damage.offset + damage.size < self._size]:
                lost = sum(damage.size for damage in inside)
                self.note += f'; {lost} bytes among them are not, first at byte {inside[0].offset}'
        return index

    def _learn(self, each: Schema | Channel, vouched: bool = True) -> None:
        known: dict[int, Any] = self.schemas if isinstance(each, Schema) else self.channels
        if vouched or each.id not in known:
            known[each.id] = each

    def _read(self, at: int, size: int) -> bytes:
        data = os.pread(self._descriptor, size, at) if 0 <= size <= self._size - at else b''
        if len(data) != size:
            raise ValueError('the file has no such part')
        return data


def understood(data: bytes) -> tuple[list[Schema | Channel], Messages]:
    """Return the definitions and the messages in the bytes of records that may stand in a chunk, or raise anything."""
    definitions: list[Schema | Channel] = []
    size = HEAD.size + int.from_bytes(data[1 : HEAD.size], 'little')
    if _alike(data, size):
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
        messages = understood(_each_decompressed(messages))[1]
    return definitions, messages


def _alike(data: bytes, size: int) -> bool:
    """Tell whether all are messages of one size, as mostly they are."""
    if data[:1] != bytes([Opcode.MESSAGE]) or len(data) % size:
        return False
    rows = np.frombuffer(data, np.uint8).reshape(-1, size)[:, : HEAD.size]
    return bool((rows == rows[0]).all())


def _records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Return opcode, begin and end of each record's content; ValueError or struct.error where there is none."""
    end = 0
    while end < len(data):
        opcode, length = HEAD.unpack_from(data, end)
        begin = end + HEAD.size
        end = begin + length
        if end > len(data):
            raise ValueError('a record reaches beyond the end')
        yield opcode, begin, end


def _end_of_run(data: bytes) -> int:
    """Return where the whole records end that may stand in a chunk."""
    at = 0
    with suppress(ValueError, struct.error):
        for opcode, _, end in _records(data):
            if opcode not in IN_CHUNKS:
                break
            at = end
    return at


def _parsed(kind: Any, content: bytes) -> Any:
    """Return what the library reads in a record's content; all of it, or it is damaged."""
    stream = ReadDataStream(BytesIO(content))
    record = kind.read(stream)
    if stream.count != len(content):
        raise ValueError('the lengths in a record do not belong together')
    return record


def _gathered(data: bytes, places: NDArray[np.int64], kind: np.dtype[Any]) -> NDArray[Any]:
    """Return what stands at some places of bytes, each read as the same type, shape (N,)."""
    everywhere = np.ndarray((max(len(data) - kind.itemsize + 1, 0), kind.itemsize), np.uint8, data, 0, (1, 1))
    return everywhere[places].view(kind)[:, 0]


def _unpacked(record: bytes) -> bytes:
    """Return the records in a chunk, decompressed and checked, or raise anything; what is no chunk, as it is."""
    if record[0] != Opcode.CHUNK:
        return record
    chunk = _parsed(Chunk, record[HEAD.size :])
    data = _decompressed(chunk.compression, chunk.data, chunk.uncompressed_size) if chunk.compression else chunk.data
    if len(data) != chunk.uncompressed_size or chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise ValueError('a chunk is damaged')
    return bytes(data)


def _each_decompressed(messages: Messages) -> bytes:
    """Return the records of messages as they were before rosbag2's compression mode ``message``."""
    parts, room = list[bytes](), LARGEST
    for message, head in zip(messages, messages.heads.copy(), strict=True):
        data = message.data
        if data.startswith(ZSTD):
            data = _decompressed('zstd', data, room)
            room -= len(data)
            head['length'] = FIELDS + len(data)
        parts += [head.tobytes(), data]
    return b''.join(parts)


def _decompressed(compression: str, data: bytes, limit: int) -> bytes:
    if limit > LARGEST:
        raise ValueError('far too long')
    if compression == 'lz4':
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, limit + 1))
    if compression != 'zstd' or zstandard.frame_content_size(data) > limit:
        raise ValueError('compressed in a way that is not known, or too long')
    return zstandard.ZstdDecompressor().decompress(data, max_output_size=limit)


def _opened(path: Path) -> IO[bytes]:
    """Return an .mcap file, opened to be read; where rosbag2 compressed it, a copy without a name."""
    if path.suffix != '.zstd':
        return path.open('rb')
    plain = tempfile.TemporaryFile()  # noqa: SIM115
    with path.open('rb') as packed:
        limit = RATIO * os.fstat(packed.fileno()).st_size
        # What is cut or damaged is taken as far as it goes.
        with suppress(zstandard.ZstdError):
            for block in zstandard.ZstdDecompressor().read_to_iter(packed):
                plain.write(block)
                if plain.tell() > limit:
                    raise BagError(f'{path} is no bag: it would be over {RATIO} times as long when it is decompressed')
    if not plain.tell():
        raise BagError(f'{path} cannot be decompressed: it is cut or damaged; copy it again from its recorder')
    plain.flush()
    return plain
