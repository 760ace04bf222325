"""Where the chunks of an .mcap file stand, and what times and channels are in them: its index, as arrays.

A recorder that flushes often makes many chunks; parsed record by record their index takes longer than a window's
samples. Neighbouring records are nearly always laid out alike, so they are read as one array. A file that was never
closed has no index; the same is made of what was found in it.
"""

from __future__ import annotations

import struct
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

CHUNK_INDEX = 0x08
#: A record's opcode and length; and how a chunk's begins: first and last log time [ns], where it stands, its length,
#: and how many bytes of channels with their places follow.
RECORD, BEGIN = struct.Struct('<BQ'), struct.Struct('<QQQQI')
#: A channel and where its index stands; what follows the channels, without the compression's name.
PLACE, REST = 10, 28
HEAD = RECORD.size + BEGIN.size


class FoundChunk(NamedTuple):
    """A chunk that was read: its messages' first and last log time [ns], where it stands [bytes], their channels."""

    first_ns: int
    last_ns: int
    offset: int
    length: int
    channels: Collection[int]


@dataclass(frozen=True, slots=True)
class ChunkIndex:
    """The chunks of a file in the order in which they stand there.

    Attributes:
        first_ns, last_ns: log times of their messages [ns], shape (C,).
        offset, length: where each begins, and how long it is [bytes], shape (C,).
        said: whether it is said of a chunk which channels are in it, shape (C,).
        chunk, channel: the numbers of a chunk and of a channel that it holds, shape (P,).
    """

    first_ns: NDArray[np.uint64]
    last_ns: NDArray[np.uint64]
    offset: NDArray[np.uint64]
    length: NDArray[np.uint64]
    said: NDArray[np.bool_]
    chunk: NDArray[np.intp]
    channel: NDArray[np.uint16]

    def __len__(self) -> int:
        return len(self.offset)

    @classmethod
    def of(cls, chunks: Sequence[FoundChunk]) -> ChunkIndex:
        """Return the index of chunks in the order in which they stand in the file."""
        first_ns, last_ns, offset, length = np.array([chunk[:4] for chunk in chunks], np.uint64).reshape(-1, 4).T
        places = [len(chunk.channels) for chunk in chunks]
        channel = np.fromiter(chain.from_iterable(chunk.channels for chunk in chunks), np.uint16)
        said, holder = np.ones(len(chunks), np.bool_), np.repeat(np.arange(len(chunks)), places)
        return cls(first_ns, last_ns, offset, length, said, holder, channel)

    @classmethod
    def split(cls, summary: bytes) -> tuple[ChunkIndex, bytes]:
        """Return the index in the records of a summary, and the other records.

        Raises:
            ValueError, struct.error: the bytes are no records.
        """
        runs, others, at = [], [], 0
        while at < len(summary):
            opcode, size = RECORD.unpack_from(summary, at)
            end = at + RECORD.size + size
            if end > len(summary):
                raise ValueError('a record reaches beyond the summary')
            if opcode == CHUNK_INDEX:
                runs.append(_alike(summary, at, end - at))
                end = at + runs[-1].size
            else:
                others.append(summary[at:end])
            at = end
        return cls._of(runs), b''.join(others)

    @classmethod
    def _of(cls, runs: list[NDArray[np.uint8]]) -> ChunkIndex:
        parts = [_numbers(rows) for rows in runs] or [_numbers(np.empty((0, HEAD + REST), np.uint8))]
        numbers = np.concatenate([part for part, _ in parts])
        places = np.concatenate([np.repeat(channels.shape[1], len(channels)) for _, channels in parts])
        # As they stand in the file, whatever the order of the index.
        order = np.argsort(numbers[:, 2], kind='stable')
        rank = np.empty_like(order)
        rank[order] = np.arange(len(order))
        first_ns, last_ns, offset, length = numbers[order].T
        channel = np.concatenate([channels.ravel() for _, channels in parts])
        return cls(first_ns, last_ns, offset, length, places[order] > 0, np.repeat(rank, places), channel)

    def holding(self, channels: Collection[int], low: int, high: int) -> NDArray[np.intp]:
        """Return the numbers of the chunks that may hold messages of some channels, logged at low <= t < high [ns]."""
        if high <= low or high <= 0 or low >= 2**64:
            return np.empty(0, dtype=np.intp)
        relevant = ~self.said
        relevant[self.chunk[np.isin(self.channel, list(channels))]] = True
        relevant &= self.last_ns >= np.uint64(max(low, 0))
        relevant &= self.first_ns <= np.uint64(min(high, 2**64) - 1)
        return np.flatnonzero(relevant)


def _alike(summary: bytes, at: int, size: int) -> NDArray[np.uint8]:
    """Return the record at a place and those behind it that are laid out alike, shape (records, size)."""
    if size < HEAD + REST:
        raise ValueError('an index record is too short')
    rows = np.frombuffer(summary, np.uint8, (len(summary) - at) // size * size, at).reshape(-1, size)
    fixed: Any = np.r_[: RECORD.size, HEAD - 4 : HEAD]
    alike = (rows[:, fixed] == rows[0, fixed]).all(axis=1)
    return rows[: len(rows) if alike.all() else int(alike.argmin())]


def _numbers(rows: NDArray[np.uint8]) -> tuple[NDArray[np.uint64], NDArray[np.uint16]]:
    """Return the four numbers with which records of one layout begin, shape (N, 4), and their channels, (N, P)."""
    listed = int.from_bytes(rows[0, HEAD - 4 : HEAD].tobytes(), 'little') if len(rows) else 0
    if listed % PLACE or HEAD + listed + REST > rows.shape[1]:
        raise ValueError('an index record names channels beyond its end')
    numbers = np.ascontiguousarray(rows[:, RECORD.size : HEAD - 4]).view('<u8')
    places = np.ascontiguousarray(rows[:, HEAD : HEAD + listed]).reshape(len(rows), listed // PLACE, PLACE)
    channels = np.ascontiguousarray(places[:, :, :2]).view('<u2')[:, :, 0]
    return numbers.astype(np.uint64), channels.astype(np.uint16)
