# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The virtual board's faults, limits on its own plant and settings.

The rules of arming, sessions, watchdog and torque are tested in test/firmware/: on the board in C one by one, on both
boards against a model and against each other (test_ownership.py).
"""

import math

import pytest

from pendubot_identification.errors import ParameterError
from pendubot_identification.link.protocol import (
    Arm,
    Command,
    Decoder,
    Hello,
    Limits,
    State,
    Status,
    encode,
)
from pendubot_identification.link.virtual_board import BoardSettings, Faults, VirtualBoard
from pendubot_identification.model.parameters import PAPER
from pendubot_identification.model.simulation import Plant


class Bench:
    """A virtual board and a hand that sends commands to it."""

    def __init__(self, settings=None, faults=None, seed=0, plant=None):
        self.board = VirtualBoard(plant or Plant(PAPER), settings, faults, seed)
        self.decoder = Decoder()
        self.seq = 0
        self.last = None

    def step(self, samples=1):
        """Return the last STATE."""
        return [e for e in self.events(samples) if isinstance(e, State)][-1]

    def events(self, samples=1):
        found = [event for _ in range(samples) for event in self.decoder.feed(self.board.advance())]
        self.hello = next((e for e in found if isinstance(e, Hello)), getattr(self, 'hello', None))
        self.last = found[-1]
        return found

    def send(self, mode, torque=0, watchdog_ms=100, session=5):
        self.seq += 1
        self.board.receive(encode(Command(self.seq, 0, mode, watchdog_ms, torque, session=session)))

    def arm(self, session=5, lock=None, boot_id=None, watchdog_ms=100):
        """Ask to be armed, by default as it fits; a sample has to have been taken."""
        self.seq += 1
        lock = self.last.lock if lock is None else lock
        boot_id = self.hello.boot_id if boot_id is None else boot_id
        self.board.receive(encode(Arm(self.seq, 0, boot_id, session, lock, watchdog_ms)))

    def armed(self):
        self.step()
        self.arm()
        assert self.step().status == Status.ARMED
        return self


#: Limits, what happens, after how many samples of 10 ms the motor is off, and by what fault.
LIMITED = [
    (Limits(max_speed=2000), {}, 0.9, Status.SPEED, 3),
    (Limits(max_travel1=300), {}, 0.9, Status.TRAVEL, 4),
    (Limits(stall_torque=100_000, stall_ms=50), {'stuck_at': 0.0}, 0.2, Status.STALL, 5),
    (Limits(continuous_ma=1000, overload_ms=100), {}, 0.2, Status.OVERLOAD, 10),
    (Limits(max_vbus=2300), {}, 0.2, Status.OVERVOLTAGE, 0),
]


@pytest.mark.parametrize(('limits', 'faults', 'torque', 'fault', 'after'), LIMITED)
def test_a_limit_disarms_and_is_named_until_a_mode_0(limits, faults, torque, fault, after):
    bench = Bench(BoardSettings(limits=limits), Faults(**faults))
    bench.step()
    bench.arm()
    torques = []
    for _ in range(60):
        bench.send(1, round(1e6 * torque))
        torques.append(bench.step().torque)
    assert bench.last.status & fault
    assert torques.count(0) + torques.count(round(1e6 * torque)) == 60
    assert sum(map(bool, torques)) == after
    assert not any(torques[next(k for k, x in enumerate(torques) if not x) :]), 'once off, it stays off'
    if fault not in (Status.OVERVOLTAGE, Status.TRAVEL, Status.SPEED):
        bench.step(300)
        assert bench.last.status == fault
        bench.send(0)
        assert bench.step().status == 0


def test_the_torque_is_held_from_its_sample_until_the_next_and_moves_the_plant():
    bench = Bench().armed()
    bench.send(1, 300_000)
    first = bench.step()
    assert (first.torque, first.enc1) == (300_000, 0)
    reference = Plant(PAPER)
    reference.advance((0.3, 0.0), 0.01)
    assert bench.step().enc1 == round((reference.q[0] + math.pi / 2) * 4000 / (2 * math.pi)) != 0


def test_a_restart_begins_everything_anew_but_the_motion_and_ends_an_emergency_stop():
    faults = Faults(emergency_stop_at=0.05, reset_at=0.5)
    bench = Bench(faults=faults, plant=Plant(PAPER, q=(-1.0, 0.3))).armed()
    first = bench.hello
    assert bench.step(48).status == Status.EMERGENCY_STOP
    hello, state = bench.events()
    assert hello.boot_id != first.boot_id
    assert (hello.seq, hello.t_us, state.t_us, state.enc1, state.enc2) == (0, 0, 0, 0, 0)
    assert (state.status, state.cmd_seq, state.lock, state.refused) == (0, 0, 1, 0)
    bench.send(1)
    assert bench.step().status == Status.REFUSED
    bench.armed()


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
        (Limits, 'stall_ms', 70_000),
    ],
)
def test_settings_that_make_no_sense_are_refused(kind, name, value):
    with pytest.raises(ParameterError, match=f'{name} is {value:g}'):
        BoardSettings(limits=Limits(**{name: value})) if kind is Limits else kind(**{name: value})
