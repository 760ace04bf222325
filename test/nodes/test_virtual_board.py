# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The options of the virtual board; test_bridge.py tests the program itself."""

from dataclasses import replace

import numpy as np
import pytest

from pendubot_identification.model.parameters import PAPER
from pendubot_identification.nodes.virtual_board import make_board, parser
from test.identified import written
from test.link.test_virtual_board import Bench
from test.nodes.observer import Observer
from test.processes import Program, run_program, small_disk


def bench(*options):
    return Bench(make_board(parser().parse_args([*map(str, options), '--seed', '3'])))


def pushed(*options):
    """Return the shoulder position [counts] after 0.3 s under 0.05 N m."""
    board = bench(*options).arm()
    board.torque(50_000)
    return board.step(31).enc1


def test_a_result_file_replaces_the_papers_parameters(tmp_path):
    free = pushed()
    assert pushed('--parameters', written(tmp_path / 'paper.yaml', PAPER)) == free
    braked = replace(PAPER, Fc1=0.02, J2=1e-4, Fs1=0.02, k1=0.2)
    assert 0 < pushed('--parameters', written(tmp_path / 'braked.yaml', braked)) < 0.8 * free
    assert pushed('--parameters', written(tmp_path / 'held.yaml', replace(PAPER, Fc1=0.5))) <= 1


def test_the_arm_is_fixed_at_its_start_until_the_first_arming():
    board = bench('--preset', 'balance', '--start', 'upright', '--spread', '0.1', '--rate', '200')
    state = board.step(200)
    begin = state.enc1, state.enc2
    assert np.abs(np.subtract(begin, (2000, 0))).max() < 0.1 * 4000 / 6.28 + 1
    assert begin != (2000, 0)
    board.arm()
    assert abs(board.step(99).enc1 - begin[0]) > 100, 'it must fall after arming'


@pytest.mark.parametrize('mistake', [('--link', '/dev/null'), ('--ros-args', '-p', 'payload:=99')])
def test_a_board_that_does_not_start_leaves_no_trace_that_prevents_the_next_start(tmp_path, mistake):
    trace = tmp_path / 'trace.csv'
    assert run_program('virtual_board', '--trace', trace, *mistake).returncode == 1
    assert not trace.exists()


def test_the_node_has_the_payload_as_a_parameter(ros):
    with Program('virtual_board', '--ros-args', '-r', '__node:=board') as board, Observer(ros) as observer:
        assert observer.set('/board', payload=0.03).successful
        board.wait_for('link 2 carries 0.03 kg')
        assert 'out of range' in observer.set('/board', payload=-1.0).reason


def test_a_full_disk_is_reported_in_one_sentence_and_the_trace_is_kept(tmp_path):
    link, trace = tmp_path / 'board', tmp_path / 'trace.csv'
    with small_disk(8192):
        ended = run_program('virtual_board', '--rate', 1000, '--link', link, '--trace', trace)
    assert ended.returncode == 1
    assert ended.stderr == f'virtual_board: {trace} cannot be written (File too large); choose another folder\n'
    assert not link.is_symlink()
    assert trace.stat().st_size == 8192, 'the trace must be complete up to the limit'
