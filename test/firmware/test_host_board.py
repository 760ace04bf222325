# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Options and limits of the firmware's Linux program; benchmarks/faults has its faults."""

import subprocess
from dataclasses import replace

import pytest

from pendubot_identification.link.protocol import Hello, HelloRequest, encode
from pendubot_identification.link.virtual_board import LIMITS

from .building import made, need
from .emulator import Line


@pytest.mark.parametrize(
    ('options', 'message'),
    [
        (['--rate', '0'], '--rate is 0; a number from 1 to 10000 is expected'),
        (['--fault', 'bit_flip=2'], 'bit_flip is 2; a number from 0 to 1 is expected'),
        (['--fault', 'rust=1'], 'no fault or limit rust=1'),
        (['--nonsense'], 'usage: pendubot_board'),
    ],
)
def test_invalid_options_of_the_linux_program_are_refused_with_a_message(options, message):
    need('cc', 'gcc')
    done = subprocess.run([made('host') / 'pendubot_board', *options], capture_output=True, text=True, timeout=10)
    assert (done.returncode, message in done.stderr) == (2, True), done.stderr


@pytest.fixture
def host_board(tmp_path):
    """Starts the Linux program with options; returns its HELLO."""
    need('cc', 'gcc')
    started = []

    def start(*options):
        program = [made('host') / 'pendubot_board', '--rate', '1000', *options]
        process = subprocess.Popen(program, stdout=subprocess.PIPE, text=True)
        line = Line(process.stdout.readline().split()[-1])
        started.append((process, line))
        line.write(encode(HelloRequest(1, 0)))
        return line.events(10, lambda e: isinstance(e, Hello))[-1]

    yield start
    for process, line in started:
        line.close()
        process.terminate()
        process.communicate(timeout=10)


def test_the_linux_program_has_the_packages_limits_or_the_given_ones(host_board):
    assert host_board().limits == LIMITS
    hello = host_board('--preset', 'balance', '--limit', 'max_vbus=2500', '--limit', 'max_travel2=0')
    assert hello.limits == replace(LIMITS, stall_torque=1_920_000, max_vbus=2500, max_travel2=0)
    assert hello.torque_constant == 100_000
