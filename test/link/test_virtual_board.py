# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The virtual board's plant, boot and settings.

Its rules are those of the firmware: test/firmware/test_link.py compares the frames of both boards.
"""

import math

import pytest

from pendubot_identification.errors import ParameterError
from pendubot_identification.link.protocol import Arm, Command, Decoder, Hello, HelloRequest, Limits, Status, encode
from pendubot_identification.link.virtual_board import BoardSettings, Faults, VirtualBoard
from pendubot_identification.model.parameters import PAPER
from pendubot_identification.model.simulation import Plant


def arm(board, hello):
    board.receive(encode(Arm(1, 0, hello.boot_id, 5, board.last.lock, 100)))


def test_hello_at_boot_and_on_request_describes_the_settings():
    board = VirtualBoard(Plant(PAPER), BoardSettings(1000, 1.5, sample_period_us=2000, watchdog_max_ms=250))
    hello, state = Decoder().feed(board.advance())
    assert isinstance(hello, Hello)
    assert (hello.seq, hello.cpr1, hello.cpr2, hello.torque_limit) == (0, 1000, 1000, 1_500_000)
    assert (hello.sample_period_us, hello.watchdog_max_ms) == (2000, 250)
    assert (state.seq, state.t_us, state.enc1, state.enc2, state.torque, state.status) == (1, 0, 0, 0, 0, 0)
    board.receive(2 * encode(HelloRequest(1, 0)))
    first, second, state = Decoder().feed(board.advance())
    assert (first.seq, first.boot_id, second.seq, state.seq) == (2, hello.boot_id, 3, 4)


def test_a_torque_is_applied_until_the_next_sample_and_moves_the_plant():
    board = VirtualBoard(Plant(PAPER))
    hello, _ = Decoder().feed(board.advance())
    arm(board, hello)
    board.receive(encode(Command(2, 0, 1, 100, 300_000, session=5)))
    board.advance()
    assert (board.last.torque, board.last.enc1) == (300_000, 0)
    reference = Plant(PAPER)
    reference.advance((0.3, 0.0), 0.01)
    board.advance()
    assert board.last.enc1 == round((reference.q[0] + math.pi / 2) * 4000 / (2 * math.pi)) != 0


def test_a_restart_resets_everything_but_the_motion_and_ends_an_emergency_stop():
    board = VirtualBoard(Plant(PAPER, q=(-1.0, 0.3)), faults=Faults(emergency_stop_at=0.05, reset_at=0.5))
    first, _ = Decoder().feed(board.advance())
    arm(board, first)
    board.receive(encode(Command(2, 0, 2, 0, 0, session=first.boot_id ^ 1)))
    board.advance()
    assert board.last.status == Status.ARMED, 'zeros of another boot'
    board.receive(encode(Command(3, 0, 2, 0, 0, session=first.boot_id)))
    board.advance()
    assert board.last.status == Status.ARMED | Status.ZEROED
    for _ in range(47):
        board.advance()
    assert board.last.status == Status.EMERGENCY_STOP | Status.ZEROED
    hello, state = Decoder().feed(board.advance())
    assert hello.boot_id != first.boot_id
    assert (hello.seq, hello.t_us, state.t_us, state.enc1, state.enc2) == (0, 0, 0, 0, 0)
    assert (state.status, state.cmd_seq, state.lock, state.refused) == (0, 0, 1, 0)
    arm(board, hello)
    board.advance()
    assert board.last.status == Status.ARMED


def test_a_payload_is_put_on_and_taken_off_during_the_motion():
    board = VirtualBoard(Plant(PAPER, (0.3, 0.4)))
    for _ in range(20):
        board.advance()
    reference = Plant(PAPER, board._plant.q, board._plant.qd)
    for rig, payload in ((PAPER.carrying(0.02), 0.02), (PAPER, 0.0)):
        board.carry(payload)
        reference.become(rig)
        for _ in range(20):
            board.advance()
            reference.advance((0.0, 0.0), 0.01)
        assert board._plant.q == pytest.approx(reference.q, abs=1e-12)


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
def test_settings_out_of_range_are_refused(kind, name, value):
    with pytest.raises(ParameterError, match=f'{name} is {value:g}'):
        BoardSettings(limits=Limits(**{name: value})) if kind is Limits else kind(**{name: value})
