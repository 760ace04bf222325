# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Bags read by libraries that are not ours."""

from collections import Counter

from mcap.reader import make_reader
from rosbags.rosbag2 import Reader


def by_rosbags(path):
    """Return (topic, log time, bytes) of every message, and what the metadata counts."""
    with Reader(path) as reader:
        messages = [(connection.topic, at, bytes(data)) for connection, at, data in reader.messages()]
        counts = {name: topic.msgcount for name, topic in reader.topics.items()}
        assert reader.message_count == len(messages) == sum(counts.values())
    assert Counter(topic for topic, *_ in messages) == Counter(counts)
    return messages


def by_mcap(path):
    """Return (topic, log time, bytes) of every message of all files, checksums checked, in the order of writing."""
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
