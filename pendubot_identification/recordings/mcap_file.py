# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""One .mcap file: its topics and its messages; of one that was never closed, or is damaged, all that is whole.

A closed file ends with an index of its chunks. Where there is none, one is made of every chunk whose checksum is right,
wherever it stands. Messages may also stand outside of chunks, one by one.
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
from collections.abc import Collection, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import zstandard
from mcap.opcode import Opcode
from mcap.records import Channel, Schema, Statistics
from numpy.typing import NDArray

from pendubot_identification.errors import BagError

from .mcap_records import DEFINITIONS, HEAD, IN_CHUNKS, Messages, parsed, records, understood, unpacked

MAGIC = b'\x89MCAP0\r\n'
#: The last record, the footer: opcode, length, where the summary and where its offsets begin, its CRC (0: none).
FOOTER = struct.Struct('<BQQQL')
#: How the index of a chunk begins: first and last log time, where its record stands, how long that is.
INDEX = struct.Struct('<qqqq')
#: The kinds of records that there are; beyond those opcodes are anybody's.
KINDS, FREE = frozenset(map(int, Opcode)), 0x80
#: No bag becomes so many times as long when it is decompressed.
RATIO = 1000
#: Bytes of records that are looked at together: enough for numpy, and still in a processor's cache.
TOGETHER = 250_000
FOREVER_NS = 2**63 - 1


class Damage(NamedTuple):
    """A part of a file that is not understood: where it begins and how long it is [bytes]."""

    offset: int
    size: int


