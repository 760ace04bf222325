# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Bags without an end: all that is whole is read, as the MCAP library reads it, and of a window no more than that."""

from itertools import chain
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.records import Channel, Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType, Writer

from pendubot_identification.errors import BagError
from pendubot_identification.recordings import mcap_file
from pendubot_identification.recordings.bag_reader import BagReader, Stream
from pendubot_identification.recordings.bag_writer import BagWriter
from pendubot_identification.recordings.joint_states import JOINT_NAMES, JOINT_STATE, encode_joint_state
from pendubot_identification.recordings.message_types import message_definition

START, STEP, COUNT = 1_700_000_000_000_000_000, 10_000_000, 400
TOPIC, OTHER = '/joint_states', '/other'
MAGIC = 8


def sample(k):
    return encode_joint_state(START + k * STEP, JOINT_NAMES, [0.01 * k, -0.01 * k], [0.1, k], [k, 0.5])


class Part(NamedTuple):
    """A chunk: where its record begins and ends, and its messages as (topic, log time, bytes)."""

    begin: int
    end: int
    messages: list


class Recorded(NamedTuple):
    """A closed file's path, its bytes and its chunks."""

    path: object
    data: bytes
    parts: list


@pytest.fixture(scope='module')
def closed(tmp_path_factory):
    path = tmp_path_factory.mktemp('recorded') / 'bag'
    with BagWriter(path) as bag:
        joints, other = bag.add_topic(TOPIC, JOINT_STATE), bag.add_topic(OTHER, JOINT_STATE)
        for k in range(COUNT):
            # Every other chunk holds one of the topics alone.
            bag.write(joints, sample(k), START + k * STEP + 1000, sequence=k + 1)
            if k // 10 % 2:
                bag.write(other, sample(k), START + k * STEP + 2000, sequence=k + 1)
    (file,) = path.glob('*.mcap')
    data = file.read_bytes()
    return Recorded(file, data, parts_of(file))


def parts_of(path):
    """Return the chunks of a file as the MCAP library reads them."""
    parts, topics, at = [], {}, MAGIC
    with path.open('rb') as file:
        for record in StreamReader(file, emit_chunks=True).records:
            if isinstance(record, Channel):
                topics[record.id] = record.topic
            if isinstance(record, Chunk):
                inside = breakup_chunk(record, validate_crc=True)
                topics |= {each.id: each.topic for each in inside if isinstance(each, Channel)}
                messages = [(topics[m.channel_id], m.log_time, m.data) for m in inside if isinstance(m, Message)]
                size = len(record.data) + len(record.compression) + 40 + 9
                begin = path.read_bytes().index(record.data, at) + len(record.data) - size
                parts.append(Part(begin, begin + size, messages))
                at = begin + size
    return parts


def unclosed(folder, data):
    folder.mkdir(exist_ok=True)
    (folder / 'bag_0.mcap').write_bytes(data)
    return folder


def contents(reader, topic):
    """Return log time and bytes of every message of a topic."""
    return [(message.log_time, message.data) for part in reader.messages([topic]) for message in part]


def check(reader, messages):
    """Hold what a reader says and gives against the messages that must be in the bag."""
    times = [at for _, at, _ in messages]
    assert not reader.closed
    assert f'{len(messages)} messages' in reader.note
    assert (reader.first_ns, reader.last_ns) == (min(times, default=0), max(times, default=0))
    for topic, (_, count) in reader.topics.items():
        expected = [(at, data) for name, at, data in messages if name == topic]
        assert count == len(expected)
        assert contents(reader, topic) == expected


def same_samples(reader, other, *window):
    for one, two in zip(
        Stream(reader, TOPIC, JOINT_NAMES, *window).samples(),
        Stream(other, TOPIC, JOINT_NAMES, *window).samples(),
        strict=True,
    ):
        np.testing.assert_array_equal(one, two)


@given(st.data())
def test_what_is_whole_is_read_whatever_is_cut_and_damaged(closed, tmp_path_factory, data):
    size = data.draw(st.integers(MAGIC, len(closed.data) - 1))
    left = bytearray(closed.data[:size])
    whole = [part for part in closed.parts if part.end <= size]
    if whole and data.draw(st.booleans()):
        hit = data.draw(st.sampled_from(whole))
        left[data.draw(st.integers(hit.begin + 9 + 24, hit.end - 1))] ^= data.draw(st.integers(1, 255))
        whole.remove(hit)
    reader = BagReader(unclosed(tmp_path_factory.getbasetemp() / 'cut', left))
    messages = list(chain.from_iterable(part.messages for part in whole))
    check(reader, messages)
    if not any(name == TOPIC for name, *_ in messages):
        return
    t, values = Stream(reader, TOPIC, JOINT_NAMES).samples()
    expected = [at - 1000 for name, at, _ in messages if name == TOPIC]
    np.testing.assert_array_equal(t, np.array(expected) - expected[0])
    np.testing.assert_array_equal(values[:, 1, 0], (np.array(expected) - START) / STEP)


