# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The virtual board's plant, faults and settings; test/firmware/ has the rules of arming, watchdog and limits."""

import pytest

from pendubot_identification.link.protocol import Arm, Command, Decoder, Status, encode
from pendubot_identification.link.virtual_board import Faults, VirtualBoard
from pendubot_identification.model.parameters import PAPER
from pendubot_identification.model.simulation import Plant


class Bench:
    """A virtual board and a sender of requests; ``hello`` and ``state`` are the board's last."""

    def __init__(self, board):
        self.board, self.decoder = board, Decoder()
        self.hello, self.state = self.decoder.feed(board.sample())

    def step(self, samples=1):
        for _ in range(samples):
            self.board.move()
            *hello, self.state = self.decoder.feed(self.board.sample())
            self.hello = (hello or [self.hello])[0]
        return self.state

    def arm(self):
        """Arm the board for half a second."""
        self.board.receive(encode(Arm(1, 0, self.hello.boot_id, 5, self.state.lock, 500)))
        assert self.step().status == Status.ARMED
        return self

    def torque(self, torque):
        self.board.receive(encode(Command(2, 0, 1, 500, torque, session=5)))


def test_a_restart_resets_everything_except_the_motion_and_ends_an_emergency_stop():
    bench = Bench(VirtualBoard(Plant(PAPER, q=(-1.0, 0.3)), faults=Faults(reset_at=0.5))).arm()
    first = bench.hello
    bench.board.present = Status.EMERGENCY_STOP
    assert bench.step().status == Status.EMERGENCY_STOP
    bench.board.present = 0
    assert bench.step(47).status == Status.EMERGENCY_STOP
    state, hello = bench.step(), bench.hello
    assert hello.boot_id != first.boot_id
    assert (hello.seq, hello.t_us, state.t_us, state.enc1, state.enc2) == (0, 0, 0, 0, 0)
    assert (state.status, state.cmd_seq, state.lock, state.refused) == (0, 0, 1, 0)
    bench.torque(0)
    assert bench.step().status == Status.REFUSED
    bench.arm()


def test_a_payload_is_added_and_removed_without_changing_the_position():
    board, fellow = VirtualBoard(Plant(PAPER, (0.3, 0.4))), Plant(PAPER, (0.3, 0.4))
    for rig, payload in ((PAPER.carrying(0.02), 0.02), (PAPER, 0.0)):
        board.carry(payload)
        fellow.become(rig)
        for _ in range(20):
            board.sample()
            board.move()
            fellow.advance((0.0, 0.0), 0.01)
        assert board._plant.q == pytest.approx(fellow.q, abs=1e-12)


def test_the_seed_determines_the_bytes():
    def stream(seed):
        board = VirtualBoard(Plant(PAPER), faults=Faults(bit_flip=0.2, glitch=0.1), seed=seed)
        return [board.sample() for _ in range(200)]

    assert stream(1) == stream(1)
    assert stream(1) != stream(2)
