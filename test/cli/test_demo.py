# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The demonstration: isolation from other ROS programs, failures, and its end."""

import json
import os
import re
import signal
import subprocess
import sys

import pytest

from pendubot_identification.cli.demo import Programs
from pendubot_identification.errors import PendubotError
from pendubot_identification.recordings.bag_reader import BagReader
from test.processes import Program, until

#: Variables of another domain that is reachable from other machines.
ELSEWHERE = {
    'ROS_DOMAIN_ID': '77',
    'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET',
    'ROS_STATIC_PEERS': '192.0.2.1',
    'ROS_LOCALHOST_ONLY': '0',
    'FASTDDS_DEFAULT_PROFILES_FILE': '/nowhere.xml',
}
#: Takes one of some domains; prints whether the exported one was offered, the domain in use, and the variables.
OWN = """
import json, os, random, sys
from pendubot_identification.cli.demo import own_ros
offered = []
random.sample = lambda domains, _: offered.extend(domains) or [*map(int, sys.argv[1:])]
with own_ros() as (rclpy, domain):
    print(json.dumps([77 in offered, rclpy.get_default_context().get_domain_id(), dict(os.environ)]))
"""


def own(*domains):
    command = [sys.executable, '-c', OWN, *map(str, domains)]
    return subprocess.run(command, env={**os.environ, **ELSEWHERE}, capture_output=True, text=True, timeout=60)


@pytest.mark.ros
@pytest.mark.usefixtures('ros')
def test_the_demo_uses_a_free_domain_that_only_this_computer_reaches():
    taken = int(os.environ['ROS_DOMAIN_ID'])
    refused = own(taken)
    assert refused.returncode == 1
    assert re.search(f'other ROS programs are in each of the domains {taken}, .* nothing was armed', refused.stderr)
    free = taken % 100 + 1
    offered, domain, variables = json.loads(own(taken, free).stdout)
    assert (offered, domain, variables['ROS_DOMAIN_ID']) == (False, free, str(free))
    assert variables['ROS_AUTOMATIC_DISCOVERY_RANGE'] == 'LOCALHOST'
    assert not {*ELSEWHERE} & {*variables} - {'ROS_DOMAIN_ID', 'ROS_AUTOMATIC_DISCOVERY_RANGE'}


def test_a_program_that_ends_early_is_named_with_its_error_message(tmp_path):
    with Programs(tmp_path) as programs:
        board = programs.start('virtual_board', '--link', tmp_path / 'board')
        programs.wait(board, (tmp_path / 'board').exists, 'opened no port')
        programs.start('virtual_board', '--rate', 'fast')
        with pytest.raises(PendubotError, match=r"virtual_board ended early: .*'fast'.*; see .*\.log"):
            programs.wait(board, lambda: False, 'waited', 60.0)
    assert board.poll() == 0


def alive(group):
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.mark.ros
@pytest.mark.parametrize(('number', 'status'), [(signal.SIGINT, 1), (signal.SIGTERM, -signal.SIGTERM)])
def test_a_signal_ends_every_program_of_the_demo_and_keeps_the_bag(tmp_path, number, status):
    folder = tmp_path / 'demo'
    bag = folder / 'paper_experiment'
    with Program('pendubot', 'demo', '--output', folder) as demo:
        demo.wait_for('exciting and recording')
        until(lambda: list(bag.glob('*.mcap')), 20.0, demo)
        demo.process.send_signal(number)
        assert demo.process.wait(20) == status
        if number == signal.SIGTERM:  # its programs end after it
            until(lambda: BagReader(bag).closed and not alive(demo.process.pid))
        assert not alive(demo.process.pid)
    assert 'Error' not in demo.output
    assert ('pendubot: interrupted' in demo.output) is (number == signal.SIGINT)
    assert BagReader(bag).closed