@settings(max_examples=30)
@given(st.tuples(*[st.none() | st.floats(0, 4)] * 2).filter(lambda w: None in w or w[0] < w[1]))
def test_a_window_holds_what_it_holds_in_the_closed_bag(closed, tmp_path_factory, window):
    folder = unclosed(tmp_path_factory.getbasetemp() / 'open', closed.data[: closed.parts[-1].end])
    same_samples(BagReader(folder), BagReader(closed.path), *window)


def test_a_window_reads_the_chunks_of_the_window(closed, tmp_path, monkeypatch):
    reader, other = BagReader(unclosed(tmp_path / 'bag', closed.data[:-100])), BagReader(closed.path)
    read = []
    unpacked = mcap_file._unpacked
    monkeypatch.setattr(mcap_file, '_unpacked', lambda record: read.append(record) or unpacked(record))
    monkeypatch.setattr(mcap_file, 'TOGETHER', 1)
    of_each = []
    for each in (reader, other):
        read.clear()
        t, _ = Stream(each, TOPIC, JOINT_NAMES, 3.8, None).samples()
        assert len(t) == 20
        of_each.append(len(read))
    assert of_each[0] == of_each[1] < len(closed.parts) / 2


def test_a_file_that_grows_is_what_it_was_when_it_was_opened(closed, tmp_path):
    middle = closed.parts[20].end
    folder = unclosed(tmp_path / 'bag', closed.data[: middle + 100])
    reader = BagReader(folder)
    messages = [message for part in closed.parts[:21] for message in part.messages]
    check(reader, messages)
    for data in (closed.data[: closed.parts[30].end], closed.data):
        unclosed(folder, data)
        assert contents(reader, OTHER) == [message[1:] for message in messages if message[0] == OTHER]


def test_a_file_that_became_another_one_is_one_sentence(closed, tmp_path):
    folder = unclosed(tmp_path / 'bag', closed.data[:-100])
    reader = BagReader(folder)
    for data in (closed.data[: closed.parts[20].begin + 50], bytes(len(closed.data))):
        unclosed(folder, data)
        with pytest.raises(
            BagError, match=r'is damaged \d+ bytes from its start, .* or is not any more what it was when it was opened'
        ):
            contents(reader, TOPIC)


def foreign(path, numbers, **options):
    """Write some samples as others do; return the file's bytes without its end."""
    with path.open('wb') as file:
        writer = Writer(file, chunk_size=4000, **options)
        writer.start(profile='ros2')
        text = message_definition(JOINT_STATE).text.encode()
        channel = writer.register_channel(TOPIC, 'cdr', writer.register_schema(JOINT_STATE, 'ros2msg', text))
        for k in numbers:
            writer.add_message(channel, START + k * STEP, sample(k), START + k * STEP)
        writer.flush()
        end = file.tell()
        writer.finish()
    return path.read_bytes()[:end]


@pytest.mark.parametrize('compression', [CompressionType.ZSTD, CompressionType.LZ4])
def test_compressed_chunks_are_read(tmp_path, compression):
    reader = BagReader(unclosed(tmp_path / 'bag', foreign(tmp_path / 'file', range(300), compression=compression)))
    t, values = Stream(reader, TOPIC, JOINT_NAMES, 1, 2).samples()
    np.testing.assert_array_equal(t, np.arange(100, 200) * STEP)
    np.testing.assert_array_equal(values[:, 1, 0], np.arange(100, 200))


def test_without_checksums_a_chunk_is_whole_as_far_as_its_records_make_sense(tmp_path):
    data = bytearray(foreign(tmp_path / 'file', range(300), compression=CompressionType.NONE, enable_crcs=False))
    parts = parts_of(tmp_path / 'file')
    hit = parts[len(parts) // 2]
    # The length of its last message.
    data[hit.end - len(sample(0)) - 30] ^= 0x40
    messages = [message for part in parts if part != hit for message in part.messages]
    check(BagReader(unclosed(tmp_path / 'bag', data)), messages)


@pytest.mark.parametrize('chunked', [0, 50])
def test_messages_outside_of_chunks_are_read_too(tmp_path, chunked):
    outside = foreign(tmp_path / 'outside', range(100), use_chunking=False)
    inside = foreign(tmp_path / 'inside', range(100, 100 + chunked), compression=CompressionType.NONE)
    for part in parts_of(tmp_path / 'inside'):
        outside += inside[part.begin : part.end]
    reader = BagReader(unclosed(tmp_path / 'bag', outside))
    check(reader, [(TOPIC, START + k * STEP, sample(k)) for k in range(100 + chunked)])
    for window, expected in (((), range(100 + chunked)), ((0.9, 1.2), range(90, min(120, 100 + chunked)))):
        t, _ = Stream(reader, TOPIC, JOINT_NAMES, *window).samples()
        np.testing.assert_array_equal(t, np.array(expected) * STEP)
