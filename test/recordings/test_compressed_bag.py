# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Bags that rosbags compressed as rosbag2 does it, and files that claim to be far larger than they are."""

import json
import resource
import struct
import subprocess
import sys

import numpy as np
import pytest
import zstandard
from mcap import writer as mcap
from mcap.data_stream import RecordBuilder
from mcap.records import Chunk
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from pendubot_identification.cli.main import main
from pendubot_identification.errors import BagError
from pendubot_identification.recordings.bag_reader import BagWindow, read_trajectory
from pendubot_identification.recordings.joint_states import JOINT_NAMES, JOINT_STATE, encode_joint_state

from ..processes import MODULES
from .independent import by_mcap

START, STEP, COUNT = 1_700_000_000_000_000_000, 10_000_000, 300
#: No program that looks at a small file needs more memory than this [bytes], or more time than this [s].
MEMORY, TIME = 1 << 30, 60


def sample(k):
    return encode_joint_state(START + k * STEP, JOINT_NAMES, [0.01 * k, -0.01 * k], [0.1, k], [k, 0.5])


def write(path, mode, count=COUNT):
    """Write a bag in one of rosbag2's compression modes."""
    store = get_typestore(Stores.ROS2_JAZZY)
    writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode[mode], CompressionFormat.ZSTD)
    with writer:
        states = writer.add_connection('/joint_states', JOINT_STATE, typestore=store)
        other = writer.add_connection('/other', 'std_msgs/msg/Float64', typestore=store)
        for k in range(count):
            writer.write(states, START + k * STEP, sample(k))
            writer.write(other, START + k * STEP, bytes([0, 1, 0, 0]) + struct.pack('<d', k))
    return path


@pytest.fixture(params=['MESSAGE', 'FILE', 'STORAGE'])
def bag(request, tmp_path):
    return write(tmp_path / 'bag', request.param)


def test_a_compressed_bag_is_read(bag):
    recorded = read_trajectory(BagWindow(bag, 0.5, 2))
    assert recorded.closed
    np.testing.assert_array_equal(recorded.trajectory.t, np.arange(50, 200) * STEP / 1e9)
    np.testing.assert_array_equal(recorded.trajectory.q, np.arange(50, 200)[:, None] * [0.01, -0.01])
    np.testing.assert_array_equal(recorded.trajectory.tau[:, 0], np.arange(50, 200))


def test_a_compressed_bag_is_looked_at(bag, capsys):
    assert main(['info', str(bag), '--json']) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told['closed'], told['note'], told['damaged']) == (True, '', [])
    for topic in told['topics']:
        assert (topic['messages'], topic['period'], topic['gaps']) == (COUNT, 0.01, 0)
        assert topic['latency_max'] == (0 if topic['name'] == '/joint_states' else None)


def test_a_compressed_bag_is_repaired_into_one_that_is_not(bag, tmp_path):
    assert main(['repair', str(bag), '--output', str(tmp_path / 'copy')]) == 0
    saved = by_mcap(tmp_path / 'copy')
    assert [(at, data) for name, at, data in saved if name == '/joint_states'] == [
        (START + k * STEP, sample(k)) for k in range(COUNT)
    ]
    assert len(saved) == 2 * COUNT


