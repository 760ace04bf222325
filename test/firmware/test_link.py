# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The board's side of the protocol in C, under sanitizers: example frames and each rule.

test_ownership.py tests the ownership of the motor and damaged frames, and compares the board with Python's.
"""

import random

import pytest

from pendubot_identification.link.protocol import (
    FAULTS,
    Arm,
    Command,
    Decoder,
    Hello,
    HelloRequest,
    Limits,
    State,
    Status,
    encode,
)
from test.link.test_protocol import LIMITS, frames_of_the_page

from .building import made, need

PERIOD = 10_000
#: The session that arms.
SESSION = 0xABCDEF12
ARMED = Status.ARMED


class Bench:
    """The board in C with a sender of requests at its sampling times; ``lock`` is the board's last."""

    def __init__(self, probe, boot_id=1, **options):
        self.probe, self.boot_id, self.now, self.seq, self.lock = probe, boot_id, 0, 0, 1
        self.decoder = Decoder()
        probe.boot(boot_id, **options)

    def events(self, late_us=0, **reading):
        self.now = (self.now + late_us) % 2**32
        _, data = self.probe.sample(self.now, **reading)
        self.now = (self.now + PERIOD) % 2**32
        events = self.decoder.feed(data)
        self.lock = next((e.lock for e in events if isinstance(e, State)), self.lock)
        return events

    def step(self, **reading):
        return self.events(**reading)[-1]

    def send(self, mode, torque=0, watchdog_ms=500, session=SESSION):
        self.seq += 1
        self.probe.receive(encode(Command(self.seq, 0, mode, watchdog_ms, torque, session=session)), self.now)

    def arm(self, lock=None, faults=0):
        self.seq += 1
        lock = self.lock if lock is None else lock
        self.probe.receive(encode(Arm(self.seq, 0, self.boot_id, SESSION, lock, 500)), self.now, faults)

    def armed(self):
        self.arm()
        assert self.step().status == ARMED
        return self


def test_the_example_frames_of_the_protocol_page_are_correct(probe):
    frames = frames_of_the_page()
    probe.boot(3405643777, firmware='my board 1', limits=LIMITS, build=439041101, torque_constant=200_000)
    assert probe.sample(0)[1].startswith(b'\0' + frames['HELLO'])
    probe.boot(3405643777)
    for k in range(257):
        probe.sample(734_000 + 1000 * k, -1000, 250)
    probe.receive(encode(Command(5, 0, 0)) + encode(Arm(6, 0, 3405643777, 7, 2, 500)), 999_999)
    probe.receive(encode(Command(7, 0, 1, 500, 500_000, session=7)), 999_999)
    assert probe.sample(1_000_000, -1000, 250, 5000, 2400) == (500_000, frames['STATE'])


def test_the_board_sends_hello_at_boot_and_on_request(probe):
    limits = Limits(1, 2, 3, 4, 5, 6, 7, 8, 9)
    log = {'fault_pc': 0x08001234, 'build': 0x1A2B3C4D, 'torque_constant': 100_000}
    options = {'cpr': (1000, 2000), 'limit': 1_500_000, 'watchdog_max_ms': 250, 'limits': limits}
    bench = Bench(probe, boot_id=7, reset_cause=3, fault_cause=9, **options, **log)
    hello, state = bench.events(vbus=0)
    assert hello == Hello(0, 0, 7, 3, 9, 250, 1000, 2000, 1_500_000, PERIOD, *log.values(), limits, 'virtual')
    assert (state.seq, state.status, state.torque, state.cmd_seq, state.lock, state.refused) == (1, 0, 0, 0, 1, 0)
    assert len(bench.events()) == 1
    probe.receive(2 * encode(HelloRequest(1, 0)))
    assert [type(event) for event in bench.events()] == [Hello, Hello, State]


def test_confirmed_zeros_are_kept_until_a_restart_and_change_nothing_else(probe):
    bench = Bench(probe, boot_id=7).armed()
    for boot_id, bit in ((8, 0), (7, Status.ZEROED)):
        probe.receive(encode(Command(99, 0, 2, 0, 900_000, session=boot_id)), bench.now)
        state = bench.step()
        assert (state.status, state.torque, state.refused) == (ARMED | bit, 0, 0)
        assert state.cmd_seq != 99
    assert not Bench(probe, boot_id=8).step().status


def test_lock_and_refused_wrap(probe):
    bench = Bench(probe)
    probe.receive(65535 * encode(Command(1, 0, 0)))
    probe.receive(65537 * encode(Command(1, 0, 1, session=5)))
    state = bench.step()
    assert (state.lock, state.refused, state.status) == (0, 1, Status.REFUSED)
    bench.armed()


def each(name, values):
    return [{name: value} for value in values]


