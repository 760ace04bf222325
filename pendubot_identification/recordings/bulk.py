"""Many messages at once: JointStates of one layout in a chunk of a bag, read as a numpy structure.

A JointState whose joints and frame keep their names has the same length and, but for its stamp and its numbers, the
same bytes in every message. So one message that rosbags has read says where all the others hold theirs. Whatever is
not laid out like it (other lengths, names, or an encoding that is not little-endian CDR) is left to rosbags.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.errors import BagError

#: A message's record in MCAP: opcode, length of what follows; channel, sequence, log time, publish time.
RECORD, MESSAGE = struct.Struct('<BQ'), struct.Struct('<HIQQ')
MESSAGE_OPCODE = 5
#: Little-endian CDR, and what stands at multiples of eight from its end.
ENCAPSULATION = b'\x00\x01\x00\x00'
NUMBER = 8


class Samples(NamedTuple):
    """Of some messages log time and stamp [ns], shape (N,), and position, effort, velocity of two joints, (N, 3, 2)."""

    log_ns: NDArray[np.int64]
    stamp_ns: NDArray[np.int64]
    values: NDArray[np.float64]

    def part(self, which: NDArray[np.bool_]) -> Samples:
        """Return some of them."""
        return Samples(self.log_ns[which], self.stamp_ns[which], self.values[which])


class Message(NamedTuple):
    """A message that is not laid out like the others: its log time [ns] and its bytes."""

    log_ns: int
    data: bytes


@dataclass(frozen=True, slots=True)
class Layout:
    """Where a message holds what.

    Attributes:
        record: a message's record, from its opcode on, shape (bytes,).
        same: 255 where a byte is the same in every such record, 0 elsewhere, shape (bytes,).
        numbers: the first byte of position, effort and velocity of both joints, shape (3, 2); -1 where there is none.
    """

    record: NDArray[np.uint8]
    same: NDArray[np.uint8]
    numbers: NDArray[np.intp]

    @classmethod
    def of(cls, data: bytes, channel: int, joint_names: Sequence[str]) -> Layout | None:
        """Return the layout of a JointState in CDR; None where it has none or lacks what is needed of the joints."""
        try:
            names, (positions, velocities, efforts), end = _walk(data)
            joints = [names.index(name) for name in joint_names]
        except (ValueError, struct.error):
            return None
        n = len(names)
        if end != len(data) or positions[1] != n or efforts[1] != n or velocities[1] not in (0, n):
            return None
        head = RECORD.size + MESSAGE.size
        record = RECORD.pack(MESSAGE_OPCODE, MESSAGE.size + len(data)) + MESSAGE.pack(channel, 0, 0, 0) + data
        same = np.full(len(record), 255, dtype=np.uint8)
        same[RECORD.size + 2 : head] = 0  # sequence and times
        same[head + 4 : head + 12] = 0  # the stamp
        for first, count in (positions, velocities, efforts):
            same[head + first : head + first + NUMBER * count] = 0
        numbers = [
            [head + first + NUMBER * joint if count else -1 for joint in joints]
            for first, count in (positions, efforts, velocities)
        ]
        return cls(np.frombuffer(record, np.uint8), same, np.array(numbers))

    def read(self, chunk: bytes) -> list[Samples | Message]:
        """Return the channel's messages in a chunk's bytes, one after the other as many at once as are laid out alike.

        Raises:
            BagError: the bytes are no records.
        """
        size, found = len(self.record), list[Samples | Message]()
        channel = self.record[RECORD.size : RECORD.size + 2].tobytes()
        header = RECORD.pack(MESSAGE_OPCODE, size - RECORD.size) + channel
        at = 0
        while at < len(chunk):
            begin = at + RECORD.size
            opcode, length = RECORD.unpack_from(chunk, at) if begin <= len(chunk) else (0, 0)
            end = begin + length
            if end > len(chunk):
                raise BagError('a bag is damaged: a record reaches beyond its chunk; copy it again from its recorder')
            if chunk.startswith(header, at):
                rows = np.frombuffer(chunk, np.uint8, (len(chunk) - at) // size * size, at).reshape(-1, size)
                alike = (rows[:, : len(header)] == rows[0, : len(header)]).all(axis=1)
                rows = rows[: len(rows) if alike.all() else int(alike.argmin())]
                if not ((rows ^ self.record) & self.same).any():
                    found.append(self._decoded(rows))
                    at += rows.size
                    continue
            if opcode == MESSAGE_OPCODE and chunk.startswith(channel, begin):
                found.append(Message(MESSAGE.unpack_from(chunk, begin)[2], chunk[begin + MESSAGE.size : end]))
            at = end
        return found

    def _decoded(self, rows: NDArray[np.uint8]) -> Samples:
        def column(first: int, kind: str) -> NDArray[np.generic]:
            return np.ndarray(len(rows), kind, rows.data, first, rows.strides[:1])

        head = RECORD.size + MESSAGE.size
        # Wide enough before it is multiplied: numpy 1 would keep the product in 32 bits.
        seconds, nanos = column(head + 4, '<i4').astype(np.int64), column(head + 8, '<u4').astype(np.int64)
        stamp = seconds * 1_000_000_000 + nanos
        values = np.full((len(rows), 6), math.nan)
        for k, first in enumerate(self.numbers.ravel()):
            if first >= 0:
                values[:, k] = column(int(first), '<f8')
        return Samples(column(RECORD.size + 6, '<i8').astype(np.int64), stamp, values.reshape(-1, 3, 2))


def _walk(data: bytes) -> tuple[list[str], list[tuple[int, int]], int]:
    """Return the joints' names; where position, velocity and effort begin, and how many there are; and the end.

    Raises:
        ValueError, struct.error: the bytes are no such message.
    """
    if data[:4] != ENCAPSULATION:
        raise ValueError('another encapsulation')
    at = 12  # behind the stamp

    def count() -> int:
        nonlocal at
        at += -at % 4
        (number,) = struct.unpack_from('<I', data, at)
        at += 4
        return int(number)

    def text() -> str:
        nonlocal at
        length = count()
        at += length
        return data[at - length : at - 1].decode()

    text()  # the frame
    names = [text() for _ in range(count())]
    arrays = []
    for _ in range(3):
        size = count()
        if size:
            at += -(at - len(ENCAPSULATION)) % NUMBER
        arrays.append((at, size))
        at += NUMBER * size
    return names, arrays, at
