# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The board's rules, heard and said in frames; its faults come from the seed."""

import math

import pytest

from pendubot_identification.errors import ParameterError
from pendubot_identification.link.protocol import Command, Decoder, Hello, HelloRequest, State, Status, encode
from pendubot_identification.link.virtual_board import BoardSettings, Faults, VirtualBoard
from pendubot_identification.model.parameters import PAPER
from pendubot_identification.model.simulation import Plant


class Bench:
    """A virtual board and a hand that sends commands to it."""

    def __init__(self, settings=None, faults=None, seed=0, plant=None):
        self.board = VirtualBoard(plant or Plant(PAPER), settings, faults, seed)
        self.decoder = Decoder()
        self.seq = 0

    def step(self, samples=1):
        """Return the last STATE."""
        return [e for e in self.events(samples) if isinstance(e, State)][-1]

    def events(self, samples=1):
        return [event for _ in range(samples) for event in self.decoder.feed(self.board.advance())]

    def send(self, mode, torque=0, watchdog_ms=100):
        self.seq += 1
        self.board.receive(encode(Command(self.seq, 0, mode, watchdog_ms, torque)))

    def armed(self):
        self.send(0)
        self.send(1)
        assert self.step().status == Status.ARMED
        return self


def test_it_says_hello_at_boot_and_when_asked():
    bench = Bench(BoardSettings(counts=1000, torque_limit=1.5, sample_period_us=2000, watchdog_max_ms=250))
    hello, state = bench.events()
    assert isinstance(hello, Hello)
    assert (hello.seq, hello.cpr1, hello.cpr2, hello.torque_limit) == (0, 1000, 1000, 1_500_000)
    assert (hello.sample_period_us, hello.watchdog_max_ms) == (2000, 250)
    assert (state.seq, state.t_us, state.enc1, state.enc2, state.torque, state.status) == (1, 0, 0, 0, 0, 0)
    for _ in range(2):
        bench.board.receive(encode(HelloRequest(1, 0)))
    first, second, state = bench.events()
    assert (first.seq, first.boot_id, second.seq, state.seq) == (2, hello.boot_id, 3, 4)


def test_it_obeys_only_mode_0_then_mode_1_at_the_start_and_after_a_watchdog_trip():
    bench = Bench(BoardSettings(torque_limit=0.25))
    bench.send(1, 100_000)
    state = bench.step()
    assert (state.status, state.torque, state.cmd_seq) == (0, 0, 0)
    bench.send(0)
    assert bench.step().cmd_seq == 2
    bench.send(1, -300_000, watchdog_ms=50)
    states = [bench.step() for _ in range(7)]
    assert [s.torque for s in states] == [-250_000] * 5 + [0] * 2
    assert [s.status for s in states] == [Status.ARMED | Status.SATURATED] * 5 + [Status.WATCHDOG] * 2
    bench.send(1, 100_000)
    assert bench.step().status == Status.WATCHDOG
    bench.send(0)
    assert bench.step().status == 0
    bench.armed()


def test_the_torque_is_held_from_its_sample_until_the_next_and_moves_the_plant():
    bench = Bench().armed()
    bench.send(1, 300_000)
    first = bench.step()
    assert (first.torque, first.enc1) == (300_000, 0)
    reference = Plant(PAPER)
    reference.advance((0.3, 0.0), 0.01)
    assert bench.step().enc1 == round((reference.q[0] + math.pi / 2) * 4000 / (2 * math.pi)) != 0


def test_a_watchdog_of_0_trips_at_once_and_a_long_one_is_clamped():
    bench = Bench()
    bench.send(0)
    bench.send(1, 100_000, watchdog_ms=0)
    state = bench.step()
    assert (state.status, state.torque) == (Status.WATCHDOG, 0)
    bench.armed()
    bench.send(1, 100_000, watchdog_ms=60_000)
    assert bench.step(50).status == Status.ARMED
    assert bench.step().status == Status.WATCHDOG


