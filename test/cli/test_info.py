# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

import argparse
import json

import numpy as np
import pytest

from pendubot_identification.cli import info
from pendubot_identification.errors import BagError
from pendubot_identification.recordings.bag_writer import BagWriter
from pendubot_identification.recordings.joint_states import JOINT_STATE, encode_joint_state, write_trajectory
from pendubot_identification.trajectories.trajectory import Trajectory

START = 1_700_000_000_000_000_000


def run(*arguments):
    parser = argparse.ArgumentParser()
    info.add_parser(parser.add_subparsers())
    args = parser.parse_args(['info', *map(str, arguments)])
    return args.run(args)


@pytest.fixture
def bag(tmp_path):
    t = np.arange(101) * 0.01
    q = np.column_stack([t, t])
    write_trajectory(tmp_path / 'bag', Trajectory(t=t, q=q, tau=q))
    return tmp_path / 'bag'


def test_a_bag_is_described_for_people(bag, capsys):
    assert run(bag) == 0
    text = capsys.readouterr().out
    assert 'closed    yes' in text
    assert 'duration  1.000 s' in text
    assert '/joint_states      101 messages    100.00 Hz  sensor_msgs/msg/JointState' in text


def test_a_bag_is_described_for_programs(bag, capsys):
    assert run(bag, '--json') == 0
    described = json.loads(capsys.readouterr().out)
    assert described['closed'] is True
    (topic,) = described['topics']
    expected = {'name': '/joint_states', 'type': 'sensor_msgs/msg/JointState', 'messages': 101, 'rate': 100.0}
    expected |= {'period': 0.01, 'jitter': 0, 'longest': 0.01, 'gaps': 0, 'missing': 0, 'first_gap': None, 'lost': 0}
    expected |= {'stamped': True, 'repeated': 0, 'backwards': 0, 'latency': 0, 'latency_max': 0}
    assert topic == expected


def test_a_bag_that_was_never_closed_says_what_is_whole(bag, capsys):
    file = bag / 'bag_0.mcap'
    file.write_bytes(file.read_bytes()[:-2000])
    assert run(bag) == 0
    text = capsys.readouterr().out
    assert 'closed    no' in text
    assert 'bag_0.mcap was never closed, or is cut or damaged: its ' in text


def test_what_is_irregular_or_missing_is_told(tmp_path, capsys):
    with BagWriter(tmp_path / 'bag') as bag:
        channel = bag.add_topic('/joint_states', JOINT_STATE)
        for k in range(100):
            if k in (40, 41):
                continue
            # Stamped 3 ms before it is received; one stamp repeats, one runs back.
            stamp = START + {70: 69, 80: 60}.get(k, k) * 10_000_000
            data = encode_joint_state(stamp, ('a', 'b'), [0, 0], [], [0, 0])
            bag.write(channel, data, START + k * 10_000_000 + 3_000_000, sequence=k + 1)
    assert run(tmp_path / 'bag') == 0
    text = capsys.readouterr().out
    assert 'gaps 3, 4 messages, first after 0.390 s' in text
    assert 'latency 3.000 ms, at most 203.000 ms' in text
    assert 'stamps 1 repeat, 1 run back' in text
    assert 'lost 2 messages that the recorder had numbered' in text


def test_what_is_damaged_inside_is_told_though_the_bag_was_closed(bag, capsys):
    file = bag / 'bag_0.mcap'
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(data)
    assert run(bag) == 0
    text = capsys.readouterr().out
    assert 'closed    yes' in text
    assert 'bytes from byte' in text
    assert run(bag, '--json') == 0
    (damaged,) = json.loads(capsys.readouterr().out)['damaged']
    assert damaged['offset'] < len(data) // 2 < damaged['offset'] + damaged['size']


def test_no_bag_is_one_sentence(tmp_path):
    with pytest.raises(BagError, match='there is no bag'):
        run(tmp_path / 'nowhere')
