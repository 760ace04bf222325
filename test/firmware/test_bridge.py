# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The bridge with the STM32F4's program in QEMU, at 1 kHz; other tests use the Linux program."""

import os

import numpy as np
import pytest

from pendubot_identification.link.protocol import State, Status
from test.processes import repeating
from test.rig import PATIENT

from .emulator import Line

#: Duration [s]; for a minute set FIRMWARE_SECONDS=60.
SECONDS = float(os.environ.get('FIRMWARE_SECONDS', '2'))


@pytest.mark.ros
def test_at_1_khz_no_sample_is_lost_and_the_boards_watchdog_trips_when_the_bridge_is_killed(emulator, rig):
    r = rig()
    r.port = emulator.port
    bridge = r.start_bridge(*PATIENT)
    r.until_samples(1500)  # losses count from here, after discovery
    r.until(lambda: r.diagnoses)
    before = r.values()
    assert r.call('arm').success
    r.samples.clear()
    rng = np.random.default_rng(1)
    with repeating(lambda: r.effort(rng.uniform(-0.1, 0.1)), 0.05):
        # By the board's clock: QEMU may run slower.
        r.until(lambda: len(r.samples) >= 1000 * SECONDS, 3 * SECONDS + 10)
        r.diagnoses.clear()
        r.until(lambda: r.diagnoses)
        # On a busy machine the watchdog may have tripped.
        assert r.call('arm').success
        bridge.kill()
    line = Line(emulator.port)
    # QEMU may run behind and still send earlier samples.
    last = line.events(10, lambda e: isinstance(e, State) and e.status & Status.WATCHDOG)[-1]
    states = [e for e in line.events(10, lambda e: e.t_us > last.t_us + 100_000) if isinstance(e, State)]
    line.close()
    assert len(states) > 90
    assert {(s.torque, s.status & ~Status.ZEROED) for s in [last, *states]} == {(0, Status.WATCHDOG)}

    values = r.values()
    assert len({sample[6] for sample in r.samples}) > 10 * SECONDS
    assert all(values[count] == before[count] for count in ('lost', 'damaged', 'duplicates', 'flagged'))
