import argparse
import json

import numpy as np
import pytest

from pendubot_identification.adapters.joint_states import write_trajectory
from pendubot_identification.cli import info
from pendubot_identification.core.errors import BagError
from pendubot_identification.core.trajectory import Trajectory


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
    assert 'bag_0.mcap was never closed, or is cut or damaged: its first' in text


def test_no_bag_is_one_sentence(tmp_path):
    with pytest.raises(BagError, match='there is no bag'):
        run(tmp_path / 'nowhere')
