# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The options of the virtual board; test_bridge.py tests the program itself."""

from dataclasses import replace

import numpy as np
import pytest

from pendubot_identification.errors import ParameterError
from pendubot_identification.model.parameters import PAPER
from pendubot_identification.nodes.virtual_board import make_board, parser
from test.link.test_virtual_board import Bench
from test.nodes.conftest import written
from test.nodes.observer import Observer
from test.processes import Program, run_program


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


@pytest.mark.parametrize(
    ('options', 'status', 'text'),
    [
        (['--help'], 0, 'bit_flip'),
        (['--duration', '0.1', '--ros-args', '-r', '__node:=x'], 0, 'virtual board on /dev/pts/'),
        (['--ros-args', '--params-file', '/none.yaml'], 1, 'virtual_board: ROS refused: failed to initialize rcl'),
        (['--ros-args', '--nope'], 1, "virtual_board: ROS refused: ['--nope']; correct the arguments"),
        (['--rate', '0'], 1, 'virtual_board: --rate is 0 Hz'),
    ],
)
def test_options_are_accepted_or_refused_with_a_message(options, status, text):
    done = run_program('virtual_board', *options)
    assert done.returncode == status
    assert text in done.stdout + done.stderr
    assert 'Traceback' not in done.stderr


@pytest.mark.parametrize(
    ('option', 'value', 'text'),
    [
        ('--duration', 'nan', '--duration is nan s'),
        ('--fault', 'rust=1', "no fault 'rust'"),
        ('--limit', 'heat=1', "no limit 'heat'; the limits are torque_slew, max_speed"),
    ],
)
def test_invalid_options_are_refused(option, value, text):
    with pytest.raises(ParameterError, match=text):
        bench(option, value)


@pytest.mark.ros
def test_the_node_has_the_payload_as_a_parameter(ros):
    with Program('virtual_board', '--ros-args') as board, Observer(ros) as observer:
        assert observer.set('/virtual_board', payload=0.03).successful
        board.wait_for('link 2 carries 0.03 kg')
        assert 'out of range' in observer.set('/virtual_board', payload=-1.0).reason


def test_a_full_disk_is_reported_in_one_sentence_and_the_trace_is_kept(tmp_path):
    link, trace = tmp_path / 'board', tmp_path / 'trace.csv'
    ended = run_program('virtual_board', '--rate', 1000, '--link', link, '--trace', trace, file_limit=8192)
    assert ended.returncode == 1
    assert ended.stderr == f'virtual_board: {trace} cannot be written (File too large); choose another folder\n'
    assert not link.is_symlink()
    assert trace.stat().st_size == 8192, 'the trace must be complete up to the limit'
