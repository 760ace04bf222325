# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The bridge on the STM32F4's own program in QEMU, at 1 kHz; its other tests and trials run on that for Linux."""

import os
import threading
from contextlib import closing

import numpy as np
import pytest

from benchmarks.faults.ownership import commands, samples, stranger
from benchmarks.faults.wire import Tap
from pendubot_identification.link.protocol import Arm, Command, Hello, HelloRequest, State, Status, encode
from pendubot_identification.model.parameters import PAPER
from pendubot_identification.model.simulation import Plant
from test.rig import PATIENT

from .emulator import Emulator, Line

#: How long the bridge runs [s]; a minute by hand: FIRMWARE_SECONDS=60.
SECONDS = float(os.environ.get('FIRMWARE_SECONDS', '2'))
COUNT = 2 * np.pi / 4000


@pytest.fixture
def emulator(tmp_path):
    with Emulator(tmp_path) as emulator:
        yield emulator


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
    print(
        f'largest difference from the simulation: {off.max():.3f} counts; in {(off > 0.5).sum()} of {off.size} numbers'
    )
    assert off.max() < 1.01
    assert (off > 0.5).mean() < 1e-3


@pytest.mark.ros
def test_a_foreign_program_moves_nothing_and_is_seen(emulator, rig, tmp_path):
    """It streams torque commands to the port: locked, disarmed by ~/disarm, and armed."""
    r = rig()
    r.port, r.bridge_port = emulator.port, tmp_path / 'tap'
    with closing(Tap(r.port, r.bridge_port)) as tap:
        r.start_bridge(*PATIENT)
        r.until_samples(20)
        for state in ('locked', 'disarmed', 'armed'):
            if state == 'disarmed':
                assert r.call('disarm').success
            if state == 'armed':
                r.until(lambda: r.call('arm').success, 20)
                r.drive_until(0.1, lambda: r.samples[-1][6] == 0.1)
            r.diagnoses.clear()
            begun = len(r.samples)
            with stranger(tap, commands(np.random.default_rng(1))):
                samples(r, 500, 0.1)
                r.until(lambda: r.diagnosed(1, 'another program sends commands'), 20)
            given = {sample[6] for sample in r.samples[begun:]}
            assert given <= ({0.0, 0.1} if state == 'armed' else {0.0}), state


@pytest.mark.ros
def test_the_firmware_stops_a_rig_that_runs_away(emulator, rig):
    """0.6 N m for as long as the board gives it: its limits are 100 rad/s, 60 and 300 rad."""
    r = rig()
    r.port = emulator.port
    r.start_bridge(*PATIENT)
    r.until_samples(20)
    assert r.call('arm').success
    r.samples.clear()
    r.drive_until(0.6, lambda: r.diagnosed(2, 'the board reports a fault: '))
    samples(r, 300, 0.6)
    q, torque = np.array([sample[2:4] for sample in r.samples]), np.array([sample[6] for sample in r.samples])
    assert not torque[-300:].any()
    stamps = np.array([sample[1] for sample in r.samples])
    speed = (np.abs(np.diff(q, axis=0)).max(axis=1) / np.diff(stamps) * 1e9)[torque[1:] != 0]
    # Three samples in a row may be faster.
    assert np.sort(speed)[-4] <= 100 + 2 * COUNT * 1000
    assert (np.abs(q[torque != 0] - [-np.pi / 2, 0]).max(axis=0) <= [60.1, 300.1]).all()


@pytest.mark.ros
def test_a_fault_of_the_processor_disarms_until_told_and_its_samples_go_on(emulator, rig):
    r = rig()
    r.port = emulator.port
    bridge = r.start_bridge(*PATIENT, 'confirm_zeros:=true')
    r.until_samples(1100)
    assert not r.call('arm').success
    assert r.call('confirm_zeros').success
    assert r.call('arm').success
    r.drive_until(0.1, lambda: r.samples[-1][6] == 0.1)
    with emulator.debugger() as ask:
        assert ask('Pf=00000060') == 'OK'
    bridge.wait_for('the board restarted')
    heard = len(r.samples)

    def torques():
        return [sample[6] for sample in r.samples[heard:]]

    r.drive_until(0.1, lambda: torques().count(0.0) > 200)
    assert not any(torques()[torques().index(0.0) :])

    def refused_for_its_angles():
        answer = r.call('arm')
        assert not answer.success
        return 'confirm_zeros' in answer.message  # of a board that is slow to start another reason comes first

    r.until(refused_for_its_angles, 60)
    r.until(lambda: r.call('confirm_zeros').success, 60)
    assert r.call('arm').success
    r.drive_until(0.1, lambda: r.samples[-1][6] == 0.1)


def test_the_boards_own_clock_decides_when_it_trips(emulator):
    line = Line(emulator.port)
    line.events(10, lambda e: isinstance(e, State))  # it has started, and hears
    line.write(encode(HelloRequest(1, 0)))
    hello = line.events(10, lambda e: isinstance(e, Hello))[-1]
    assert (hello.cpr1, hello.sample_period_us) == (4000, 1000)
    line.write(encode(Arm(2, 0, hello.boot_id, 9, 1, 100)) + encode(Command(3, 0, 1, 100, 300_000, session=9)))
    events = line.events(10, lambda e: isinstance(e, State) and e.status & Status.WATCHDOG)
    states = [e for e in events if isinstance(e, State)]
    line.close()
    armed = [s.t_us for s in states if s.torque]
    # The ARM may have come a sample before the COMMAND.
    assert [s.torque for s in states if s.status & Status.ARMED and s.cmd_seq == 3] == [300_000] * len(armed)
    assert armed[-1] - armed[0] == 99_000
    assert states[-1].t_us - armed[-1] == 1000
    assert np.all(np.diff([s.t_us for s in states]) == 1000)
