# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The board's side of the protocol in C, under sanitizers: the page's frames, Python's board, damage, and each rule."""

import os
import random
import re
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pendubot_identification.link.protocol import (
    Command,
    Damaged,
    Decoder,
    Hello,
    HelloRequest,
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
from .link_probe import LinkProbe, anonymous

#: Damaged inputs that are tried; a million by hand: FIRMWARE_INPUTS=1000000.
INPUTS = int(os.environ.get('FIRMWARE_INPUTS', '30000'))
PERIOD = 10_000


@pytest.fixture(scope='module')
def probe(tmp_path_factory):
    program = tmp_path_factory.mktemp('probe') / 'link_probe'
    compiled(program, ROOT / 'test/firmware/link_probe.c', FIRMWARE / 'pendubot_link.c')
    probe = LinkProbe(program)
    yield probe
    probe.close()


class Bench:
    """The board in C, and a hand that sends commands to it at its sampling times."""

    def __init__(self, probe, **options):
        self.probe, self.now, self.seq = probe, 0, 0
        self.decoder = Decoder()
        probe.boot(**options)

    def events(self, **reading):
        _, data = self.probe.sample(self.now, **reading)
        self.now = (self.now + PERIOD) % 2**32
        return self.decoder.feed(data)

    def step(self, samples=1, **reading):
        """Return the last STATE."""
        return [e for _ in range(samples) for e in self.events(**reading) if isinstance(e, State)][-1]

    def send(self, mode, torque=0, watchdog_ms=100, faults=0, seq=None):
        self.seq += 1
        command = Command(self.seq if seq is None else seq, 0, mode, watchdog_ms, torque)
        self.probe.receive(encode(command), self.now, faults)

    def armed(self):
        self.send(0)
        self.send(1)
        assert self.step().status == Status.ARMED
        return self


# The same as on the page, and as in Python


def test_the_frames_of_the_page(probe):
    page = (ROOT / 'docs/protocol.md').read_text()
    rows = dict(re.findall(r'^\| (HELLO_REQUEST|COMMAND|STATE|HELLO) .* \| `([0-9a-f ]+)` \|$', page, re.MULTILINE))
    request, command, state, hello = (
        bytes.fromhex(rows[name]) for name in ('HELLO_REQUEST', 'COMMAND', 'STATE', 'HELLO')
    )
    assert probe.decode(request) == [HelloRequest(0, 0)]
    assert probe.decode(command) == [Command(7, 250_000, 1, 100, -500_000)]
    probe.boot(3405643777, firmware='my board 1')
    assert probe.sample(0)[1].startswith(b'\0' + hello)
    for _ in range(256):
        probe.sample(0)
    probe.receive(encode(Command(6, 0, 0, 0, 0)) + encode(Command(7, 0, 1, 500, 500_000)), 999_999)
    assert probe.sample(1_000_000, -1000, 250, 5000, 2400) == (500_000, state)


def pairs_of_frames(probe, steps, settings=None, faults=None):
    """Drive Python's board and the one in C alike; yields what each says at a sample, all fields included."""
    s = settings or BoardSettings()
    board = VirtualBoard(Plant(PAPER), s, faults)
    first = board.sample()

    def boot(frames):
        hello, units = Decoder().feed(frames)[0], (s.sample_period_us, s.watchdog_max_ms)
        probe.boot(hello.boot_id, hello.reset_cause, (s.counts,) * 2, hello.torque_limit, *units, 'virtual')

    boot(first)
    yield first, probe.sample(board.last.t_us)[1]
    for heard in steps:
        board.move()
        now = (board.last.t_us + s.sample_period_us) % 2**32
        standing = (
            Status.OVER_CURRENT if faults and 0 <= now - faults.over_current_at * 1e6 < 100_000 else Status(0)
        ) | (Status.EMERGENCY_STOP if faults and now >= faults.emergency_stop_at * 1e6 else Status(0))
        for part in heard:
            board.receive(part)
            probe.receive(part, now, standing)
        said, last = board.sample(), board.last
        if last.t_us == 0:
            boot(said)
        yield said, probe.sample(last.t_us, last.enc1, last.enc2, last.current, last.vbus, standing)[1]


torques = st.one_of(st.integers(-2_500_000, 2_500_000), st.sampled_from([-(2**31), 2**31 - 1, 2_000_001]))
messages = st.one_of(
    st.builds(
        Command,
        st.integers(0, 65535),
        st.integers(0, 2**32 - 1),
        st.one_of(st.integers(0, 1), st.integers(0, 255)),
        st.one_of(st.integers(0, 60), st.integers(0, 65535)),
        torques,
        st.sampled_from([0, 0, 255]),
    ),
    st.builds(HelloRequest, st.integers(0, 65535), st.integers(0, 2**32 - 1)),
)
heard = st.one_of(
    messages.map(encode),
    st.tuples(messages.map(encode), st.integers(0, 30), st.integers(1, 255)).map(
        lambda t: t[0][: t[1]] + bytes([t[2]]) + t[0][t[1] + 1 :]
    ),
    st.binary(max_size=80),
)


@given(
    steps=st.lists(st.lists(heard, max_size=4), min_size=1, max_size=25),
    clock=st.sampled_from([0, 2**32 - 55_000]),
    faults=st.sampled_from(
        [Faults(), Faults(emergency_stop_at=0.1), Faults(over_current_at=0.05), Faults(reset_at=0.07)]
    ),
)
def test_the_same_bytes_at_the_same_times_give_the_frames_of_pythons_board(probe, steps, clock, faults):
    settings = BoardSettings(clock_start_us=clock if faults == Faults() else 0)
    for python, c in pairs_of_frames(probe, steps, settings, faults):
        assert c == python


def damaged(rng):
    """Bytes that a host did not send: frames that were altered, cut or joined, right frames of wrong bodies, noise."""
    kind = rng.randrange(8)
    body = struct.pack('<BBHI', rng.choice([2, 2, 2, 4, 1, 3, rng.randrange(256)]), 1, rng.randrange(65536), 0)
    body += rng.randbytes(rng.choice([8, 0, 8, rng.randrange(45)]))
    if kind == 0:
        return rng.randbytes(rng.randrange(70)) + b'\0'
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
    decoder = Decoder(accept=(Command, HelloRequest))
    seen = {}
    for _ in range(INPUTS // 40):
        data = b''.join(damaged(rng) for _ in range(40))
        python = [anonymous(event) for event in decoder.feed(data)]
        assert probe.decode(data) == python
        for event in python:
            name = event.reason if isinstance(event, Damaged) else type(event).__name__
            seen[name] = seen.get(name, 0) + 1
    print(INPUTS, 'inputs:', seen)
    assert set(seen) == {'overlong', 'cobs', 'length', 'crc', 'version', 'type', 'Command', 'HelloRequest'}


@given(data=st.lists(st.binary(max_size=70), max_size=6))
def test_any_bytes_are_read_as_by_pythons_decoder_however_they_are_cut(probe, data):
    probe.decode(b'\0')
    decoder = Decoder(accept=(Command, HelloRequest))
    for piece in data:
        assert probe.decode(piece) == [anonymous(event) for event in decoder.feed(piece)]


# The rules, one by one


def test_it_says_hello_at_boot_and_when_asked(probe):
    bench = Bench(probe, boot_id=7, reset_cause=3, cpr=(1000, 2000), limit=1_500_000, watchdog_max_ms=250)
    hello, state = bench.events()
    assert hello == Hello(0, 0, 7, 3, 250, 1000, 2000, 1_500_000, PERIOD, 'virtual')
    assert (state.seq, state.status, state.torque, state.cmd_seq) == (1, 0, 0, 0)
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


def test_mode_1_without_mode_0_is_ignored(probe):
    bench = Bench(probe)
    bench.send(1, 500_000)
    state = bench.step()
    assert (state.status, state.torque, state.cmd_seq) == (0, 0, 0)
    bench.send(0)
    bench.send(1, 500_000)
    state = bench.step()
    assert (state.status, state.torque, state.cmd_seq) == (Status.ARMED, 500_000, 3)


@pytest.mark.parametrize('start', [0, 2**32 - 55_000])
def test_a_late_command_finds_it_tripped_also_across_the_wrap_of_its_clock(probe, start):
    bench = Bench(probe)
    bench.now = start
    bench.armed()
    bench.send(1, 100_000, watchdog_ms=50)
    states = [bench.step() for _ in range(7)]
    assert [s.torque for s in states] == [100_000] * 5 + [0] * 2
    assert [s.status for s in states] == [Status.ARMED] * 5 + [Status.WATCHDOG] * 2
    bench.send(1, 100_000)
    state = bench.step()
    assert (state.status, state.torque, state.cmd_seq) == (Status.WATCHDOG, 0, 3)
    bench.send(0)
    assert bench.step().status == 0
    bench.armed()


def test_a_watchdog_of_0_trips_at_once_and_a_long_one_is_clamped(probe):
    bench = Bench(probe)
    bench.send(0)
    bench.send(1, 100_000, watchdog_ms=0)
    state = bench.step()
    assert (state.status, state.torque) == (Status.WATCHDOG, 0)
    bench.armed()
    bench.send(1, 100_000, watchdog_ms=65535)
    assert bench.step(50).status == Status.ARMED
    assert bench.step().status == Status.WATCHDOG


@pytest.mark.parametrize(('wanted', 'given'), [(-(2**31), -250_000), (2**31 - 1, 250_000), (250_001, 250_000)])
def test_torque_beyond_the_limit_is_clamped_and_said(probe, wanted, given):
    bench = Bench(probe, limit=250_000).armed()
    bench.send(1, wanted)
    state = bench.step()
    assert (state.torque, state.status) == (given, Status.ARMED | Status.SATURATED)


def test_commands_out_of_sequence_are_obeyed_as_they_come(probe):
    bench = Bench(probe).armed()
    for seq, torque in ((9, 1), (3, 2), (3, 3)):
        bench.send(1, torque, seq=seq)
        state = bench.step()
        assert (state.cmd_seq, state.torque) == (seq, torque)


@pytest.mark.parametrize(
    'fault',
    [Status.ENCODER_1, Status.ENCODER_2, Status.OVER_CURRENT, Status.OVER_TEMPERATURE, Status.UNDERVOLTAGE],
)
def test_a_fault_switches_off_and_mode_1_is_ignored_while_it_stands(probe, fault):
    bench = Bench(probe).armed()
    bench.send(1, 100_000, watchdog_ms=500)
    state = bench.step(faults=fault)
    assert (state.status, state.torque) == (fault, 0)
    bench.send(0, faults=fault)
    bench.send(1, 100_000, faults=fault)
    assert (bench.step(faults=fault).status, bench.step().status) == (fault, 0)
    bench.armed()


def test_a_fault_of_one_sample_keeps_the_motor_off_until_mode_0(probe):
    """An encoder that jumps now and then, and a host that goes on commanding as if nothing had happened."""
    bench = Bench(probe).armed()
    assert bench.step(faults=Status.ENCODER_1).status == Status.ENCODER_1
    for _ in range(3):
        bench.send(1, 100_000)
        state = bench.step()
        assert (state.status, state.torque) == (0, 0)
    bench.armed()


def test_an_emergency_stop_stands_until_the_board_restarts(probe):
    bench = Bench(probe).armed()
    assert bench.step(faults=Status.EMERGENCY_STOP).torque == 0
    bench.send(0)
    bench.send(1, 100_000)
    state = bench.step()
    assert (state.status, state.torque) == (Status.EMERGENCY_STOP, 0)
    Bench(probe, boot_id=2).armed()


def test_what_is_no_fault_switches_nothing_off(probe):
    bench = Bench(probe).armed()
    assert bench.step(faults=~int(Status.EMERGENCY_STOP | 0x1F0) & 0xFFFFFFFF).status == Status.ARMED


def test_damage_is_said_once_and_costs_no_frame_behind_it(probe):
    bench = Bench(probe)
    bench.probe.receive(b'nonsense\0' + encode(Command(5, 0, 0, 0, 0)))
    state = bench.step()
    assert (state.status, state.cmd_seq) == (Status.DAMAGED_FRAME, 5)
    assert bench.step().status == 0


def test_without_room_a_sample_is_lost_counted_and_said_once(probe):
    bench = Bench(probe)
    bench.events()
    assert bench.events(room=33) == []
    state = bench.step(room=34)
    assert (state.seq, state.status) == (3, Status.OVERRUN)
    assert bench.step().status == 0
    bench.probe.note_overrun()
    assert (bench.step().status, bench.step().status) == (Status.OVERRUN, 0)


def test_a_hello_waits_for_room_beside_the_sample(probe):
    bench = Bench(probe)
    assert [type(event) for event in bench.events(room=87)] == [State]
    assert [type(event) for event in bench.events(room=88)] == [Hello, State]


def test_a_flood_neither_holds_samples_up_nor_keeps_the_motor_on(probe):
    """What a line carries in a period, ten times: noise, requests, then commands that nobody may obey."""
    bench = Bench(probe).armed()
    bench.send(1, 100_000, watchdog_ms=20)
    rng = random.Random(1)
    for k in range(10):
        bench.probe.receive(rng.randbytes(900) + b'\0' + 30 * encode(HelloRequest(k, 0)), bench.now)
        *hellos, state = bench.events(room=54 + 34)
        assert (len(hellos), type(state)) == (1, State)
        assert bool(state.torque) == (k < 2)
        assert state.status & Status.DAMAGED_FRAME
    bench.probe.receive(500 * encode(Command(1, 0, 1, 500, 100_000)), bench.now)
    assert bench.step().torque == 0
    assert bench.step().status == Status.WATCHDOG


def test_every_status_bit_of_the_header_is_that_of_the_page(probe):
    header = (FIRMWARE / 'pendubot_link.h').read_text()
    bits = {name: 1 << int(bit) for name, bit in re.findall(r'PENDUBOT_(\w+) = 1 << (\d+)', header)}
    assert bits == {bit.name: int(bit) for bit in Status}


def test_the_compilers_own_search_for_errors_finds_none():
    need('cc', 'gcc')
    made('analyze')
