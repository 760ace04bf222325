# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The programs as they are started, on a computer without ROS and with a reader that leaves."""

import os
import subprocess
import sys

import pytest

from test.conftest import ROOT

CHILD = """
import sys
# Named so, a module is not found.
sys.modules.update(dict.fromkeys(sys.argv.pop(1).split()))
from pendubot_identification import programs
sys.exit(getattr(programs, sys.argv.pop(1))())
"""


@pytest.mark.parametrize('program', ['bridge', 'recorder', 'player', 'identifier', 'exciter', 'balancer'])
@pytest.mark.parametrize('missing', ['rclpy', 'rclpy diagnostic_msgs std_msgs rcl_interfaces sensor_msgs std_srvs'])
def test_a_node_without_ros_says_so_in_a_sentence(program, missing):
    ended = subprocess.run([sys.executable, '-c', CHILD, missing, program], capture_output=True, text=True, timeout=60)
    assert ended.returncode == 1
    (sentence,) = ended.stderr.splitlines()
    assert sentence.startswith(f'{program}: ')
    assert 'needs ROS 2' in sentence
    assert "pip install '.[ros]'" in sentence


def test_what_is_wrong_with_the_package_itself_is_not_blamed_on_ros():
    missing = 'pendubot_identification.nodes.runtime'
    ended = subprocess.run([sys.executable, '-c', CHILD, missing, 'bridge'], capture_output=True, text=True, timeout=60)
    assert 'Traceback' in ended.stderr
    assert missing in ended.stderr


def test_the_virtual_board_needs_no_ros():
    arguments = [sys.executable, '-c', CHILD, 'rclpy', 'virtual_board', '--help']
    ended = subprocess.run(arguments, capture_output=True, text=True, timeout=60)
    assert ended.returncode == 0
    assert 'virtual_board' in ended.stdout


SAMPLE = ROOT / 'bags' / 'paper_experiment'
NODES = ('bridge', 'recorder', 'player', 'identifier', 'exciter', 'balancer')


@pytest.mark.parametrize('unbuffered', ['', '1'])
@pytest.mark.parametrize(
    'words',
    [
        *(pytest.param((node, '--help'), marks=pytest.mark.ros) for node in NODES),
        *(('virtual_board', *more) for more in (['--help'], ['--duration', '0.1'])),
        *(('pendubot', *more) for more in (['--help'], ['--version'], ['identify', '--help'], ['info', SAMPLE])),
    ],
    ids=lambda words: ' '.join(map(str, words[:2])),
)
def test_a_reader_that_has_seen_enough_is_no_failure(words, unbuffered):
    """As head does, in the middle of what is written or before it is flushed at the end."""
    reads, writes = os.pipe()
    os.close(reads)
    try:
        ended = subprocess.run(
            [sys.executable, '-c', CHILD, 'no_such_module', *words],
            stdout=writes,
            stderr=subprocess.PIPE,
            env={**os.environ, 'PYTHONUNBUFFERED': unbuffered},
            timeout=60,
        )
    finally:
        os.close(writes)
    assert ended.stderr.decode() == ''
    assert ended.returncode == 0
