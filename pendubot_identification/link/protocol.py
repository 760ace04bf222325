# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The serial protocol between board and host, version 2: bytes in, immutable messages out, and back.

A frame is ``COBS(body + crc) + 0x00``: little-endian, crc the CRC-32 (IEEE) of the body. This module opens no port:
bytes are arguments, in pieces of any size.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable
from enum import IntEnum
from typing import Any, NamedTuple

VERSION = 2

#: Length of the longest frame, HELLO, without the delimiter: 88 bytes of body, 4 of CRC and 1 of COBS.
MAX_FRAME = 93


class Status:
    """The status bits of a STATE, as plain numbers, because an IntFlag is too slow at 1 kHz."""

    ARMED = 1 << 0
    WATCHDOG = 1 << 1  #: The last arming ended because no command arrived in time.
    EMERGENCY_STOP = 1 << 2
    SATURATED = 1 << 3  #: The torque is clamped to the board's limit.
    ENCODER_1 = 1 << 4
    ENCODER_2 = 1 << 5
    OVER_CURRENT = 1 << 6
    OVER_TEMPERATURE = 1 << 7
    UNDERVOLTAGE = 1 << 8
    DAMAGED_FRAME = 1 << 9
    OVERRUN = 1 << 10  #: A frame could not be sent.
    REFUSED = 1 << 11  #: A COMMAND of another session, or an ARM that does not fit, was ignored.
    LATE = 1 << 12  #: This sample is more than half a period late.
    SLEW = 1 << 13  #: The slew rate limit holds the torque off the command.
    OVERVOLTAGE = 1 << 14
    SPEED = 1 << 15
    TRAVEL = 1 << 16
    STALL = 1 << 17  #: The shoulder's encoder stands still under torque.
    OVERLOAD = 1 << 18  #: The current has overheated the motor.
    ZEROED = 1 << 19  #: A user has confirmed the zeros of both encoders since the boot.


#: The status bits by name.
BITS: dict[str, int] = {name: bit for name, bit in vars(Status).items() if name.isupper()}
#: The bits that keep the motor off. Each is set while its cause lasts and, if it disarmed the board, until a mode 0.
FAULTS = Status.EMERGENCY_STOP | Status.ENCODER_1 | Status.ENCODER_2 | Status.OVER_CURRENT | Status.OVER_TEMPERATURE
FAULTS |= Status.UNDERVOLTAGE | Status.OVERVOLTAGE | Status.SPEED | Status.TRAVEL | Status.STALL | Status.OVERLOAD


class Mode(IntEnum):
    """The action of a COMMAND."""

    DISARM = 0
    TORQUE = 1
    CONFIRM_ZEROS = 2


class State(NamedTuple):
    """One sample, board to host."""

    seq: int
    t_us: int  #: The board's clock; wraps at 2^32.
    enc1: int  #: Counts of the shoulder, not wrapped per turn.
    enc2: int
    torque: int  #: Torque from this sample until the next [micro-N m].
    current: int  #: [mA]
    vbus: int  #: [10 mV]
    cmd_seq: int  #: Number of the last COMMAND or ARM that was executed, 0 before any.
    status: int  #: Bits of :class:`Status`.
    lock: int = 0  #: Required in the next ARM.
    refused: int = 0  #: Number of ignored requests.


class Command(NamedTuple):
    """Host to board: disarm, from any host, hold a torque, or store the confirmation of both encoders' zeros."""

    seq: int
    t_us: int
    mode: int  #: See :class:`Mode`.
    watchdog_ms: int = 0  #: Time for which the torque is held.
    torque: int = 0  #: [micro-N m]
    session: int = 0  #: For a torque, the session that armed the board; for the zeros, its boot_id.


class Arm(NamedTuple):
    """Host to board: arm for COMMANDs of a session, with torque 0."""

    seq: int
    t_us: int
    boot_id: int  #: Has to equal the value in HELLO.
    session: int  #: Not 0.
    lock: int  #: Has to equal the value in the newest STATE.
    watchdog_ms: int  #: Time for which the board stays armed without a COMMAND.


class Limits(NamedTuple):
    """The limits at which a board switches its motor off with a fault; 0: no such limit."""

    torque_slew: int = 0  #: Slew rate limit of the torque [micro-N m per ms]; no fault.
    max_speed: int = 0  #: Speed of either joint in three samples in a row [mrad/s].
    max_travel1: int = 0  #: Distance of the shoulder from count 0 [mrad].
    max_travel2: int = 0  #: Distance of the elbow from count 0 [mrad].
    stall_torque: int = 0  #: Smallest torque of a stall [micro-N m].
    stall_ms: int = 0  #: Duration of a stall: the shoulder moves by at most two counts [ms].
    continuous_ma: int = 0  #: Continuous current of the motor [mA].
    overload_ms: int = 0  #: Permitted duration of twice the continuous current [ms].
    max_vbus: int = 0  #: Largest supply voltage [10 mV].


