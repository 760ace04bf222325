# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The complete identification in real processes: from the board's bytes to a latched parameter vector."""

import os
import re
import shlex
import signal
import time
from pathlib import Path

import numpy as np
import pytest
import yaml

from pendubot_identification.model.parameters import NAMES, PAPER
from pendubot_identification.recordings.bag_reader import read_trajectory
from test.processes import Program, until

pytestmark = pytest.mark.ros


def pause(demo, seconds, program=''):
    """Suspend a program of the demo, or all including the demo, and then let them run for as long."""
    pids = demo.process.pid, *demo.children()
    commands = {each: Path(f'/proc/{each}/cmdline').read_text() for each in pids}
    group = [each for each, command in commands.items() if not program or f'\0{program}\0' in command]
    assert len(group) == (1 if program else 5), f'{program} does not run'
    for number in (signal.SIGSTOP, signal.SIGCONT):
        for each in group:
            os.kill(each, number)
        time.sleep(seconds)


def test_the_demo_ends_with_a_table_of_all_criteria_and_the_true_values(tmp_path):
    """Each program pauses for as long as on a busy computer; the name of the folder has signs of YAML and shells."""
    folder = tmp_path / "it's #1: demo"
    log = folder / 'exciter.log'
    with Program('pendubot', 'demo', '--output', folder) as demo:
        until(lambda: log.exists() and 'exciting' in log.read_text(), 180.0, demo)
        for program in ('virtual_board', 'bridge', 'exciter', 'recorder', ''):
            pause(demo, 0.5, program)
        assert demo.process.wait(240) == 0, demo.output
    domain = re.search(r'virtual rig in ROS domain (\d+),', demo.output)[1]
    assert domain not in ('0', os.environ['ROS_DOMAIN_ID'])
    row = r'^(P[1-5]|b[12]) \[.*\] +([0-9.]+) +[0-9.]+ to [0-9.]+ +([0-9.]+) +([0-9.]+)(?: +\w+)?$'
    rows = re.findall(row, demo.output, re.MULTILINE)
    assert [name for name, *_ in rows] == list(NAMES[:7])
    likelihood, energy, true = np.array([cells for _, *cells in rows], dtype=float).T
    np.testing.assert_allclose(true, PAPER.vector(), rtol=0.005)
    assert abs(likelihood / true - 1).max() < 0.01 < abs(energy / true - 1).max()
    assert re.search(r'^ +estimate +95 % interval +energy by MDE +true value *$', demo.output, re.MULTILINE)
    assert 'a subscriber that joined afterwards received /pendubot/params (P1,P2,P3,P4,P5,b1,b2' in demo.output
    assert 'energy: MDE: 10 of 10 runs reached the exact minimum' in demo.output
    result = yaml.safe_load((folder / 'result.yaml').read_text())
    assert [bag['samples'] for bag in result['bags']] == [900, 900]
    assert shlex.split(demo.lines[-1])[-2:] == ['identify', str(folder / 'paper_experiment')]
    motion = read_trajectory(folder / 'paper_experiment').trajectory
    assert abs(motion.tau).max() > 0.5, 'the rig was excited'
    assert not motion.tau[:, 1].any(), 'a pendubot has no motor at the elbow'