class Part(NamedTuple):
    """A whole chunk, for which a checksum vouches, or records outside of chunks: where, how long [bytes], and what."""

    offset: int
    size: int
    definitions: list[Schema | Channel]
    messages: Messages
    vouched: bool


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
            self._descriptor = _opened(path)
            weakref.finalize(self, os.close, self._descriptor)
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
            yield found.part(wanted & (start_ns <= logged) & (logged < end_ns))

    def _indexed(self, rows: NDArray[np.int64]) -> Iterator[Messages]:
        """Return the messages of parts of the index; what is short is looked at together with what follows."""
        waiting, size = list[bytes](), 0
        for k, row in enumerate(rows):
            first_ns, _, offset, length = row.tolist()
            try:
                waiting.append(unpacked(self._read(offset, length)))
                size += len(waiting[-1])
                found = understood(b''.join(waiting))[1] if size >= TOGETHER or k + 1 == len(rows) else None
            except Exception as error:
                # What is whole before it comes first.
                with suppress(Exception):
                    yield understood(b''.join(waiting))[1]
                raise self._damaged(offset, first_ns) from error
            if found is not None:
                yield found
                waiting, size = [], 0

    def whole_parts(self, damages: list[Damage]) -> Iterator[Part]:
        """Return what is whole from the beginning of the file to its end, whatever an index says.

        Args:
            damages: to which what is not whole is added, as it is passed.

        Raises:
            OSError: the system refuses to read.
        """
        tail = os.pread(self._descriptor, len(MAGIC), max(self._size - len(MAGIC), len(MAGIC)))
        end = self._size - len(MAGIC) * (tail == MAGIC)
        at = passed = len(MAGIC)
        while at < end:
            size, part = self._part(at, end)
            if part is not None:
                passed = at + size
                yield part
            elif not size:
                # A wrong length leads past what is whole: so that is searched for from the last whole part on.
                found = self._next_chunk(passed + 1, end)
                at = passed if found < at else at
                size = found - at
                damages.append(Damage(at, size))
            at += size

    def _part(self, at: int, end: int) -> tuple[int, Part | None]:
        """Return the size of the record at an offset, and what it is, if it may hold messages; 0 if it is broken."""
        try:
            opcode, length = HEAD.unpack(self._read(at, HEAD.size))
            size = HEAD.size + length
            if at + size > end or (opcode < FREE and opcode not in KINDS):
                return 0, None
            if opcode in IN_CHUNKS:
                # Outside of chunks, mostly among others.
                size = _end_of_run(self._read(at, max(size, min(TOGETHER, end - at))))
            elif opcode != Opcode.CHUNK:
                return size, None
            part = Part(at, size, *understood(unpacked(self._read(at, size))), vouched=opcode == Opcode.CHUNK)
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
                if (part := self._part(start + found.start(), end)[1]) is not None and part.vouched:
                    return part.offset
            start += len(block)
        return end

    def _read_summary(self) -> NDArray[np.int64]:
        """Take what the end of the file says of the rest; return its index of chunks.

        Raises:
            Exception: it says nothing, or what makes no sense.
        """
        at = self._size - len(MAGIC) - FOOTER.size
        *head, start, _, crc = FOOTER.unpack(self._read(at, FOOTER.size))
        if head != [Opcode.FOOTER, FOOTER.size - HEAD.size] or self._read(at + FOOTER.size, len(MAGIC)) != MAGIC:
            raise ValueError('there is no footer')
        summary = self._read(start or at, at + FOOTER.size - (start or at))
        # An index with a wrong time would hide messages.
        if crc and zlib.crc32(summary[:-4]) != crc:
            raise ValueError('the summary is damaged')
        numbers, statistics = array('q'), None
        for opcode, begin, content_end in records(summary):
            # The library would take longer for these than for all else that a window needs.
            if opcode == Opcode.CHUNK_INDEX:
                numbers.extend(INDEX.unpack_from(summary, begin))
            elif opcode == Opcode.STATISTICS:
                statistics = parsed(Statistics, summary[begin:content_end])
            elif opcode in DEFINITIONS:
                self._learn(parsed(DEFINITIONS[opcode], summary[begin:content_end]))
        index = np.array(numbers, np.int64).reshape(-1, 4)
        if statistics is not None and statistics.message_count and statistics.chunk_count == len(index) > 0:
            self.first_ns, self.last_ns = statistics.message_start_time, statistics.message_end_time
            self._counts.update(statistics.channel_message_counts)
        return index[np.argsort(index[:, 2], kind='stable')]

    def _scan(self) -> NDArray[np.int64]:
        """Learn by reading everything what no index says; return the index."""
        damages: list[Damage] = []
        numbers = array('q')
        for offset, size, definitions, messages, vouched in self.whole_parts(damages):
            for each in definitions:
                self._learn(each, vouched)
            if len(messages):
                logged = messages.heads['logged']
                numbers.extend((int(logged.min()), int(logged.max()), offset, size))
                self._counts.update(messages.heads['channel'].tolist())
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
            if inside := [damage for damage in damages if sum(damage) < self._size]:
                lost = sum(damage.size for damage in inside)
                self.note += f'; {lost} bytes among them are not, first at byte {inside[0].offset}'
        return index

    def _learn(self, each: Schema | Channel, vouched: bool = True) -> None:
        known: dict[int, Any] = self.schemas if isinstance(each, Schema) else self.channels
        if vouched or each.id not in known:
            known[each.id] = each

    def _damaged(self, offset: int, first_ns: int) -> BagError:
        if not self.closed:
            return BagError(
                f'{self.path} was whole {offset} bytes from its start when it was opened and is not now: read it again'
            )
        after = (first_ns - (self.first_ns or 0)) / 1e9
        return BagError(
            f'{self.path} is damaged {offset} bytes from its start, {after:.3f} s after its first message; copy it '
            'again from where it was recorded, choose a window without that time, or save what is whole with pendubot '
            f'repair {self.path.parent}'
        )

    def _read(self, at: int, size: int) -> bytes:
        data = os.pread(self._descriptor, size, at) if 0 <= size <= self._size - at else b''
        if len(data) < size or size < 0:
            raise ValueError('the file has no such part')
        return data


def _opened(path: Path) -> int:
    """Return a descriptor to read an .mcap file by; where rosbag2 compressed it, one of a copy without a name."""
    if path.suffix != '.zstd':
        return os.open(path, os.O_RDONLY)
    with path.open('rb') as packed, tempfile.TemporaryFile() as plain:
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
        return os.dup(plain.fileno())


def _end_of_run(data: bytes) -> int:
    """Return where the whole records end that may stand in a chunk."""
    at = 0
    with suppress(ValueError, struct.error):
        for opcode, _, end in records(data):
            if opcode not in IN_CHUNKS:
                break
            at = end
    return at
