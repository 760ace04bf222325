# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The bridge on the STM32F4's own program in QEMU, at 1 kHz; its other tests and trials run on that for Linux."""

import os
import threading

import numpy as np
import pytest

from pendubot_identification.link.protocol import State, Status
from pendubot_identification.model.parameters import PAPER
from pendubot_identification.model.simulation import Plant
from test.rig import PATIENT

from .emulator import Line

#: How long the bridge runs [s]; a minute by hand: FIRMWARE_SECONDS=60.
SECONDS = float(os.environ.get('FIRMWARE_SECONDS', '2'))
COUNT = 2 * np.pi / 4000


@pytest.mark.ros
def test_1_khz_reaches_the_bridge_whole_and_the_boards_watchdog_outlasts_the_bridge(emulator, rig):
    r = rig()
    r.port = emulator.port
    bridge = r.start_bridge(*PATIENT)
    r.until_samples(1500)  # discovery is no matter of losses; what is judged begins here
    r.until(lambda: r.diagnoses)
    before = r.values()
    assert r.call('arm').success
    r.samples.clear()
    ended = threading.Event()
    rng = np.random.default_rng(1)

    def drive():
        while not ended.wait(0.05):
            # Gently: from one that turns over, a difference in the last digit grows to turns within a minute.
            r.effort(rng.uniform(-0.1, 0.1))

    thread = threading.Thread(target=drive)
    thread.start()
    try:
        # The board's seconds: QEMU's may be longer.
        r.until(lambda: len(r.samples) >= 1000 * SECONDS, 3 * SECONDS + 10)
        r.diagnoses.clear()
        r.until(lambda: r.diagnoses)
        # Again, where a machine that is busy let the watchdog trip before.
        assert r.call('arm').success
    finally:
        bridge.kill()
        ended.set()
        thread.join()
    line = Line(emulator.port)
    # QEMU's time may run behind, with samples from before.
    last = line.events(10, lambda e: isinstance(e, State) and e.status & Status.WATCHDOG)[-1]
    states = [e for e in line.events(10, lambda e: e.t_us > last.t_us + 100_000) if isinstance(e, State)]
    line.close()
    assert len(states) > 90
    assert {(s.torque, s.status & ~Status.ZEROED) for s in [last, *states]} == {(0, Status.WATCHDOG)}

    values = r.values()
    samples = np.array([sample[2:7] for sample in r.samples])
    q, torque = samples[:, :2], samples[:, 4]
    print(f'{len(q)} samples, lost {values["lost"]}, damaged {values["damaged"]}')
    assert len(np.unique(torque)) > 10 * SECONDS
    assert all(values[count] == before[count] for count in ('lost', 'damaged', 'duplicates', 'flagged'))
    # The same torques move the package's own plant: a sample that was lost, doubled or altered would show.
    plant = Plant(PAPER)
    moved = [plant.q]
    for each in torque[:-1]:
        plant.advance((each, 0.0), 0.001)
        moved.append(plant.q)
    off = np.abs(q - np.round((moved - np.array([-np.pi / 2, 0])) / COUNT) * COUNT - [-np.pi / 2, 0]) / COUNT
    print(f'largest difference from the simulation: {off.max():.3f} counts; in {(off > 0.5).mean():.1e} of the numbers')
    assert off.max() < 1.01
    assert (off > 0.5).mean() < 1e-3