@pytest.mark.parametrize(
    ('limits', 'torque', 'readings', 'fault'),
    [
        ({}, 0, [{'faults': ~int(FAULTS) & 0xFFFFFFFF}], 0),
        # 10 rad/s are 63.66 counts in 10 ms; a wrong count exceeds it twice, a late sample covers a longer time.
        ({'max_speed': 10_000}, 0, [{'enc2': 2000}, *each('enc1', range(0, 400, 63))], 0),
        ({'max_speed': 10_000}, 0, [{'enc1': 95 * k, 'late_us': 5000} for k in range(5)], 0),
        ({'max_speed': 10_000}, 0, each('enc2', range(0, -200, -64)), Status.SPEED),
        # 1 rad is 636.6 counts.
        ({'max_travel1': 1000}, 0, each('enc1', (636, -636, -637)), Status.TRAVEL),
        ({'max_travel2': 1000}, 0, each('enc2', (636, -636, -(2**31))), Status.TRAVEL),
        ({'stall_torque': 300_000, 'stall_ms': 50}, 299_999, 20 * [{}], 0),
        (
            {'stall_torque': 300_000, 'stall_ms': 50},
            -300_000,
            each('enc1', 5 * [2] + [5] + 4 * [7] + [3]),
            Status.STALL,
        ),
        # Cooling takes three times as long as the overload.
        (
            {'continuous_ma': 5000, 'overload_ms': 50},
            1,
            each('current', 9 * [-5000] + 4 * [-10_000] + 12 * [0] + 5 * [10_000]),
            Status.OVERLOAD,
        ),
        ({'max_vbus': 2600}, 0, each('vbus', (2600, 2601)), Status.OVERVOLTAGE),
    ],
)
def test_a_limit_is_exceeded_at_the_last_of_these_readings_and_not_earlier(probe, limits, torque, readings, fault):
    bench = Bench(probe, limits=Limits(**limits)).armed()
    bench.send(1, torque)
    assert [bench.step(**reading).status for reading in readings] == [ARMED] * (len(readings) - 1) + [fault or ARMED]


def test_the_first_sample_has_no_speed_for_any_counter_values(probe):
    bench = Bench(probe, limits=Limits(max_speed=10_000))
    assert [bench.step(enc1=1000 * k).status for k in range(5, 9)] == [0, 0, 0, Status.SPEED]


def test_a_sample_is_late_from_half_a_period_on(probe):
    bench = Bench(probe, limits=Limits(max_speed=60_000))
    assert [bench.step(late_us=late).status for late in (0, 5000, 0, 5001, 0)] == [0, 0, 0, Status.LATE, 0]


def test_the_largest_limits_and_readings_cause_no_overflow(probe):
    """The sanitizer ends the probe at an overflow."""
    most = 2**32 - 1
    limits = Limits(most, most, most, most, most, 65535, 65535, 65535, 65535)
    bench = Bench(probe, cpr=(most, most), limit=2**31 - 1, limits=limits).armed()
    for late in (0, 2**31, 0, 2**32 - 1 - PERIOD):
        bench.arm()
        for torque in (2**31 - 1, -(2**31)):
            bench.send(1, torque)
            for enc in (2**31 - 1, -(2**31)):
                state = bench.step(enc1=enc, enc2=-enc - 1, current=-32768, vbus=65535, late_us=late)
                assert (state.refused, state.status & FAULTS) == (0, 0)


def test_on_overrun_a_sample_is_lost_and_reported_once_and_hello_is_delayed(probe):
    bench = Bench(probe)
    assert [type(event) for event in bench.events(room=133)] == [State]
    assert [type(event) for event in bench.events(room=134)] == [Hello, State]
    assert bench.events(room=39) == []
    state = bench.step(room=40)
    assert (state.seq, state.status) == (4, Status.OVERRUN)
    assert bench.step().status == 0
    probe.note_overrun()
    assert (bench.step().status, bench.step().status) == (Status.OVERRUN, 0)


def test_a_flood_of_bytes_neither_delays_samples_nor_keeps_the_motor_on(probe):
    """Ten times the capacity of a line in a period: noise, requests, then commands without an arming."""
    bench = Bench(probe).armed()
    bench.send(1, 100_000, watchdog_ms=20)
    rng = random.Random(1)
    for k in range(10):
        probe.receive(rng.randbytes(900) + b'\0' + 30 * encode(HelloRequest(k, 0)), bench.now)
        *hellos, state = bench.events(room=94 + 40)
        assert (len(hellos), type(state)) == (1, State)
        assert bool(state.torque) == (k < 2)
        assert state.status & Status.DAMAGED_FRAME
    probe.receive(500 * encode(Command(1, 0, 1, 500, 100_000, session=SESSION)), bench.now)
    state = bench.step()
    assert (state.status, state.torque) == (Status.WATCHDOG, 0)


def test_the_compilers_static_analysis_finds_no_errors():
    need('cc', 'gcc')
    made('analyze')