@pytest.mark.parametrize('mode', ['MESSAGE', 'FILE'])
def test_of_a_compressed_bag_that_is_cut_what_is_whole_is_used(tmp_path, mode):
    bag = write(tmp_path / 'bag', mode, 20_000)
    (file,) = [file for file in bag.iterdir() if file.name != 'metadata.yaml']
    data = file.read_bytes()
    file.write_bytes(data[: len(data) * 2 // 3])
    recorded = read_trajectory(bag)
    assert 5000 < len(recorded.trajectory) < 20_000
    assert not recorded.closed
    file.write_bytes(data[:100])
    with pytest.raises(BagError, match=r'no message|cannot be decompressed: it is cut or damaged'):
        read_trajectory(bag)


def chunk(data, claimed, crc=0):
    """Return a chunk's record: its compressed records, and how long they are said to be."""
    builder = RecordBuilder()
    Chunk('zstd', data, START + STEP, START, crc, claimed).write(builder)
    return builder.end()


def zeros(size):
    """Return so many zeros, compressed."""
    packer = zstandard.ZstdCompressor().compressobj()
    block = bytes(1 << 20)
    return b''.join(packer.compress(block) for _ in range(size >> 20)) + packer.flush()


def one_message(data):
    """Return the record of a message, on a channel that is defined before it, uncompressed in a chunk."""
    definition = struct.pack('<BQHHI2sI3sI', 4, 2 + 2 + 4 + 2 + 4 + 3 + 4, 1, 0, 2, b'/x', 3, b'cdr', 0)
    record = definition + struct.pack('<BQHIQQ', 5, 22 + len(data), 1, 1, START, START) + data
    builder = RecordBuilder()
    Chunk('', record, START, START, 0, len(record)).write(builder)
    return builder.end()


BOMBS = {
    'a chunk of a gigabyte': lambda: chunk(zeros(1 << 30), 1 << 30),
    'a chunk that claims 2^62 bytes': lambda: chunk(zeros(1 << 20), 1 << 62),
    'a chunk that is longer than it claims': lambda: chunk(zeros(1 << 30), 1 << 20),
    'a chunk of records of no kind': lambda: chunk(zeros(1 << 26), 1 << 26) * 3,
    'a record that claims 2^62 bytes': lambda: struct.pack('<BQ', 5, 1 << 62) + bytes(100),
    'a message of a gigabyte': lambda: one_message(zeros(1 << 30)),
}


def limited(*command):
    """Run Python with little memory and time; return the ended process."""
    ended = subprocess.run(
        [sys.executable, *map(str, command)],
        capture_output=True,
        text=True,
        timeout=TIME,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY)),
    )
    assert 'Traceback' not in ended.stderr, ended.stderr
    return ended


def info(path):
    return limited('-m', MODULES['pendubot'], 'info', path, '--json')


@pytest.mark.parametrize('name', BOMBS)
def test_sizes_are_held_against_a_bound_before_they_are_believed(tmp_path, name):
    file = tmp_path / 'bag.mcap'
    file.write_bytes(b'\x89MCAP0\r\n' + BOMBS[name]() + one_message(b'\x00\x01\x00\x00whole'))
    ended = info(file)
    assert ended.returncode == 0, ended.stderr
    told = json.loads(ended.stdout)
    assert told['messages'] == 1
    (damaged,) = told['damaged']
    assert damaged['offset'] == 8
    assert not told['closed']


def test_a_compressed_file_of_nothing_but_zeros_is_one_sentence(tmp_path):
    (tmp_path / 'bag.mcap.zstd').write_bytes(zeros(1 << 30))
    ended = info(tmp_path / 'bag.mcap.zstd')
    assert ended.returncode == 1
    assert 'is no bag: it would be over 1000 times as long when it is decompressed' in ended.stderr
    assert len(ended.stderr.splitlines()) == 1


def test_of_much_that_was_compressed_well_little_is_held_at_once(tmp_path):
    with (tmp_path / 'bag.mcap').open('wb') as file:
        writer = mcap.Writer(file, compression=mcap.CompressionType.ZSTD)
        writer.start(profile='ros2')
        schema = writer.register_schema(JOINT_STATE, 'ros2msg', b'std_msgs/Header header')
        states, other = (writer.register_channel(name, 'cdr', schema) for name in ('/joint_states', '/other'))
        for k in range(100):
            writer.add_message(states, START + k * STEP, sample(k), START)
            if k % 5 == 0:
                writer.add_message(other, START + k * STEP, bytes(60_000_000), START)
        writer.finish()
    imports = 'import sys; from pendubot_identification.recordings.bag_reader import Path, read_trajectory'
    program = f'{imports}; print(len(read_trajectory(Path(sys.argv[1])).trajectory))'
    assert limited('-c', program, tmp_path / 'bag.mcap').stdout == '100\n'
