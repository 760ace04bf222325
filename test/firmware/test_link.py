# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The board's side of the protocol in C, under sanitizers: example frames, Python's board, damage, and each rule."""

import os
import random
import re
import struct
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pendubot_identification.link.protocol import (
    FAULTS,
    Arm,
    Command,
    Damaged,
    Decoder,
    Hello,
    HelloRequest,
    Limits,
    State,
    Status,
    encode,
    frame,
)
from pendubot_identification.link.virtual_board import BoardSettings, Faults, VirtualBoard
from pendubot_identification.model.parameters import PAPER
from pendubot_identification.model.simulation import Plant
from test.conftest import ROOT

from .building import FIRMWARE, compiled, made, need
from .link_probe import LinkProbe, without_version

#: Damaged inputs that are tried; a million by hand: FIRMWARE_INPUTS=1000000.
INPUTS = int(os.environ.get('FIRMWARE_INPUTS', '30000'))
PERIOD = 10_000
#: The session that arms.
SESSION = 0xABCDEF12


@pytest.fixture(scope='module')
def probe(tmp_path_factory):
    program = tmp_path_factory.mktemp('probe') / 'link_probe'
    compiled(program, ROOT / 'test/firmware/link_probe.c', FIRMWARE / 'pendubot_link.c')
    probe = LinkProbe(program)
    yield probe
    probe.close()


class Bench:
    """The board in C, and a hand that sends requests to it at its sampling times; ``lock`` is the board's last."""

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

    def step(self, samples=1, **reading):
        """Return the last STATE."""
        return [e for _ in range(samples) for e in self.events(**reading) if isinstance(e, State)][-1]

    def send(self, mode, torque=0, watchdog_ms=100, faults=0, seq=None, session=SESSION):
        self.seq += 1
        command = Command(self.seq if seq is None else seq, 0, mode, watchdog_ms, torque, session=session)
        self.probe.receive(encode(command), self.now, faults)

    def arm(self, boot_id=None, session=SESSION, lock=None, watchdog_ms=100, faults=0):
        self.seq += 1
        boot_id, lock = self.boot_id if boot_id is None else boot_id, self.lock if lock is None else lock
        self.probe.receive(encode(Arm(self.seq, 0, boot_id, session, lock, watchdog_ms)), self.now, faults)

    def armed(self):
        self.arm()
        assert self.step().status == Status.ARMED
        return self


# The same as on the page, and as in Python


def test_the_frames_of_the_page(probe):
    page = (ROOT / 'docs/protocol.md').read_text()
    rows = dict(re.findall(r'^\| (HELLO_REQUEST|COMMAND|ARM|STATE|HELLO) .* \| `([0-9a-f ]+)` \|$', page, re.MULTILINE))
    request, command, arm, state, hello = (
        bytes.fromhex(rows[name]) for name in ('HELLO_REQUEST', 'COMMAND', 'ARM', 'STATE', 'HELLO')
    )
    assert probe.decode(request) == [HelloRequest(1, 1000)]
    assert probe.decode(command) == [Command(7, 250_000, 1, 100, -500_000, session=2882400018)]
    assert probe.decode(arm) == [Arm(6, 240_000, 3405643777, 2882400018, 3, 100)]
    limits = Limits(300_000, 60_000, 25_000, 100_000, 500_000, 500, 5000, 2000, 3000)
    constants = {'build': 439041101, 'torque_constant': 200_000}
    probe.boot(3405643777, firmware='my board 1', limits=limits, **constants)
    assert probe.sample(0)[1].startswith(b'\0' + hello)
    probe.boot(3405643777)
    for k in range(257):
        probe.sample(734_000 + 1000 * k, -1000, 250)
    probe.receive(encode(Command(5, 0, 0, 0, 0)) + encode(Arm(6, 0, 3405643777, 7, 2, 500)), 999_999)
    probe.receive(encode(Command(7, 0, 1, 500, 500_000, session=7)), 999_999)
    assert probe.sample(1_000_000, -1000, 250, 5000, 2400) == (500_000, state)


