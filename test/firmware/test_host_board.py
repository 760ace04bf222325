# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The board that is a Linux program: its options, limits and faults."""

import subprocess
from dataclasses import replace

import pytest

from pendubot_identification.link.protocol import FAULTS, Arm, Command, Hello, HelloRequest, State, Status, encode
from pendubot_identification.link.virtual_board import LIMITS

from .building import made, need
from .emulator import Line


@pytest.mark.parametrize(
    ('options', 'said'),
    [
        (['--rate', '0'], '--rate is 0; a number from 1 to 10000 is expected'),
        (['--counts', 'many'], '--counts is many; a number from 4'),
        (['--fault', 'bit_flip=2'], 'bit_flip is 2; a number from 0 to 1 is expected'),
        (['--fault', 'rust=1'], 'no fault rust=1'),
        (['--limit', 'max_speed=-1'], 'max_speed is -1; a number from 0 to 4.29497e+09 is expected'),
        (['--nonsense'], 'usage: pendubot_board'),
    ],
)
def test_the_program_for_linux_explains_what_it_does_not_take(options, said):
    need('cc', 'gcc')
    done = subprocess.run([made('host') / 'pendubot_board', *options], capture_output=True, text=True, timeout=10)
    assert (done.returncode, said in done.stderr) == (2, True), done.stderr


@pytest.fixture
def host_board(tmp_path):
    """Return what starts the program for Linux with options, and gives the host's end of its line."""
    need('cc', 'gcc')
    started = []

    def start(*options):
        program = [made('host') / 'pendubot_board', '--rate', '1000', *options]
        process = subprocess.Popen(program, stdout=subprocess.PIPE, text=True)
        line = Line(process.stdout.readline().split()[-1])
        started.append((process, line))
        line.write(encode(HelloRequest(1, 0)))
        return line, line.events(10, lambda e: isinstance(e, Hello))[-1]

    yield start
    for process, line in started:
        line.close()
        process.terminate()
        process.communicate(timeout=10)


def test_the_program_for_linux_has_the_limits_of_the_package_or_those_that_are_given(host_board):
    assert host_board()[1].limits == LIMITS
    _, hello = host_board('--preset', 'balance', '--limit', 'max_vbus=2500', '--limit', 'max_travel2=0')
    assert hello.limits == replace(LIMITS, stall_torque=1_920_000, max_vbus=2500, max_travel2=0)
    assert hello.torque_constant == 100_000


def test_an_encoder_that_is_stuck_is_a_stall_on_the_program_for_linux(host_board):
    line, hello = host_board('--fault', 'stuck_at=0', '--limit', 'stall_ms=50', '--limit', 'stall_torque=300000')
    line.write(encode(Arm(2, 0, hello.boot_id, 9, 1, 500)) + encode(Command(3, 0, 1, 500, 300_000, session=9)))
    events = line.events(10, lambda e: isinstance(e, State) and e.status & FAULTS)
    states = [e for e in events if isinstance(e, State)]
    moved = [s.t_us for s in states if s.torque]
    assert moved[-1] - moved[0] == 49_000
    assert (states[-1].status, states[-1].torque, states[-1].enc1) == (Status.STALL, 0, 0)
