# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Bags compressed in the modes of rosbag2, and files that decompress to gigabytes."""

import json
import resource
import struct
import subprocess
import sys
from functools import cache

import numpy as np
import pytest
import zstandard
from mcap import writer as mcap
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Chunk, Message
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from pendubot_identification.cli.main import main
from pendubot_identification.errors import BagError
from pendubot_identification.recordings.bag_reader import BagWindow, read_trajectory
from pendubot_identification.recordings.joint_states import JOINT_STATE

from .bags import FLOAT, START, STEP, TOPIC, message
from .independent import by_mcap

#: Limits of memory [bytes] and time [s] for a program that reads a small file.
MEMORY, TIME = 1 << 30, 60


def write(path, mode, count=300):
    """Write a bag in one of rosbag2's compression modes."""
    store = get_typestore(Stores.ROS2_JAZZY)
    writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode[mode], CompressionFormat.ZSTD)
    with writer:
        states = writer.add_connection(TOPIC, JOINT_STATE, typestore=store)
        other = writer.add_connection('/other', 'std_msgs/msg/Float64', typestore=store)
        for stamp, data in map(message, range(count)):
            writer.write(states, stamp, data)
            writer.write(other, stamp, FLOAT + bytes(8))
    return path


@pytest.mark.parametrize('mode', ['MESSAGE', 'FILE'])
def test_a_compressed_bag_is_read_surveyed_and_repaired(tmp_path, capsys, mode):
    bag = write(tmp_path / 'bag', mode)
    recorded = read_trajectory(BagWindow(bag, 0.5, 2))
    assert recorded.closed
    np.testing.assert_array_equal(recorded.trajectory.t, np.arange(50, 200) * STEP / 1e9)
    np.testing.assert_array_equal(recorded.trajectory.tau[:, 0], np.arange(50, 200))
    assert main(['info', str(bag), '--json']) == 0
    info = json.loads(capsys.readouterr().out)
    assert (info['closed'], info['note'], info['damaged']) == (True, '', [])
    found = [[topic[name] for name in ('messages', 'period', 'gaps', 'latency_max')] for topic in info['topics']]
    assert found == [[300, 0.01, 0, 0], [300, 0.01, 0, None]]
    assert main(['repair', str(bag), '--output', str(tmp_path / 'copy')]) == 0
    saved = by_mcap(tmp_path / 'copy')
    assert [each[1:] for each in saved if each[0] == TOPIC] == [message(k) for k in range(300)]
    assert len(saved) == 600


@pytest.mark.parametrize('mode', ['MESSAGE', 'FILE'])
def test_intact_messages_of_a_truncated_compressed_bag_are_read(tmp_path, mode):
    bag = write(tmp_path / 'bag', mode, 8000)
    (file,) = bag.glob('*.mcap*')
    data = file.read_bytes()
    file.write_bytes(data[: len(data) * 2 // 3])
    recorded = read_trajectory(bag)
    assert 2000 < len(recorded.trajectory) < 8000
    assert not recorded.closed
    file.write_bytes(data[:100])
    with pytest.raises(BagError, match=r'it is empty: record again|cannot be decompressed: it is truncated or damaged'):
        read_trajectory(bag)


def chunk(data, claimed, compression='zstd'):
    """Return the record of a chunk with this content and this claimed size."""
    builder = RecordBuilder()
    Chunk(compression, data, START, START, 0, claimed).write(builder)
    return builder.end()


@cache
def zeros(size):
    """Return zeros of this size, compressed."""
    packer = zstandard.ZstdCompressor().compressobj()
    block = bytes(1 << 20)
    return b''.join(packer.compress(block) for _ in range(size >> 20)) + packer.flush()


def one_message(data):
    """Return an uncompressed chunk with one message and its channel."""
    builder = RecordBuilder()
    Channel(1, '/x', 'cdr', {}, 0).write(builder)
    Message(1, START, data, START, 1).write(builder)
    content = builder.end()
    return chunk(content, len(content), '')


BOMBS = {
    'a chunk of a gigabyte': lambda: chunk(zeros(1 << 30), 1 << 30),
    'a chunk that claims 2^62 bytes': lambda: chunk(zeros(1 << 20), 1 << 62),
    'a chunk that is longer than it claims': lambda: chunk(zeros(1 << 30), 1 << 20),
    'a chunk of records of unknown types': lambda: chunk(zeros(1 << 26), 1 << 26) * 3,
    'a record that claims 2^62 bytes': lambda: struct.pack('<BQ', 5, 1 << 62) + bytes(100),
    'a message of a gigabyte': lambda: one_message(zeros(1 << 30)),
}
INFO = """
import sys
from pendubot_identification.cli.main import main
for bag in sys.argv[1:]:
    print(main(['info', bag, '--json']), end='---')
"""
READ = """
import sys
from pendubot_identification.recordings.bag_reader import Path, read_trajectory
print(len(read_trajectory(Path(sys.argv[1])).trajectory))
"""


def limited(program, *arguments):
    """Run Python with limited memory and time; return stdout and stderr."""
    ended = subprocess.run(
        [sys.executable, '-c', program, *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=TIME,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY)),
    )
    assert 'Traceback' not in ended.stderr, ended.stderr
    return ended.stdout, ended.stderr


def test_files_that_claim_or_contain_gigabytes_need_little_memory(tmp_path):
    bags = [tmp_path / f'{k}.mcap' for k in range(len(BOMBS))]
    for bag, bomb in zip(bags, BOMBS.values(), strict=True):
        bag.write_bytes(b'\x89MCAP0\r\n' + bomb() + one_message(FLOAT + b'whole'))
    zstd = tmp_path / 'bag.mcap.zstd'
    zstd.write_bytes(zeros(1 << 30))
    output, errors = limited(INFO, *bags, zstd)
    *outputs, status, _ = output.split('---')
    for name, text in zip(BOMBS, outputs, strict=True):
        info = json.loads(text.removesuffix('0'))
        assert (info['messages'], info['closed'], info['damaged'][0]['offset']) == (1, False, 8), name
    assert status == '1'
    (line,) = errors.splitlines()
    assert 'is no bag: decompressed it would be over 1000 times as large' in line


def test_a_highly_compressed_bag_needs_little_memory(tmp_path):
    with (tmp_path / 'bag.mcap').open('wb') as file:
        writer = mcap.Writer(file, compression=mcap.CompressionType.ZSTD)
        writer.start(profile='ros2')
        schema = writer.register_schema(JOINT_STATE, 'ros2msg', b'std_msgs/Header header')
        states, other = (writer.register_channel(name, 'cdr', schema) for name in (TOPIC, '/other'))
        for k in range(100):
            stamp, data = message(k)
            writer.add_message(states, stamp, data, stamp)
            if k % 10 == 0:
                writer.add_message(other, stamp, bytes(60_000_000), stamp)
        writer.finish()
    assert limited(READ, tmp_path / 'bag.mcap') == ('100\n', '')