def pairs_of_frames(probe, steps, settings=None, faults=None):
    """Drive Python's board and the one in C alike; yield the bytes that each sends at a sample.

    Each step has the delay of its sample [us] and what the board hears before: bytes, or a function that makes bytes
    from the board's boot_id and lock.
    """
    s = settings or BoardSettings()
    board, decoder = VirtualBoard(Plant(PAPER), s, faults), Decoder()
    said = board.sample()

    def boot(hello):
        probe.boot(
            hello.boot_id,
            hello.reset_cause,
            (s.counts,) * 2,
            hello.torque_limit,
            s.sample_period_us,
            s.watchdog_max_ms,
            limits=s.limits,
            torque_constant=hello.torque_constant,
        )

    hello = decoder.feed(said)[0]
    boot(hello)
    yield said, probe.sample(board.last.t_us)[1]
    for late_us, heard in steps:
        board.move(late_us)
        now = (board.last.t_us + s.sample_period_us + late_us) % 2**32
        standing = (
            Status.OVER_CURRENT if faults and 0 <= now - faults.over_current_at * 1e6 < 100_000 else Status(0)
        ) | (Status.EMERGENCY_STOP if faults and now >= faults.emergency_stop_at * 1e6 else Status(0))
        for part in heard:
            data = part(hello.boot_id, board.last.lock) if callable(part) else part
            board.receive(data)
            probe.receive(data, now, standing)
        said, last = board.sample(), board.last
        if said.startswith(b'\0'):  # it has restarted
            hello = decoder.feed(said)[0]
            boot(hello)
        yield said, probe.sample(last.t_us, last.enc1, last.enc2, last.current, last.vbus, standing)[1]


torques = st.one_of(st.integers(-2_500_000, 2_500_000), st.sampled_from([-(2**31), 2**31 - 1, 2_000_001]))
numbers, times = st.integers(0, 65535), st.integers(0, 2**32 - 1)
sessions = st.sampled_from([SESSION, SESSION, SESSION, 5, 0])
watchdogs = st.one_of(st.integers(0, 60), st.integers(0, 65535))
messages = st.one_of(
    st.builds(
        Command,
        numbers,
        times,
        st.one_of(st.just(1), st.integers(0, 1), st.integers(0, 255)),
        watchdogs,
        torques,
        st.sampled_from([0, 0, 255]),
        sessions,
    ),
    st.builds(Arm, numbers, times, times, sessions, numbers, watchdogs),
    st.builds(HelloRequest, numbers, times),
)
armings = st.builds(
    lambda wrong, ahead, arm: lambda boot_id, lock: encode(replace(arm, boot_id=boot_id ^ wrong, lock=lock + ahead)),
    st.sampled_from([0, 0, 0, 1]),
    st.sampled_from([0, 0, 0, 1, 2]),
    st.builds(Arm, numbers, times, st.just(0), sessions, st.just(0), watchdogs),
)
zeros = st.just(lambda boot_id, _: encode(Command(1, 0, 2, 0, 0, session=boot_id)))
heard = st.one_of(
    armings,
    zeros,
    messages.map(encode),
    messages.map(encode),
    st.tuples(messages.map(encode), st.integers(0, 30), st.integers(1, 255)).map(
        lambda t: t[0][: t[1]] + bytes([t[2]]) + t[0][t[1] + 1 :]
    ),
    st.binary(max_size=80),
)
#: Limits that a motion of 0.3 s reaches.
limits = st.builds(
    Limits,
    torque_slew=st.sampled_from([0, 1, 20_000, 1_000_000]),
    max_speed=st.sampled_from([0, 1000, 20_000]),
    max_travel1=st.sampled_from([0, 200, 60_000]),
    max_travel2=st.sampled_from([0, 200, 2**32 - 1]),
    stall_torque=st.sampled_from([0, 1, 200_000]),
    stall_ms=st.sampled_from([0, 20, 65535]),
    continuous_ma=st.sampled_from([0, 1000, 65535]),
    overload_ms=st.sampled_from([0, 30, 65535]),
    max_vbus=st.sampled_from([0, 2400, 2400, 2400, 2399]),
)


