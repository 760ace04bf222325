"""The bytes: what is encoded is decoded, in any pieces; what is damaged is dropped, counted, and left behind."""

import struct
import zlib
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pendubot_identification.link.protocol import (
    MAX_FRAME,
    Command,
    Damaged,
    Decoder,
    Hello,
    HelloRequest,
    Sequence,
    State,
    Status,
    encode,
    frame,
)

ALL = (State, Command, Hello, HelloRequest)

u8, u16, u32 = (st.integers(0, 2**n - 1) for n in (8, 16, 32))
i16, i32 = (st.integers(-(2 ** (n - 1)), 2 ** (n - 1) - 1) for n in (16, 32))
ascii_name = st.text(st.characters(min_codepoint=33, max_codepoint=126), max_size=16)
states = st.builds(State, u16, u32, i32, i32, i32, i16, u16, u16, u16)
messages = st.one_of(
    states,
    st.builds(Command, u16, u32, u8, u16, i32, u8),
    st.builds(Hello, u16, u32, u32, u8, u16, u32, u32, i32, u32, ascii_name),
    st.builds(HelloRequest, u16, u32),
)

STATE = State(7, 123456, 4000, -1, -1_000_000, -250, 2400, 3, Status.ARMED | Status.SATURATED)


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


def test_a_state_is_laid_out_as_the_protocol_says():
    body = bytes([0x01, 1]) + struct.pack('<HI', 7, 123456)
    body += struct.pack('<iiihHHH', 4000, -1, -1_000_000, -250, 2400, 3, 0b1001)
    assert encode(STATE) == reference_frame(body)
    assert len(encode(STATE)) == 34


def test_a_hello_is_laid_out_as_the_protocol_says():
    hello = Hello(1, 2, 0xDEADBEEF, 4, 500, 4000, 8192, 2_000_000, 10_000, 'firmware 1.2')
    body = bytes([0x03, 1]) + struct.pack('<HI', 1, 2)
    body += struct.pack('<IBBHIIiI', 0xDEADBEEF, 4, 0, 500, 4000, 8192, 2_000_000, 10_000) + b'firmware 1.2\0\0\0\0'
    assert encode(hello) == reference_frame(body)
    assert Decoder().feed(encode(hello)) == [hello]


def test_commands_and_requests_are_laid_out_as_the_protocol_says():
    body = bytes([0x02, 1]) + struct.pack('<HI', 9, 10) + struct.pack('<BBHi', 1, 0, 100, -5)
    assert encode(Command(9, 10, 1, 100, -5)) == reference_frame(body)
    assert encode(HelloRequest(9, 10)) == reference_frame(bytes([0x04, 1]) + struct.pack('<HI', 9, 10))


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
    'state', [STATE, State(0, 0, 0, 0, 0, 0, 0, 0, 0), State(65535, 2**32 - 1, 1, 2, 3, 4, 5, 6, 7)]
)
def test_one_flipped_bit_never_yields_a_state_and_never_hides_the_frame_after_the_next(state):
    good = encode(state)
    after = State(8, 1, 1, 1, 1, 1, 1, 1, 1)
    for bit in range(8 * len(good)):
        bad = bytearray(good)
        bad[bit // 8] ^= 1 << bit % 8
        decoder = Decoder()
        assert not [e for e in decoder.feed(bytes(bad)) if not isinstance(e, Damaged)]
        # Where the delimiter itself was hit the next frame is lost with it, and no more.
        assert decoder.feed(encode(after) + encode(after))[-1] == after


def test_every_piece_of_a_damaged_frame_is_counted():
    for bit in range(8 * (len(encode(STATE)) - 1)):
        bad = bytearray(encode(STATE))
        bad[bit // 8] ^= 1 << bit % 8
        events = Decoder().feed(bytes(bad) + encode(STATE))
        damaged = [e for e in events if isinstance(e, Damaged)]
        # A flip that makes a zero cuts the frame into two damaged ones.
        assert len(damaged) == len([piece for piece in bad.split(b'\0') if piece])
        assert events[-1] == STATE


@pytest.mark.parametrize(
    ('body', 'reason'),
    [
        (bytes([0x01, 2]) + encode(STATE)[3:9], 'version'),
        (bytes([0x05, 1]) + bytes(6), 'type'),
        (bytes([0x02, 1]) + bytes(14), 'type'),
        (bytes([0x01, 1]) + bytes(6), 'length'),
        (bytes([0x01, 1]) + bytes(27), 'length'),
        (b'', 'length'),
    ],
)
def test_a_whole_frame_that_makes_no_sense_is_damaged(body, reason):
    assert Decoder().feed(frame(body)) == [Damaged(reason)]


@pytest.mark.parametrize('data', [b'\x05ab\0', b'\x02a\x05b\0', b'\xffabc\0'])
def test_cobs_that_does_not_add_up_is_damaged(data):
    assert Decoder().feed(data) == [Damaged('cobs')]


def test_a_wrong_crc_is_damaged():
    good = frame(bytes([0x04, 1]) + b'abcdef')
    assert Decoder(ALL).feed(good.replace(b'f', b'g')) == [Damaged('crc')]


def test_delimiters_alone_say_nothing():
    assert Decoder().feed(bytes(10) + encode(STATE) + bytes(3)) == [STATE]


def test_joining_in_the_middle_of_a_frame_the_first_whole_one_is_decoded():
    events = Decoder().feed(encode(STATE)[11:] + encode(STATE))
    assert isinstance(events[0], Damaged)
    assert events[1:] == [STATE]


def test_a_flood_without_delimiters_is_counted_once_and_not_kept():
    decoder = Decoder()
    events = [event for _ in range(100) for event in decoder.feed(b'x' * 1000)]
    assert events == [Damaged('overlong')]
    assert len(decoder._pending) <= MAX_FRAME
    assert decoder.feed(b'\0' + encode(STATE)) == [STATE]


def test_sequence_numbers_wrap():
    sequence = Sequence()
    assert all(sequence.accept(seq % 65536) for seq in range(65000, 67000))
    assert (sequence.lost, sequence.duplicates, sequence.out_of_order) == (0, 0, 0)


def test_lost_duplicate_and_late_frames_are_told_apart():
    sequence = Sequence()
    assert [sequence.accept(seq) for seq in (65534, 65535, 2, 2, 1, 3)] == [True, True, True, False, False, True]
    assert (sequence.lost, sequence.duplicates, sequence.out_of_order) == (2, 1, 1)


def test_after_a_silence_any_number_is_new():
    sequence = Sequence()
    sequence.accept(10)
    sequence.allow_gap()
    assert sequence.accept(50000)
    sequence.confirm_gap()
    assert sequence.lost == 49989
    assert not sequence.accept(50000)


def test_a_gap_before_a_restart_lost_nothing():
    sequence = Sequence()
    sequence.accept(10)
    sequence.allow_gap()
    sequence.accept(500)
    sequence.begin()
    assert sequence.accept(0)
    assert sequence.lost == 0
