# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Reads one .mcap file, and the intact parts of an unclosed or damaged one.

The mcap library parses single records (https://mcap.dev/spec); numpy reads the messages of many records at once. A
closed file ends with an index of its chunks. For any other file, a scan of the complete file makes the index.
"""

from __future__ import annotations

import os
import re
import struct
import tempfile
import weakref
import zlib
from array import array
from collections import Counter, deque
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

from pendubot_identification.arrays import Indices
from pendubot_identification.errors import BagError

MAGIC = b'\x89MCAP0\r\n'
#: Opcode and length of a record.
HEAD = struct.Struct('<BQ')
#: A message's record up to its data; ``length`` is the size of the last four fields and the data.
MESSAGE = np.dtype('u1, <u8, <u2, <u4, <i8, <i8')
MESSAGE.names = ('opcode', 'length', 'channel', 'sequence', 'logged', 'published')
FIELDS = MESSAGE.itemsize - HEAD.size
#: Size of the footer record before the last magic [bytes].
FOOTER_SIZE = HEAD.size + 20
#: Start of a chunk's index record: first and last log time, offset and length of the chunk's record.
INDEX = struct.Struct('<qqqq')
#: Records of a chunk other than messages.
DEFINITIONS: dict[int, Any] = {Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel}
#: First opcode of private records.
PRIVATE = 128
#: Start of a message in rosbag2's compression mode ``message``; no CDR starts with these bytes.
ZSTD = b'\x28\xb5\x2f\xfd'
FOREVER_NS = 2**63 - 1


@dataclass(frozen=True, slots=True)
class Limits:
    """Memory limits: a small file that claims gigabytes must not fill the memory."""

    decompressed: int = 1 << 27  #: Largest size of a chunk or message after decompression [bytes].
    growth: int = 1000  #: Largest ratio of the sizes of an .mcap.zstd after and before decompression.
    block: int = 250_000  #: Size of the records that numpy reads at once [bytes]; fits into a processor's cache.


LIMITS = Limits()


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

    def followed_by(self, others: Messages) -> Messages:
        """Return these messages, followed by the others."""
        first = Messages.of([message.data for message in self], self.heads)
        starts = np.concatenate([first.starts, len(first.data) + others.starts])
        return Messages(first.data + others.data, starts, np.concatenate([first.heads, others.heads]))

    def contents(self, kind: DTypeLike) -> NDArray[Any]:
        """Return the start of each message's data as one dtype, shape (N,)."""
        return _gathered(self.data, self.starts + MESSAGE.itemsize, np.dtype(kind))


NOTHING = Messages(b'', np.empty(0, np.int64), np.empty(0, MESSAGE))


class Part(NamedTuple):
    """The content of a chunk, which has a checksum, or of consecutive records outside of chunks."""

    size: int  #: [bytes]
    is_chunk: bool = False
    definitions: Sequence[Schema | Channel] = ()
    messages: Messages = NOTHING


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
                raise BagError(f'{path} is no MCAP file; give a bag folder or a .mcap file as rosbag2 writes them')
            try:
                self._index = self._read_summary()
            except Exception:  # the parsers raise many types for damaged bytes
                self.closed = False
            if self.first_ns is None:
                deque(self.scan(), maxlen=0)
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
        """Yield blocks of messages of some topics with START <= log time < END [ns], in the order of log time.

        Only chunks with messages of these times are read. Intact messages before a damaged part are still yielded.

        Raises:
            BagError: a part of a closed file is damaged, or the file changed after it was opened.
        """
        channels = np.array([number for number, channel in self.channels.items() if channel.topic in topics], np.uint16)
        rows = self._index[(self._index[:, 1] >= start_ns) & (self._index[:, 0] < end_ns)]
        waiting = NOTHING
        for block, until_ns in self._read_parts(rows[np.argsort(rows[:, 0], kind='stable')]):
            wanted = np.isin(block.heads['channel'], channels, kind='table')
            wanted &= (start_ns <= block.heads['logged']) & (block.heads['logged'] < end_ns)
            found = waiting.followed_by(block.part(wanted)) if len(waiting) else block.part(wanted)
            logged = found.heads['logged']
            if (logged[1:] < logged[:-1]).any():
                found = found.part(np.argsort(logged, kind='stable'))
            # A recorder with several threads writes some messages after later ones, even into the next chunk.
            ready = int(np.searchsorted(found.heads['logged'], until_ns, side='right'))
            waiting = found.part(slice(ready, None))
            if ready:
                yield found.part(slice(ready))

    def _read_parts(self, rows: Indices) -> Iterator[tuple[Messages, int]]:
        """Yield the messages of index rows, sorted by first log time, with the first log time of the next row.

        Several small parts are read together.
        """
        waiting, size = list[bytes](), 0
        for k, (first_ns, _, offset, length) in enumerate(map(np.ndarray.tolist, rows)):
            next_ns = int(rows[k + 1, 0]) if k + 1 < len(rows) else FOREVER_NS
            try:
                waiting.append(_unpacked(self._read(offset, length)))
                size += len(waiting[-1])
                full = size >= LIMITS.block or k + 1 == len(rows)
                found = parse_records(b''.join(waiting)).messages if full else None
            except Exception as error:
                with suppress(Exception):
                    yield parse_records(b''.join(waiting)).messages, FOREVER_NS
                after = (first_ns - (self.first_ns or 0)) / 1e9
                raise BagError(
                    f'{self.path} is damaged {offset} bytes from its start, {after:.3f} s after its first message, or '
                    'changed after it was opened; copy it again from the recorder, choose a window without that time, '
                    f'or save its intact messages with pendubot repair {self.path.parent}'
                ) from error
            if found is not None:
                yield found, next_ns
                waiting, size = [], 0

    def _read_summary(self) -> Indices:
        """Read counts and definitions from the end of the file; return its chunk index, or raise any exception."""
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
        numbers, statistics, content_end = array('q'), None, 0
        for opcode, begin, content_end in _records(summary):
            # The library needs 0.15 s for the 30,000 of an hour, longer than all other steps for a short window.
            if opcode == Opcode.CHUNK_INDEX:
                numbers.extend(INDEX.unpack_from(summary, begin))
            elif opcode == Opcode.STATISTICS:
                statistics = _parsed(Statistics, summary[begin:content_end])
            elif opcode in DEFINITIONS:
                self._define(_parsed(DEFINITIONS[opcode], summary[begin:content_end]))
        if content_end != len(summary):
            raise ValueError('the summary is truncated')
        index = np.array(numbers, np.int64).reshape(-1, 4)
        if statistics is not None and statistics.message_count and statistics.chunk_count == len(index) > 0:
            self.first_ns, self.last_ns = statistics.message_start_time, statistics.message_end_time
            self._counts.update(statistics.channel_message_counts)
        return index[np.argsort(index[:, 2], kind='stable')]

    def scan(self) -> Iterator[Messages]:
        """Yield the messages of all intact parts in the order of writing, without the index, and list damaged parts.

        At the end, the intact parts become the index for :meth:`messages`, also of a closed file.

        Raises:
            OSError: reading fails.
        """
        tail = os.pread(self._descriptor, len(MAGIC), max(self._size - len(MAGIC), len(MAGIC)))
        end = self._size - len(MAGIC) * (tail == MAGIC)
        numbers, counts = array('q'), Counter[int]()
        self.damages = []
        at = intact = len(MAGIC)
        while at < end:
            part = self._part(at, end)
            if part is None:
                # A wrong length may skip intact chunks: search from the last intact part on.
                found = self._next_chunk(intact + 1, end)
                at = intact if found < at else at
                # The last chunk may be truncated.
                part = self._part(at, end, cut=True) if found == end else None
            if part is None:
                self.damages.append(Damage(at, found - at))
                at = found
                continue
            for definition in part.definitions:
                self._define(definition, part.is_chunk)
            if part.messages:
                heads = part.messages.heads
                numbers.extend((int(heads['logged'].min()), int(heads['logged'].max()), at, part.size))
                if self.first_ns is None:
                    counts.update(heads['channel'].tolist())
                yield part.messages
            at += part.size
            intact = at if part.definitions or part.messages else intact
        self._index = np.array(numbers, np.int64).reshape(-1, 4)
        if self.first_ns is None:
            self._counts, self.closed = counts, self.closed and not self.damages
            if len(self._index):
                self.first_ns, self.last_ns = int(self._index[:, 0].min()), int(self._index[:, 1].max())

    def _part(self, at: int, end: int, *, cut: bool = False) -> Part | None:
        """Return the chunk, the records outside of chunks, or the other record at an offset; None if it is damaged.

        With ``cut``, the end of a chunk may be missing.
        """
        try:
            opcode, length = HEAD.unpack(self._read(at, HEAD.size))
            size = min(HEAD.size + length, end - at) if cut and opcode == Opcode.CHUNK else HEAD.size + length
            if at + size > end or not (0 < opcode <= Opcode.DATA_END or opcode >= PRIVATE):
                return None
            if opcode == Opcode.CHUNK:
                return parse_records(_unpacked(self._read(at, size)))._replace(size=size, is_chunk=True)
            if opcode != Opcode.MESSAGE and opcode not in DEFINITIONS:
                return Part(size)
            # Records outside of chunks mostly follow each other.
            part = parse_records(self._read(at, max(size, min(LIMITS.block, end - at))), whole=False)
        except OSError:
            raise
        except Exception:  # as above
            return None
        # A chunk with a damaged opcode looks like a message of an unknown channel.
        known = {*self.channels, *(entry.id for entry in part.definitions if isinstance(entry, Channel))}
        return part if known.issuperset(part.messages.heads['channel'].tolist()) else None

    def _next_chunk(self, start: int, end: int) -> int:
        """Return the offset of the next intact chunk, or ``end`` if there is none."""
        while start < end:
            block = self._read(start, min(LIMITS.block, end - start))
            for found in re.finditer(bytes([Opcode.CHUNK]), block):
                if self._part(start + found.start(), end) is not None:
                    return start + found.start()
            start += len(block)
        return end

    def _define(self, definition: Schema | Channel, checked: bool = True) -> None:
        known: dict[int, Any] = self.schemas if isinstance(definition, Schema) else self.channels
        if checked or definition.id not in known:
            known[definition.id] = definition

    def _read(self, at: int, size: int) -> bytes:
        data = os.pread(self._descriptor, size, at) if 0 <= size <= self._size - at else b''
        if len(data) != size:
            raise ValueError('the file has no such part')
        return data


def parse_records(data: bytes, *, whole: bool = True) -> Part:
    """Return the messages and definitions in records, or raise any exception; ``whole``: raise if bytes remain."""
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
                places.append(begin - HEAD.size)
            elif opcode in DEFINITIONS:
                definitions.append(_parsed(DEFINITIONS[opcode], data[begin:stop]))
            else:
                break
            end = stop
        starts = np.array(places, np.int64)
    messages = Messages(data, starts, _gathered(data, starts, MESSAGE))
    if (whole and end != len(data)) or (messages.heads['length'] < FIELDS).any():
        raise ValueError('the lengths of records are wrong')
    if len(starts) and data.startswith(ZSTD, int(starts[0]) + MESSAGE.itemsize):
        # rosbag2's compression mode ``message``.
        contents, room = list[bytes](), LIMITS.decompressed
        for message in messages:
            content = _decompressed('zstd', message.data, room) if message.data.startswith(ZSTD) else message.data
            contents.append(content)
            room -= len(content)
        messages = Messages.of(contents, messages.heads)
    return Part(end, False, definitions, messages)


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


def _parsed(kind: Any, content: bytes) -> Any:
    """Return a record as the library parses it; raise ValueError if bytes remain."""
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
    """Return the records in a chunk, decompressed and checked, or raise any exception; other records unchanged."""
    if record[0] != Opcode.CHUNK:
        return record
    if len(record) < HEAD.size + int.from_bytes(record[1 : HEAD.size], 'little'):
        return _unpacked_cut(record)
    chunk = _parsed(Chunk, record[HEAD.size :])
    data = _decompressed(chunk.compression, chunk.data, chunk.uncompressed_size) if chunk.compression else chunk.data
    if len(data) != chunk.uncompressed_size or chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise ValueError('a chunk is damaged')
    return bytes(data)


def _unpacked_cut(record: bytes) -> bytes:
    """Return the complete records in a truncated chunk, without checksum, or raise any exception."""
    stream = ReadDataStream(BytesIO(record[HEAD.size + 16 :]))
    limit, _, compression, length = stream.read8(), stream.read4(), stream.read_prefixed_string(), stream.read8()
    data = record[HEAD.size + 16 + stream.count :]
    if len(data) >= length or limit > LIMITS.decompressed:
        raise ValueError('nothing is missing, or it is too large')
    if compression == 'lz4':
        data = lz4.frame.LZ4FrameDecompressor().decompress(data, limit)
    elif compression:
        data = zstandard.ZstdDecompressor().stream_reader(BytesIO(data)).read(limit)
    return data[: max((stop for _, _, stop in _records(data)), default=0)]


def _decompressed(compression: str, data: bytes, limit: int) -> bytes:
    """Return data of at most ``limit`` bytes: a small file that claims gigabytes must not fill the memory."""
    if limit > LIMITS.decompressed:
        raise ValueError('too large')
    if compression == 'lz4':
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, limit + 1))
    if compression != 'zstd' or zstandard.frame_content_size(data) > limit:
        raise ValueError('unknown compression, or too large')
    return zstandard.ZstdDecompressor().decompress(data, max_output_size=limit)


def _opened(path: Path) -> IO[bytes]:
    """Open an .mcap file for reading, or a decompressed temporary copy of an .mcap.zstd."""
    if path.suffix != '.zstd':
        return path.open('rb')
    plain = tempfile.TemporaryFile()  # noqa: SIM115
    # A truncated file is decompressed as far as possible.
    with path.open('rb') as packed, suppress(zstandard.ZstdError):
        limit = LIMITS.growth * os.fstat(packed.fileno()).st_size
        for block in zstandard.ZstdDecompressor().read_to_iter(packed):
            plain.write(block)
            if plain.tell() > limit:
                raise BagError(
                    f'{path} is no bag: decompressed it would be over {LIMITS.growth} times as large; copy it again '
                    'from the recorder'
                )
    if not plain.tell():
        raise BagError(f'{path} cannot be decompressed: it is truncated or damaged; copy it again from the recorder')
    plain.flush()
    return plain