class Hello(NamedTuple):
    """Board to host, at boot and on request: the board's identity, scale factors and limits."""

    seq: int
    t_us: int
    boot_id: int
    reset_cause: int
    fault_cause: int  #: Exception number of the processor fault before this boot; 0: none since power-on.
    watchdog_max_ms: int
    cpr1: int  #: Encoder counts per turn, of the shoulder.
    cpr2: int
    torque_limit: int  #: [micro-N m]
    sample_period_us: int
    fault_pc: int  #: Program counter at that fault.
    build: int  #: Identifies the firmware's source.
    torque_constant: int  #: [micro-N m per A]
    limits: Limits
    firmware: str


class HelloRequest(NamedTuple):
    """Host to board: send HELLO."""

    seq: int
    t_us: int


class Damaged(NamedTuple):
    """Dropped bytes.

    ``overlong`` is reported once, after more bytes than in the longest frame; the bytes end at the next 0x00.
    """

    reason: str  #: ``overlong``, ``cobs``, ``length``, ``crc``, ``version`` or ``type``.
    version: int = 0  #: Protocol version of a complete frame of another version, else 0.


Message = State | Command | Hello | HelloRequest | Arm
Event = Message | Damaged

#: By message: its type number, and its body of type, version and the message's fields in their order.
_BODIES: dict[type, tuple[int, struct.Struct]] = {
    kind: (number, struct.Struct(f'<BBHI{payload}'))
    for number, kind, payload in (
        (0x01, State, 'iiihHHIHH'),
        (0x02, Command, 'BxHiI'),
        (0x03, Hello, 'IBBHIIiIIIIIIIIIHHHH16s'),
        (0x04, HelloRequest, ''),
        (0x05, Arm, 'IIHH'),
    )
}
_TYPES: dict[int, Any] = {number: kind for kind, (number, _) in _BODIES.items()}
_CRC = struct.Struct('<I')
#: The CRC-32 of any bytes followed by their own CRC-32.
_CRC_RESIDUE = 0x2144DF1C


def encode(message: Message) -> bytes:
    """Return a message's frame, delimiter included. Raises struct.error: a field is out of the range of its format."""
    number, body = _BODIES[type(message)]
    values: tuple[Any, ...] = message
    if isinstance(message, Hello):
        values = *message[:-2], *message.limits, message.firmware.encode('ascii', 'replace')
    return frame(body.pack(number, VERSION, *values))


def frame(body: bytes) -> bytes:
    """Return a body's frame: CRC appended, COBS, delimiter. The body is shorter than 250 bytes."""
    blocks = (body + _CRC.pack(zlib.crc32(body))).split(b'\0')
    return b''.join(bytes((len(block) + 1,)) + block for block in blocks) + b'\0'


def _uncobs(data: bytes) -> bytearray | None:
    """Decode COBS of one or more bytes without a zero; return None if the code bytes do not lead to the end.

    In frames of less than 254 bytes every code byte replaces a zero and is the distance to the next code byte.
    """
    out, position = bytearray(data), 0
    while position < len(out):
        code = out[position]
        out[position] = 0
        position += code
    return out[1:] if position == len(out) else None


def _parse(data: bytes, accepted: frozenset[type]) -> Event:
    content = _uncobs(data)
    if content is None:
        return Damaged('cobs')
    if len(content) < _BODIES[HelloRequest][1].size + _CRC.size:
        return Damaged('length')
    if zlib.crc32(content) != _CRC_RESIDUE:
        return Damaged('crc')
    if content[1] != VERSION:
        return Damaged('version', content[1])
    kind = _TYPES.get(content[0])
    if kind not in accepted:
        return Damaged('type')
    _, body = _BODIES[kind]
    if len(content) != body.size + _CRC.size:
        return Damaged('length')
    _, _, *values = body.unpack_from(content)
    if kind is Hello:
        firmware = values.pop().rstrip(b'\0').decode('ascii', 'backslashreplace')
        first = len(values) - len(Limits._fields)
        values[first:] = Limits(*values[first:]), firmware
    message: Message = kind(*values)
    return message


class Decoder:
    """Decodes bytes, in pieces of any size, into events. It buffers at most one frame and a byte.

    Args:
        accept: the message types that this end receives; another type counts as damaged.

    Two delimiters in a row are no event.
    """

    def __init__(self, accept: Iterable[type] = (State, Hello)) -> None:
        self._accepted = frozenset(accept)
        self._pending = b''
        self._overlong = False

    def feed(self, data: bytes) -> list[Event]:
        """Decode the next bytes; return the events that they complete, in order."""
        events: list[Event] = []
        *ended, rest = (self._pending + data).split(b'\0')
        for piece in ended:
            if len(piece) > MAX_FRAME and not self._overlong:
                events.append(Damaged('overlong'))
            elif 0 < len(piece) <= MAX_FRAME:
                events.append(_parse(piece, self._accepted))
            self._overlong = False
        if len(rest) > MAX_FRAME and not self._overlong:
            self._overlong = True
            events.append(Damaged('overlong'))
        self._pending = rest[: MAX_FRAME + 1]
        return events