def test_a_fault_switches_off_and_mode_1_is_ignored_while_it_stands():
    bench = Bench(faults=Faults(over_current_at=0.05)).armed()
    bench.send(1, 100_000, watchdog_ms=500)
    assert bench.step(4).torque == 100_000
    state = bench.step()
    assert (state.status, state.torque) == (Status.OVER_CURRENT, 0)
    bench.send(0)
    bench.send(1)
    assert bench.step().status == Status.OVER_CURRENT
    assert bench.step(10).status == 0
    bench.send(1)
    assert bench.step().status == Status.ARMED


def test_a_fault_keeps_the_motor_off_until_mode_0_though_a_host_goes_on_commanding():
    bench = Bench(faults=Faults(over_current_at=0.05)).armed()
    for _ in range(20):
        bench.send(1, 100_000)
        bench.step()
    assert bench.step().status == 0
    bench.armed()


def test_a_frame_that_a_restart_cut_short_takes_none_along():
    bench = Bench(faults=Faults(reset_at=0.1))
    *_, last = [bench.board.advance() for _ in range(10)]
    bench.decoder.feed(last[:-5])
    _, hello, state = bench.events()
    assert (type(hello), type(state)) == (Hello, State)


def test_a_restart_begins_everything_anew_but_the_motion_and_ends_an_emergency_stop():
    faults = Faults(emergency_stop_at=0.05, reset_at=0.5)
    bench = Bench(faults=faults, plant=Plant(PAPER, q=(-1.0, 0.3))).armed()
    first = next(e for e in Bench().events() if isinstance(e, Hello))
    assert bench.step(49).status == Status.EMERGENCY_STOP
    hello, state = bench.events()
    assert hello.boot_id != first.boot_id
    assert (hello.seq, hello.t_us, state.t_us, state.enc1, state.enc2) == (0, 0, 0, 0, 0)
    assert (state.status, state.cmd_seq) == (0, 0)
    bench.send(1)
    assert bench.step().status == 0
    bench.armed()


def test_a_damaged_frame_and_an_overrun_are_said_once():
    bench = Bench()
    bench.board.receive(b'nonsense\0' + encode(State(0, 0, 0, 0, 0, 0, 0, 0, 0)))
    bench.board.note_overrun()
    assert bench.step().status == Status.DAMAGED_FRAME | Status.OVERRUN
    assert bench.step().status == 0


def test_a_payload_is_put_on_and_taken_off_where_the_rig_is():
    bench = Bench(plant=Plant(PAPER, (0.3, 0.4)))
    bench.step(20)
    fellow = Plant(PAPER, bench.board._plant.q, bench.board._plant.qd)
    for rig, payload in ((PAPER.carrying(0.02), 0.02), (PAPER, 0.0)):
        bench.board.carry(payload)
        fellow.become(rig)
        for _ in range(20):
            bench.step()
            fellow.advance((0.0, 0.0), 0.01)
        assert bench.board._plant.q == pytest.approx(fellow.q, abs=1e-12)


def test_the_same_seed_gives_the_same_bytes_and_another_seed_others():
    faults = Faults(bit_flip=0.2, drop_byte=0.2, double_byte=0.2, lose_frame=0.1, duplicate_frame=0.1, glitch=0.1)

    def stream(seed):
        board = VirtualBoard(Plant(PAPER), faults=faults, seed=seed)
        return [board.advance() for _ in range(200)]

    assert stream(1) == stream(1)
    assert stream(1) != stream(2)


@pytest.mark.parametrize(
    ('kind', 'name', 'value'),
    [
        (BoardSettings, 'counts', 0),
        (BoardSettings, 'torque_limit', math.nan),
        (Faults, 'bit_flip', 1.5),
        (Faults, 'reset_at', -1),
    ],
)
def test_settings_that_make_no_sense_are_refused(kind, name, value):
    with pytest.raises(ParameterError, match=f'{name} is {value:g}'):
        kind(**{name: value})