@given(
    steps=st.lists(
        st.tuples(st.sampled_from([0, 0, 0, 1, 5000, 5001, 100_000]), st.lists(heard, max_size=4)),
        min_size=1,
        max_size=25,
    ),
    clock=st.sampled_from([0, 2**32 - 55_000]),
    limits=limits,
    faults=st.sampled_from(
        [
            Faults(),
            Faults(emergency_stop_at=0.1),
            Faults(over_current_at=0.05),
            Faults(reset_at=0.07),
            Faults(stuck_at=0.03),
        ]
    ),
)
def test_the_same_bytes_at_the_same_times_give_the_frames_of_pythons_board(probe, steps, clock, limits, faults):
    settings = BoardSettings(clock_start_us=clock if faults == Faults() else 0, limits=limits)
    for python, c in pairs_of_frames(probe, steps, settings, faults):
        assert c == python


def damaged(rng):
    """Bytes that a host did not send: frames that were altered, cut or joined, right frames of wrong bodies, noise."""
    kind = rng.randrange(8)
    body = struct.pack('<BBHI', rng.choice([2, 2, 5, 5, 4, 1, 3, rng.randrange(256)]), 2, rng.randrange(65536), 0)
    body += rng.randbytes(rng.choice([12, 13, 0, rng.randrange(85)]))
    if kind == 0:
        return rng.randbytes(rng.randrange(120)) + b'\0'
    if kind == 1:
        return frame(bytes([body[0], rng.randrange(256)]) + body[2:])
    if kind == 2:
        return frame(body[: rng.randrange(len(body) + 1)])
    data = bytearray(frame(body))
    at = rng.randrange(len(data))
    if kind == 3:
        data[at] ^= 1 << rng.randrange(8)
    elif kind == 4:
        del data[at]
    elif kind == 5:
        data.insert(at, data[at])
    elif kind == 6:
        data[at] = rng.randrange(256)
    return bytes(data)


