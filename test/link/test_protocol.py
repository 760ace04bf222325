# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Encoding and decoding of frames; benchmarks/faults counts a thousand damaged ones."""

import re
from itertools import pairwise

import pytest
from hypothesis import given, settings
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
from test.conftest import ROOT

ALL = (State, Command, Hello, HelloRequest, Arm)

u8, u16, u32 = (st.integers(0, 2**n - 1) for n in (8, 16, 32))
i16, i32 = (st.integers(-(2 ** (n - 1)), 2 ** (n - 1) - 1) for n in (16, 32))
ascii_name = st.text(st.characters(min_codepoint=33, max_codepoint=126), max_size=16)
limits = st.builds(Limits, *[u32] * 5, *[u16] * 4)
messages = st.one_of(
    st.builds(State, u16, u32, i32, i32, i32, i16, u16, u16, u32, u16, u16),
    st.builds(Command, u16, u32, u8, u16, i32, u32),
    st.builds(Hello, u16, u32, u32, u8, u8, u16, u32, u32, i32, u32, u32, u32, u32, limits, ascii_name),
    st.builds(Arm, u16, u32, u32, u32, u16, u16),
    st.builds(HelloRequest, u16, u32),
)

STATE = State(7, 123456, 4000, -1, -1_000_000, -250, 2400, 3, Status.ARMED | Status.SATURATED, 9, 5)


def frames_of_the_page():
    """Return the example frames of docs/protocol.md by name."""
    page = (ROOT / 'docs/protocol.md').read_text()
    rows = re.findall(r'^\| (HELLO_REQUEST|COMMAND|ARM|STATE|HELLO) .* \| `([0-9a-f ]+)` \|$', page, re.MULTILINE)
    return {name: bytes.fromhex(frame) for name, frame in rows}


LIMITS = Limits(300_000, 60_000, 25_000, 100_000, 500_000, 500, 5000, 2000, 3000)
EXAMPLES = {
    'HELLO_REQUEST': HelloRequest(1, 1000),
    'COMMAND': Command(7, 250_000, 1, 100, -500_000, 2882400018),
    'ARM': Arm(6, 240_000, 3405643777, 2882400018, 3, 100),
    'STATE': State(258, 1_000_000, -1000, 250, 500_000, 5000, 2400, 7, 1, 2, 0),
    'HELLO': Hello(
        0, 0, 3405643777, 1, 0, 500, 4000, 4000, 2_000_000, 10_000, 0, 439041101, 200_000, LIMITS, 'my board 1'
    ),
}  # fmt: skip


def test_the_example_frames_of_the_protocol_page_are_correct():
    assert {name: encode(message) for name, message in EXAMPLES.items()} == frames_of_the_page()


@given(messages)
def test_decoding_inverts_encoding(message):
    data = encode(message)
    assert data.count(0) == 1
    assert len(data) <= MAX_FRAME + 1
    assert Decoder(ALL).feed(data) == [message]


@settings(max_examples=40)
@given(
    st.lists(st.one_of(messages.map(encode), st.binary(max_size=120), st.binary(max_size=3).map(lambda b: b + b'\0'))),
    st.data(),
)
def test_decoding_does_not_depend_on_the_chunks_of_the_stream(pieces, data):
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
def test_an_invalid_frame_is_reported_with_the_reason_and_empty_frames_are_ignored(data, reason):
    assert Decoder().feed(data + bytes(10) + encode(STATE) + bytes(3)) == [
        Damaged(reason, 3 if reason == 'version' else 0),
        STATE,
    ]


def test_a_long_stream_without_delimiters_is_counted_once_and_discarded():
    decoder = Decoder()
    events = [event for _ in range(100) for event in decoder.feed(b'x' * 1000)]
    assert events == [Damaged('overlong')]
    assert len(decoder._pending) <= MAX_FRAME + 1
    assert decoder.feed(b'\0' + encode(STATE)) == [STATE]
