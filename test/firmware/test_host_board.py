# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Options and limits of the firmware's Linux program; benchmarks/faults has its faults."""

import subprocess

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


def hello_of(*options):
    """Return the HELLO of the Linux program with these options."""
    need('cc', 'gcc')
    program = [made('host') / 'pendubot_board', '--rate', '1000', *options]
    with subprocess.Popen(program, stdout=subprocess.PIPE, text=True) as process:
        line = Line(process.stdout.readline().split()[-1])
        line.write(encode(HelloRequest(1, 0)))
        hello = line.events(10, lambda e: isinstance(e, Hello))[-1]
        line.close()
        process.terminate()
    return hello


def test_the_linux_program_has_the_packages_limits_or_the_given_ones():
    assert hello_of().limits == LIMITS
    hello = hello_of('--preset', 'balance', '--limit', 'max_vbus=2500', '--limit', 'max_travel2=0')
    assert hello.limits == LIMITS._replace(stall_torque=1_920_000, max_vbus=2500, max_travel2=0)
    assert hello.torque_constant == 100_000
