# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The bytes: what is encoded is decoded, in any pieces; what is damaged is dropped, and told.

That a thousand damaged frames yield no wrong sample, and are counted exactly, benchmarks/faults shows.
"""

import struct
import zlib
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pendubot_identification.link.protocol import (
    MAX_FRAME,
    Arm,
    Command,
    Damaged,
    Decoder,
    Hello,
    HelloRequest,
    Limits,
    State,
    Status,
    encode,
    frame,
)

ALL = (State, Command, Hello, HelloRequest, Arm)

u8, u16, u32 = (st.integers(0, 2**n - 1) for n in (8, 16, 32))
i16, i32 = (st.integers(-(2 ** (n - 1)), 2 ** (n - 1) - 1) for n in (16, 32))
ascii_name = st.text(st.characters(min_codepoint=33, max_codepoint=126), max_size=16)
limits = st.builds(Limits, *[u32] * 5, *[u16] * 4)
messages = st.one_of(
    st.builds(State, u16, u32, i32, i32, i32, i16, u16, u16, u32, u16, u16),
    st.builds(Command, u16, u32, u8, u16, i32, u32),
    st.builds(Hello, u16, u32, u32, u8, u16, u32, u32, i32, u32, ascii_name, u8, u32, u32, u32, limits),
    st.builds(Arm, u16, u32, u32, u32, u16, u16),
    st.builds(HelloRequest, u16, u32),
)

STATE = State(7, 123456, 4000, -1, -1_000_000, -250, 2400, 3, Status.ARMED | Status.SATURATED, 9, 5)


def reference_frame(body):
    """COBS as its authors describe it, byte by byte."""
    out, block = bytearray(), bytearray()
    for byte in body + struct.pack('<I', zlib.crc32(body)):
        if byte:
            block.append(byte)
        else:
            out += bytes([len(block) + 1]) + block
            block.clear()
    return bytes(out + bytes([len(block) + 1]) + block + b'\0')


@pytest.mark.parametrize(
    ('message', 'layout', 'fields'),
    [
        (STATE, '<BBHIiiihHHIHH', (1, 2, 7, 123456, 4000, -1, -1_000_000, -250, 2400, 3, 0b1001, 9, 5)),
        (Command(9, 10, 1, 100, -5, session=77), '<BBHIBBHiI', (2, 2, 9, 10, 1, 0, 100, -5, 77)),
        (
            Hello(
                1, 2, 0xDEADBEEF, 4, 500, 4000, 8192, 2_000_000, 10_000, 'firmware 1.2', 3, 0x08000100, 0xABC, 200_000,
                Limits(*range(1, 10)),
            ),
            '<BBHIIBBHIIiI3I5I4H16s',
            (
                3, 2, 1, 2, 0xDEADBEEF, 4, 3, 500, 4000, 8192, 2_000_000, 10_000, 0x08000100, 0xABC, 200_000,
                *range(1, 10), b'firmware 1.2\0\0\0\0',
            ),
        ),
        (HelloRequest(9, 10), '<BBHI', (4, 2, 9, 10)),
        (Arm(9, 10, 0xDEADBEEF, 77, 5, 100), '<BBHIIIHH', (5, 2, 9, 10, 0xDEADBEEF, 77, 5, 100)),
    ],
)  # fmt: skip
def test_every_message_is_laid_out_as_the_protocol_says(message, layout, fields):
    assert encode(message) == reference_frame(struct.pack(layout, *fields))


@given(messages)
def test_what_is_encoded_is_decoded(message):
    data = encode(message)
    assert data.count(0) == 1
    assert len(data) <= MAX_FRAME + 1
    assert Decoder(ALL).feed(data) == [message]


@given(
    st.lists(st.one_of(messages.map(encode), st.binary(max_size=120), st.binary(max_size=3).map(lambda b: b + b'\0'))),
    st.data(),
)
def test_the_events_are_the_same_for_every_chunking(pieces, data):
    stream = b''.join(pieces)
    whole = Decoder(ALL).feed(stream)
    bytewise = Decoder(ALL)
    assert [event for byte in stream for event in bytewise.feed(bytes([byte]))] == whole
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=10)))
    chunked = Decoder(ALL)
    edges = [0, *cuts, len(stream)]
    assert [e for a, b in pairwise(edges) for e in chunked.feed(stream[a:b])] == whole


@pytest.mark.parametrize(
    ('data', 'reason'),
    [
        (frame(bytes([0x01, 3]) + encode(STATE)[3:9]), 'version'),
        (frame(bytes([0x06, 2]) + bytes(6)), 'type'),
        (frame(bytes([0x02, 2]) + bytes(18)), 'type'),
        (frame(bytes([0x01, 2]) + bytes(6)), 'length'),
        (frame(bytes([0x01, 2]) + bytes(33)), 'length'),
        (frame(b''), 'length'),
        (frame(bytes([0x04, 2]) + b'abcdef').replace(b'f', b'g'), 'crc'),
        (b'\x05ab\0', 'cobs'),
        (b'\x02a\x05b\0', 'cobs'),
        (b'\xffabc\0', 'cobs'),
    ],
)
def test_what_makes_no_sense_is_damaged_and_delimiters_alone_are_nothing(data, reason):
    assert Decoder().feed(data + bytes(10) + encode(STATE) + bytes(3)) == [
        Damaged(reason, 3 if reason == 'version' else 0),
        STATE,
    ]


def test_a_flood_without_delimiters_is_counted_once_and_not_kept():
    decoder = Decoder()
    events = [event for _ in range(100) for event in decoder.feed(b'x' * 1000)]
    assert events == [Damaged('overlong')]
    assert len(decoder._pending) <= MAX_FRAME
    assert decoder.feed(b'\0' + encode(STATE)) == [STATE]
