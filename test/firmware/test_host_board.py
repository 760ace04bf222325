# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Options, limits and motion of the firmware's Linux program; benchmarks/faults has its faults."""

import contextlib
import subprocess

import numpy as np
import pytest

from pendubot_identification.link.protocol import Arm, Command, Hello, HelloRequest, encode
from pendubot_identification.link.virtual_board import LIMITS
from pendubot_identification.model.parameters import BALANCE, PAPER
from pendubot_identification.model.simulation import Plant

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


@contextlib.contextmanager
def board(*options):
    """Run the Linux program at 1 kHz; yield a line to it and its HELLO."""
    need('cc', 'gcc')
    program = [made('host') / 'pendubot_board', '--rate', '1000', *options]
    with subprocess.Popen(program, stdout=subprocess.PIPE, text=True) as process:
        try:
            line = Line(process.stdout.readline().split()[-1])
            line.write(encode(HelloRequest(1, 0)))
            yield line, line.events(10, lambda e: isinstance(e, Hello))[-1]
            line.close()
        finally:
            process.terminate()


@pytest.mark.parametrize(
    ('preset', 'rig', 'given', 'stall_torque'),
    [
        ('paper', PAPER, {}, LIMITS.stall_torque),
        ('balance', BALANCE, {'max_vbus': 2500, 'max_travel2': 0}, 1_920_000),
    ],
)
def test_the_linux_program_has_the_limits_and_the_motion_of_the_virtual_board(
    tmp_path, preset, rig, given, stall_torque
):
    trace = tmp_path / 'trace.csv'
    limits = [word for name, value in given.items() for word in ('--limit', f'{name}={value}')]
    with board('--preset', preset, '--trace', trace, *limits) as (line, hello):
        assert hello.limits == LIMITS._replace(stall_torque=stall_torque, **given)
        assert hello.torque_constant == 100_000
        # The watchdog ends the torque after half a second.
        line.write(encode(Arm(2, 0, hello.boot_id, 7, 1, 500)) + encode(Command(3, 0, 1, 500, 200_000, session=7)))
        # On a busy machine, the board drops samples if this process does not read for a while.
        line.events(10, lambda e: getattr(e, 't_us', 0) > 2_000_000)
    plant, rows = Plant(rig), np.loadtxt(trace, delimiter=',', skiprows=1, dtype=int)[:2000]
    assert set(rows[:, 3]) == {0, 200_000}
    for _, *counts, torque, _ in rows:
        assert counts == pytest.approx(np.array([plant.q[0] + np.pi / 2, plant.q[1]]) * 2000 / np.pi, abs=0.51)
        plant.advance((torque * 1e-6, 0.0), 0.001)