def test_damaged_inputs_are_accepted_and_refused_as_by_pythons_decoder(probe):
    rng = random.Random(int(os.environ.get('FIRMWARE_SEED', '1')))
    decoder = Decoder(accept=(Command, HelloRequest, Arm))
    seen = {}
    for _ in range(INPUTS // 40):
        data = b''.join(damaged(rng) for _ in range(40))
        python = [without_version(event) for event in decoder.feed(data)]
        assert probe.decode(data) == python
        for event in python:
            name = event.reason if isinstance(event, Damaged) else type(event).__name__
            seen[name] = seen.get(name, 0) + 1
    print(INPUTS, 'inputs:', seen)
    assert set(seen) == {'overlong', 'cobs', 'length', 'crc', 'version', 'type', 'Command', 'HelloRequest', 'Arm'}


@given(data=st.lists(st.binary(max_size=110), max_size=6))
def test_any_bytes_are_read_as_by_pythons_decoder_however_they_are_cut(probe, data):
    probe.decode(b'\0')
    decoder = Decoder(accept=(Command, HelloRequest, Arm))
    for piece in data:
        assert probe.decode(piece) == [without_version(event) for event in decoder.feed(piece)]


# The rules, one by one


def test_it_says_hello_at_boot_and_when_asked(probe):
    limits = Limits(1, 2, 3, 4, 5, 6, 7, 8, 9)
    log = {'fault_cause': 3, 'fault_pc': 0x08001234, 'build': 0x1A2B3C4D, 'torque_constant': 100_000}
    bench = Bench(
        probe, boot_id=7, reset_cause=3, cpr=(1000, 2000), limit=1_500_000, watchdog_max_ms=250, limits=limits, **log
    )
    hello, state = bench.events(vbus=0)
    assert hello == Hello(0, 0, 7, 3, 250, 1000, 2000, 1_500_000, PERIOD, 'virtual', limits=limits, **log)
    assert (state.seq, state.status, state.torque, state.cmd_seq) == (1, 0, 0, 0)
    assert (state.lock, state.refused) == (1, 0)
    assert len(bench.events()) == 1
    bench.probe.receive(2 * encode(HelloRequest(1, 0)))
    assert [type(event) for event in bench.events()] == [Hello, Hello, State]


def test_a_frame_that_a_restart_cut_short_takes_none_along(probe):
    bench = Bench(probe)
    _, frames = probe.sample()
    assert bench.decoder.feed(frames[:-5])
    probe.boot(boot_id=2)
    damaged, hello, state = bench.events()
    assert (type(damaged), hello.boot_id, state.seq) == (Damaged, 2, 1)


def test_confirmed_zeros_are_remembered_until_a_restart_and_change_nothing_else(probe):
    bench = Bench(probe, boot_id=7).armed()
    for boot_id, bit in ((8, 0), (7, Status.ZEROED)):
        probe.receive(encode(Command(99, 0, 2, 0, 900_000, session=boot_id)), bench.now)
        state = bench.step()
        assert (state.status, state.torque, state.refused) == (Status.ARMED | bit, 0, 0)
        assert state.cmd_seq != 99
    assert not Bench(probe, boot_id=8).step().status


def test_another_session_is_refused_and_anybody_disarms(probe):
    bench = Bench(probe).armed()
    bench.send(1, 100_000)
    bench.send(1, 900_000, session=5)
    bench.arm(session=5)
    state = bench.step()
    assert (state.status, state.torque, state.refused) == (Status.ARMED | Status.REFUSED, 100_000, 2)
    before = bench.lock
    bench.send(0, session=5)
    state = bench.step()
    assert (state.status, state.torque, state.lock) == (0, 0, before + 1)
    bench.send(1, 100_000)
    state = bench.step()
    assert (state.status, state.torque, state.refused) == (0, 0, 2)
    bench.arm(lock=before)
    assert bench.step().status == Status.REFUSED


def test_lock_and_refused_wrap(probe):
    bench = Bench(probe)
    bench.probe.receive(65535 * encode(Command(1, 0, 0, 0, 0)))
    bench.probe.receive(65537 * encode(Command(1, 0, 1, 0, 0, session=5)))
    state = bench.step()
    assert (state.lock, state.refused, state.status) == (0, 1, Status.REFUSED)
    bench.armed()


@pytest.mark.parametrize('start', [0, 2**32 - 55_000])
def test_a_late_command_finds_it_disarmed_also_across_the_wrap_of_its_clock(probe, start):
    bench = Bench(probe)
    bench.now = start
    bench.armed()
    bench.send(1, 100_000, watchdog_ms=50)
    states = [bench.step() for _ in range(7)]
    assert [s.torque for s in states] == [100_000] * 5 + [0] * 2
    assert [s.status for s in states] == [Status.ARMED] * 5 + [Status.WATCHDOG] * 2
    bench.send(1, 100_000)
    state = bench.step()
    assert (state.status, state.torque, state.cmd_seq) == (Status.WATCHDOG, 0, 2)
    bench.send(0)
    assert bench.step().status == 0
    bench.armed()


@pytest.mark.parametrize(('wanted', 'given'), [(-(2**31), -250_000), (2**31 - 1, 250_000), (250_001, 250_000)])
def test_torque_beyond_the_limit_is_clamped_and_said(probe, wanted, given):
    bench = Bench(probe, limit=250_000).armed()
    bench.send(1, wanted)
    state = bench.step()
    assert (state.torque, state.status) == (given, Status.ARMED | Status.SATURATED)


def test_torque_changes_by_the_slew_and_a_disarm_makes_it_0_at_once(probe):
    bench = Bench(probe, limits=Limits(torque_slew=10_000)).armed()
    bench.send(1, 250_000)
    states = [bench.step() for _ in range(3)]
    assert [s.torque for s in states] == [100_000, 200_000, 250_000]
    assert [bool(s.status & Status.SLEW) for s in states] == [True, True, False]
    bench.send(1, -(2**31))
    assert [bench.step().torque for _ in range(4)] == [150_000, 50_000, -50_000, -150_000]
    bench.send(0)
    bench.arm(lock=bench.lock + 1)
    state = bench.step()
    assert (state.torque, state.status) == (0, Status.ARMED)


def test_commands_out_of_sequence_are_obeyed_as_they_come(probe):
    bench = Bench(probe).armed()
    for seq, torque in ((9, 1), (3, 2), (3, 3)):
        bench.send(1, torque, seq=seq)
        state = bench.step()
        assert (state.cmd_seq, state.torque) == (seq, torque)


@pytest.mark.parametrize('fault', [bit for bit in FAULTS if bit != Status.EMERGENCY_STOP])
def test_a_fault_switches_off_is_shown_until_mode_0_and_keeps_an_arm_from_arming_while_it_lasts(probe, fault):
    bench = Bench(probe).armed()
    bench.send(1, 100_000, watchdog_ms=500)
    state = bench.step(faults=fault)
    assert (state.status, state.torque) == (fault, 0)
    for _ in range(3):
        bench.send(1, 100_000)
        state = bench.step()
        assert (state.status, state.torque) == (fault, 0)
    bench.arm(faults=fault)
    assert bench.step(faults=fault).status == fault | Status.REFUSED
    bench.send(0)
    assert bench.step().status == 0
    bench.armed()


def test_an_emergency_stop_stands_until_the_board_restarts(probe):
    bench = Bench(probe).armed()
    assert bench.step(faults=Status.EMERGENCY_STOP).torque == 0
    bench.send(0)
    bench.arm(lock=bench.lock + 1)
    state = bench.step()
    assert (state.status, state.torque) == (Status.EMERGENCY_STOP | Status.REFUSED, 0)
    Bench(probe, boot_id=2).armed()


def test_what_is_no_fault_switches_nothing_off(probe):
    bench = Bench(probe).armed()
    assert bench.step(faults=~int(FAULTS) & 0xFFFFFFFF).status == Status.ARMED


def test_a_sample_is_late_from_half_a_period_on(probe):
    bench = Bench(probe, limits=Limits(max_speed=60_000))
    assert [bench.step(late_us=late).status for late in (0, 5000, 0, 5001, 0)] == [0, 0, 0, Status.LATE, 0]


def test_three_fast_samples_in_a_row_are_the_fault_and_a_wrong_count_is_none(probe):
    # 10 rad/s are 63.66 counts in 10 ms.
    bench = Bench(probe, limits=Limits(max_speed=10_000)).armed()
    assert bench.step(enc2=2000).status == Status.ARMED
    assert [bench.step(enc1=k * 63).status for k in range(6)] == [Status.ARMED] * 6
    states = [bench.step(enc1=5 * 63, enc2=-64 * k) for k in range(1, 4)]
    assert [s.status for s in states] == [Status.ARMED, Status.ARMED, Status.SPEED]
    # A late sample has more time.
    bench.step(enc1=315, enc2=-192)
    bench.send(0)
    assert [bench.step(enc1=315 + 95 * k, enc2=-192, late_us=5000).status for k in range(1, 5)] == [0] * 4


def test_at_the_first_sample_nothing_has_moved_wherever_the_counters_stand(probe):
    bench = Bench(probe, limits=Limits(max_speed=10_000))
    assert [bench.step(enc1=1000 * k).status for k in range(5, 9)] == [0, 0, 0, Status.SPEED]


@pytest.mark.parametrize('joint', ['enc1', 'enc2'])
def test_travel_to_either_side_is_a_fault_while_it_lasts(probe, joint):
    # 1 rad is 636.6 counts.
    bench = Bench(probe, limits=Limits(max_travel1=1000, max_travel2=1000)).armed()
    assert [bench.step(**{joint: k}).status for k in (636, -636)] == [Status.ARMED] * 2
    assert bench.step(**{joint: -637}).status == Status.TRAVEL
    bench.send(0)
    assert [bench.step(**{joint: k}).status for k in (637, -(2**31), 636)] == [Status.TRAVEL, Status.TRAVEL, 0]


def test_a_shoulder_that_stands_still_under_torque_is_a_fault(probe):
    bench = Bench(probe, limits=Limits(stall_torque=300_000, stall_ms=50)).armed()
    bench.send(1, 299_999, watchdog_ms=500)
    assert bench.step(20).status == Status.ARMED
    bench.send(1, -300_000, watchdog_ms=500)
    assert bench.step(5, enc1=2).status == Status.ARMED
    assert bench.step(enc1=5).status == Status.ARMED
    assert bench.step(4, enc1=7).status == Status.ARMED
    assert bench.step(enc1=3).status == Status.STALL


def test_twice_the_continuous_current_is_borne_for_its_time(probe):
    bench = Bench(probe, limits=Limits(continuous_ma=5000, overload_ms=50)).armed()
    bench.send(1, 1, watchdog_ms=500)
    assert bench.step(9, current=-5000).status == Status.ARMED
    assert bench.step(4, current=-10_000).status == Status.ARMED
    assert bench.step(current=-10_000).status == Status.OVERLOAD
    bench.send(0)
    assert [bench.step(current=c).status for c in (5000, 4999)] == [Status.OVERLOAD, 0]
    # Three times as long as it was too much, it cools.
    assert bench.step(15).status == 0
    bench.armed()
    bench.send(1, 1, watchdog_ms=500)
    assert bench.step(4, current=10_000).status == Status.ARMED


def test_too_high_a_supply_is_a_fault(probe):
    bench = Bench(probe, limits=Limits(max_vbus=2600)).armed()
    assert (bench.step(vbus=2600).status, bench.step(vbus=2601).status) == (Status.ARMED, Status.OVERVOLTAGE)


def test_the_largest_limits_and_readings_overflow_nothing(probe):
    """The sanitizer ends the probe where one does."""
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


def test_damage_is_said_once_and_costs_no_frame_behind_it(probe):
    bench = Bench(probe)
    bench.probe.receive(b'nonsense\0' + encode(Command(5, 0, 0, 0, 0)))
    state = bench.step()
    assert (state.status, state.cmd_seq) == (Status.DAMAGED_FRAME, 5)
    assert bench.step().status == 0


def test_without_room_a_sample_is_lost_counted_and_said_once(probe):
    bench = Bench(probe)
    bench.events()
    assert bench.events(room=39) == []
    state = bench.step(room=40)
    assert (state.seq, state.status) == (3, Status.OVERRUN)
    assert bench.step().status == 0
    bench.probe.note_overrun()
    assert (bench.step().status, bench.step().status) == (Status.OVERRUN, 0)


def test_a_hello_waits_for_room_beside_the_sample(probe):
    bench = Bench(probe)
    assert [type(event) for event in bench.events(room=133)] == [State]
    assert [type(event) for event in bench.events(room=134)] == [Hello, State]


def test_a_flood_neither_holds_samples_up_nor_keeps_the_motor_on(probe):
    """What a line carries in a period, ten times: noise, requests, then commands that nobody may obey."""
    bench = Bench(probe).armed()
    bench.send(1, 100_000, watchdog_ms=20)
    rng = random.Random(1)
    for k in range(10):
        bench.probe.receive(rng.randbytes(900) + b'\0' + 30 * encode(HelloRequest(k, 0)), bench.now)
        *hellos, state = bench.events(room=94 + 40)
        assert (len(hellos), type(state)) == (1, State)
        assert bool(state.torque) == (k < 2)
        assert state.status & Status.DAMAGED_FRAME
    bench.probe.receive(500 * encode(Command(1, 0, 1, 500, 100_000, session=SESSION)), bench.now)
    assert bench.step().torque == 0
    assert bench.step().status == Status.WATCHDOG


def test_every_status_bit_of_the_header_is_that_of_the_page(probe):
    header = (FIRMWARE / 'pendubot_link.h').read_text()
    bits = {name: 1 << int(bit) for name, bit in re.findall(r'PENDUBOT_(\w+) \(UINT32_C\(1\) << (\d+)\)', header)}
    assert bits == {bit.name: int(bit) for bit in Status}


def test_the_compilers_own_search_for_errors_finds_none():
    need('cc', 'gcc')
    made('analyze')
