# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The records of MCAP as bytes: decompressed within bounds, and their messages many at once.

Records as in https://mcap.dev/spec: an opcode, a length, and so many bytes. A chunk holds schemas, channels and
messages, and a checksum of them. What a length claims is held against a bound before it is believed.
"""

from __future__ import annotations

import struct
import zlib
from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from typing import Any

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Schema
from numpy.typing import DTypeLike, NDArray

#: Opcode and length of a record.
HEAD = struct.Struct('<BQ')
#: A message's record up to its data.
MESSAGE = np.dtype(
    [
        *(('opcode', 'u1'), ('length', '<u8'), ('channel', '<u2')),
        *(('sequence', '<u4'), ('logged', '<i8'), ('published', '<i8')),
    ]
)
#: What a message's length counts beside its data.
FIELDS = MESSAGE.itemsize - HEAD.size
#: What may stand in a chunk.
DEFINITIONS: dict[int, Any] = {Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel}
IN_CHUNKS = (*DEFINITIONS, Opcode.MESSAGE)
#: With what a message begins that rosbag2 compressed by itself; no CDR does.
ZSTD = b'\x28\xb5\x2f\xfd'
#: Nothing that is decompressed at once is longer than this [bytes].
LARGEST = 1 << 27


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

    def contents(self, kind: DTypeLike, offset: int = 0) -> NDArray[Any]:
        """Return what stands at an offset in each message's data, read as one type, shape (N,)."""
        return _gathered(self.data, self.starts + (MESSAGE.itemsize + offset), np.dtype(kind))


def records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Return opcode, begin and end of each record's content.

    Raises:
        ValueError, struct.error: the bytes are no records.
    """
    end = 0
    while end < len(data):
        opcode, length = HEAD.unpack_from(data, end)
        begin = end + HEAD.size
        end = begin + length
        if end > len(data):
            raise ValueError('a record reaches beyond the end')
        yield opcode, begin, end


def parsed(kind: Any, content: bytes) -> Any:
    """Return what the library reads in a record's content; all of it, or it is damaged."""
    stream = ReadDataStream(BytesIO(content))
    record = kind.read(stream)
    if stream.count != len(content):
        raise ValueError('the lengths in a record do not belong together')
    return record


def unpacked(record: bytes) -> bytes:
    """Return the records in a chunk, decompressed and checked; what is no chunk, as it is.

    Raises:
        Exception: it is damaged, or claims to be far too long.
    """
    if record[0] != Opcode.CHUNK:
        return record
    chunk = parsed(Chunk, record[HEAD.size :])
    data = _decompressed(chunk.compression, chunk.data, chunk.uncompressed_size) if chunk.compression else chunk.data
    if len(data) != chunk.uncompressed_size or chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise ValueError('a chunk is damaged')
    return bytes(data)


def understood(data: bytes) -> tuple[list[Schema | Channel], Messages]:
    """Return the definitions and the messages in the bytes of records that may stand in a chunk.

    Raises:
        Exception: they are no such records.
    """
    definitions: list[Schema | Channel] = []
    size = HEAD.size + int.from_bytes(data[1 : HEAD.size], 'little')
    if _alike(data, size):
        starts = np.arange(0, len(data), size)
    else:
        places = array('q')
        for opcode, begin, end in records(data):
            if opcode == Opcode.MESSAGE:
                places.append(begin - HEAD.size)
            elif opcode in DEFINITIONS:
                definitions.append(parsed(DEFINITIONS[opcode], data[begin:end]))
            else:
                raise ValueError('no chunk holds a record of this kind')
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


def _gathered(data: bytes, places: NDArray[np.int64], kind: np.dtype[Any]) -> NDArray[Any]:
    """Return what stands at some places of bytes, each read as the same type, shape (N,)."""
    everywhere = np.ndarray((max(len(data) - kind.itemsize + 1, 0), kind.itemsize), np.uint8, data, 0, (1, 1))
    return everywhere[places].view(kind)[:, 0]
