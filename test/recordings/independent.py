# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Bags read by the libraries rosbags and mcap."""

from collections import Counter
from contextlib import suppress
from typing import NamedTuple

from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk
from rosbags.rosbag2 import Reader


def by_rosbags(path):
    """Return (topic, log time, bytes) of every message; check the counts of the metadata."""
    with Reader(path) as reader:
        messages = [(connection.topic, at, bytes(data)) for connection, at, data in reader.messages()]
        counts = {name: topic.msgcount for name, topic in reader.topics.items()}
        assert reader.message_count == len(messages) == sum(counts.values())
    assert Counter(topic for topic, *_ in messages) == Counter(counts)
    return messages


def by_mcap(path):
    """Return (topic, log time, bytes) of every message of all files in the order of writing; verify checksums."""
    messages = []
    files = sorted(path.glob('*.mcap'), key=lambda file: (len(file.name), file.name))
    for each in files:
        with each.open('rb') as file:
            reader = make_reader(file, validate_crcs=True)
            of_file = [
                (channel.topic, message.log_time, message.data)
                for _, channel, message in reader.iter_messages(log_time_order=False)
            ]
            assert reader.get_summary().statistics.message_count == len(of_file)
        messages += of_file
    return messages


class Part(NamedTuple):
    """A chunk: begin and end of its record, and its messages as (topic, log time, bytes)."""

    begin: int
    end: int
    messages: list


def chunks(path):
    """Return the chunks of a file, closed or not."""
    parts, topics, data, at = [], {}, path.read_bytes(), 0
    with path.open('rb') as file, suppress(EndOfFile):
        for record in StreamReader(file, emit_chunks=True).records:
            if isinstance(record, Channel):
                topics[record.id] = record.topic
            if isinstance(record, Chunk):
                inside = breakup_chunk(record, validate_crc=True)
                topics |= {each.id: each.topic for each in inside if isinstance(each, Channel)}
                messages = [(topics[m.channel_id], m.log_time, m.data) for m in inside if isinstance(m, Message)]
                at = data.index(record.data, at) + len(record.data)
                parts.append(Part(at - len(record.data) - len(record.compression) - 40 - 9, at, messages))
    return parts
