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


def run(missing, *words, stdout=subprocess.PIPE, **env):
    """Run a program where some modules are missing."""
    command = [sys.executable, '-c', CHILD, missing, *words]
    return subprocess.run(
        command, stdout=stdout, stderr=subprocess.PIPE, text=True, env={**os.environ, **env}, timeout=60
    )


@pytest.mark.parametrize('missing', ['rclpy', 'rclpy diagnostic_msgs std_msgs rcl_interfaces sensor_msgs std_srvs'])
@pytest.mark.parametrize('program', ['bridge', 'exciter'])
def test_a_node_without_ros_says_so_in_a_sentence(program, missing):
    ended = run(missing, program)
    assert ended.returncode == 1
    (sentence,) = ended.stderr.splitlines()
    assert sentence.startswith(f'{program}: ')
    assert 'needs ROS 2' in sentence
    assert "pip install '.[ros]'" in sentence


def test_what_is_wrong_with_the_package_itself_is_not_blamed_on_ros():
    missing = 'pendubot_identification.nodes.runtime'
    said = run(missing, 'bridge').stderr
    assert 'Traceback' in said
    assert missing in said


@pytest.mark.parametrize('unbuffered', ['', '1'])
@pytest.mark.parametrize(
    'words',
    [
        pytest.param(('bridge', '--help'), marks=pytest.mark.ros),
        ('virtual_board', '--help'),
        ('virtual_board', '--duration', '0.1'),
        ('pendubot', '--help'),
        ('pendubot', '--version'),
        ('pendubot', 'info', ROOT / 'bags' / 'paper_experiment'),
    ],
    ids=lambda words: ' '.join(map(str, words[:2])),
)
def test_a_reader_that_has_seen_enough_is_no_failure(words, unbuffered):
    """As head does, in the middle of what is written or before it is flushed at the end."""
    reads, writes = os.pipe()
    os.close(reads)
    # The virtual board needs no ROS.
    ended = run(
        'rclpy' if words[0] == 'virtual_board' else 'no_such_module', *words, stdout=writes, PYTHONUNBUFFERED=unbuffered
    )
    os.close(writes)
    assert (ended.returncode, ended.stderr) == (0, '')
