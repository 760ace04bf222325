"""What is whole in an .mcap file that may be cut or damaged: every chunk whose checksum is right, wherever it stands.

Records as in https://mcap.dev/spec: an opcode, a length, and so many bytes. A chunk holds messages, and a checksum of
them; what stands outside of chunks has none, and is believed only as far as nothing else depends on it.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import UnsupportedCompressionError
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Message,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.stream_reader import get_chunk_data_stream

MAGIC = b'\x89MCAP0\r\n'

#: Opcode and length of a record.
HEAD = struct.Struct('<BQ')

#: A chunk's fields before its compression's name: first and last time, size, checksum, length of the name.
CHUNK_HEAD = struct.Struct('<QQQLL')

#: A message's fields before its data: channel, sequence number, log time, publish time.
MESSAGE_HEAD = struct.Struct('<HLQQ')

#: The same as they are read.
MessageHead = tuple[int, int, int, int]

#: How much is searched at once for the next whole chunk [bytes].
BLOCK = 1 << 20

_RECORDS: dict[int, Any] = {
    Opcode.HEADER: Header,
    Opcode.FOOTER: Footer,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.CHUNK_INDEX: ChunkIndex,
    Opcode.ATTACHMENT: Attachment,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex,
    Opcode.STATISTICS: Statistics,
    Opcode.METADATA: Metadata,
    Opcode.METADATA_INDEX: MetadataIndex,
    Opcode.SUMMARY_OFFSET: SummaryOffset,
    Opcode.DATA_END: DataEnd,
}


@dataclass(frozen=True, slots=True)
class Damage:
    """A part of a file that is not understood: where it begins and how long it is [bytes]."""

    offset: int
    size: int


class Whole(NamedTuple):
    """Something whole: a record, or the content of a chunk as bytes, which a checksum vouches for.

    Attributes:
        offset, size: where its record begins, and how long that is [bytes].
        content: the record; of a chunk the bytes of its records.
    """

    offset: int
    size: int
    content: Any


def whole_parts(path: Path, damages: list[Damage] | None = None) -> Iterator[Whole]:
    """Return the whole chunks of a file as bytes, and the schemas, channels, messages and end outside of chunks.

    Args:
        path: of the file; it begins with the magic.
        damages: to which what is not whole is added, as it is passed.

    Raises:
        UnsupportedCompressionError: a chunk is compressed in a way that cannot be read here.
        OSError: the system refuses to read.
    """
    size = path.stat().st_size
    at = len(MAGIC)
    chunked = False
    with path.open('rb') as file:
        while at < size:
            opcode, content = _record(file, at, size)
            if opcode == MAGIC[0] and size - at == len(MAGIC):
                return
            part: Any = None
            if content is not None:
                part = _understood(opcode, content, chunked)
            if part is None:
                end = _after_damage(file, at, size, content)
                if damages is not None:
                    damages.append(Damage(at, end - at))
                at = end
                continue
            chunked = chunked or isinstance(part, bytes)
            record = HEAD.size + len(content or b'')
            if isinstance(part, (bytes, Schema, Channel, Message, DataEnd)):
                yield Whole(at, record, part)
            at += record


def whole_records(path: Path, damages: list[Damage] | None = None) -> Iterator[tuple[bool, Any]]:
    """Return schemas, channels, messages and the end of a file, and whether a checksum vouches for each.

    Args:
        path: of the file; it begins with the magic.
        damages: to which what is not whole is added, as it is passed.

    Raises:
        UnsupportedCompressionError: a chunk is compressed in a way that cannot be read here.
        OSError: the system refuses to read.
    """
    for *_, part in whole_parts(path, damages):
        if isinstance(part, bytes):
            for record in chunk_records(part):
                yield True, record
        else:
            yield False, part


def chunk_records(data: bytes) -> Iterator[Any]:
    """Return the schemas, channels and messages in a chunk's content.

    Raises:
        Exception: as :func:`chunk_parts`.
    """
    for head, begin, end in chunk_parts(data):
        if isinstance(head, tuple):
            channel, sequence, log_time, publish_time = head
            yield Message(channel, log_time, data[begin:end], publish_time, sequence)
        else:
            yield head


def chunk_parts(data: bytes) -> Iterator[tuple[Any, int, int]]:
    """Return the same, of messages only their heads: a bag holds millions.

    Returns:
        a message's channel, sequence number, log time and publish time as a tuple, or another record; and where the
        message's data, or the other's fields, begin and end.

    Raises:
        ValueError, struct.error, or whatever the library raises: the bytes are no records.
    """
    at, end = 0, len(data)
    while at < end:
        opcode, length = HEAD.unpack_from(data, at)
        at += HEAD.size
        if at + length > end:
            raise ValueError('a record reaches beyond its chunk')
        if opcode == Opcode.MESSAGE:
            yield MESSAGE_HEAD.unpack_from(data, at), at + MESSAGE_HEAD.size, at + length
        elif opcode in _RECORDS:
            yield _RECORDS[opcode].read(ReadDataStream(BytesIO(data[at : at + length]))), at, at + length
        at += length


def _record(file: BinaryIO, at: int, size: int) -> tuple[int, bytes | None]:
    """Return the opcode and content of the record at an offset, None where it does not end within the file."""
    file.seek(at)
    head = file.read(HEAD.size)
    if len(head) < HEAD.size:
        return (head[0] if head else 0), None
    opcode, length = HEAD.unpack(head)
    if length > size - at - HEAD.size:
        return opcode, None
    content = file.read(length)
    return opcode, content if len(content) == length else None


def _understood(opcode: int, content: bytes, chunked: bool) -> Any:
    """Return what a record is, of a chunk its messages as bytes; None where it is broken."""
    # A checksum proves a chunk, even where its opcode was hit.
    if (chunk := _chunk(content)) is not None:
        return chunk
    try:
        if opcode == Opcode.MESSAGE and not chunked:
            return Message.read(ReadDataStream(BytesIO(content)), len(content))
        if opcode == Opcode.MESSAGE_INDEX:
            return ... if len(content) == 6 + int.from_bytes(content[2:6], 'little') else None
        if opcode in _RECORDS:
            # A record that is longer than its fields has a damaged length: to believe it would skip what follows.
            stream = ReadDataStream(BytesIO(content))
            record = _RECORDS[opcode].read(stream)
            return record if stream.count == len(content) else None
    # Whatever the library raises here means that the record is broken.
    except Exception:
        return None
    # Opcodes from 0x80 on are free for anybody's use.
    return ... if opcode >= 0x80 else None


def _chunk(content: bytes) -> bytes | None:
    """Return the messages of a chunk, decompressed; None where its fields or its checksum are wrong."""
    if not is_chunk_of(len(content), content):
        return None
    try:
        chunk = Chunk.read(ReadDataStream(BytesIO(content)))
        stream, length = get_chunk_data_stream(chunk, validate_crc=True)
        data = stream.read(length)
        if not chunk.uncompressed_crc:
            # Written without a checksum: its records at least must follow each other to its end.
            deque(chunk_parts(data), maxlen=0)
    except UnsupportedCompressionError:
        raise
    except Exception:
        return None
    return data if length == chunk.uncompressed_size else None


def is_chunk_of(length: int, head: bytes) -> bool:
    """Tell whether the lengths inside a chunk, of which this is the beginning, add up to that of its record."""
    if len(head) < CHUNK_HEAD.size:
        return False
    *_, name = CHUNK_HEAD.unpack_from(head)
    at = CHUNK_HEAD.size + name
    return name <= 8 and len(head) >= at + 8 and at + 8 + int.from_bytes(head[at : at + 8], 'little') == length


def _after_damage(file: BinaryIO, at: int, size: int, content: bytes | None) -> int:
    """Return where to go on after what is broken at an offset: at its end, or at the next whole chunk, or nowhere."""
    if content is not None and is_chunk_of(len(content), content):
        return at + HEAD.size + len(content)
    overlap = HEAD.size + CHUNK_HEAD.size + 16
    start = at + 1
    while start < size:
        file.seek(start)
        block = file.read(BLOCK + overlap)
        found = block.find(Opcode.CHUNK)
        while 0 <= found < BLOCK and found + overlap <= len(block):
            _, length = HEAD.unpack_from(block, found)
            if is_chunk_of(length, block[found + HEAD.size : found + overlap]):
                _, candidate = _record(file, start + found, size)
                if candidate is not None and _chunk(candidate) is not None:
                    return start + found
            found = block.find(Opcode.CHUNK, found + 1)
        start += BLOCK
    return size
