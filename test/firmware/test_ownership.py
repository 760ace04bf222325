# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Ownership of the motor: random requests to the boards in Python and C, compared with each other and a model.

Torque needs an ARM valid for this boot and COMMANDs of the same session within the watchdog period, and ends with any
disarming. The model predicts armed bit, torque, lock and refused requests.
"""

import os
import random
import struct
from collections import Counter

from pendubot_identification.link.protocol import (
    BITS,
    FAULTS,
    Arm,
    Command,
    Damaged,
    Decoder,
    HelloRequest,
    Limits,
    Status,
    encode,
    frame,
)
from pendubot_identification.link.virtual_board import BoardSettings, Faults, VirtualBoard
from pendubot_identification.model.parameters import PAPER
from pendubot_identification.model.simulation import Plant

#: Number of damaged inputs; for a million set FIRMWARE_INPUTS=1000000.
INPUTS = int(os.environ.get('FIRMWARE_INPUTS', '10000'))
#: Number of frames to each board; for a million set OWNERSHIP_FRAMES=1000000.
FRAMES = int(os.environ.get('OWNERSHIP_FRAMES', '20000'))
PERIOD_US, WATCHDOG_MAX_MS, TORQUE_LIMIT, SLEW = 1000, 30, 1_000_000, 400_000
OVER_CURRENT_US = 100_000
#: Limits that a motion reaches, for every second boot; the others have only the slew limit, which the model includes.
TRIPPED = {
    'torque_slew': (0, 1, 200_000),
    'max_speed': (0, 1000, 20_000),
    'max_travel1': (0, 200, 60_000),
    'max_travel2': (0, 200, 2**32 - 1),
    'stall_torque': (0, 1, 1, 200_000),
    'stall_ms': (0, 5, 5, 65535),
    'continuous_ma': (0, 1000, 3000, 65535),
    'overload_ms': (0, 2, 5, 65535),
    'max_vbus': (0, 2400, 2400, 2399),
}


class Model:
    """The rules of docs/protocol.md on ownership, for one boot of a board."""

    def __init__(self, boot_id):
        self.boot_id, self.session, self.lock, self.refused = boot_id, 0, 1, 0
        self.armed = False
        self.wanted = self.torque = self.until_us = 0

    def disarm(self):
        self.armed, self.wanted, self.torque = False, 0, 0
        self.lock = (self.lock + 1) % 65536

    def receive(self, request, now_us, fault):
        """Process a request; return its outcome."""
        if isinstance(request, Command) and request.mode == 0:
            self.disarm()
            return 'disarmed'
        if isinstance(request, Command) and request.mode == 1:
            if request.session == 0 or request.session != self.session:
                return self.refuse()
            if not self.armed or fault:
                return 'ignored'
            self.wanted = request.torque
        elif isinstance(request, Arm):
            if self.armed and request.session == self.session:
                return 'repeated'
            fits = request.boot_id == self.boot_id and request.lock == self.lock and request.session > 0
            if not fits or self.armed or fault:
                return self.refuse()
            self.armed, self.session = True, request.session
        else:
            return 'nothing'
        self.until_us = now_us + 1000 * min(request.watchdog_ms, WATCHDOG_MAX_MS)
        return 'armed' if isinstance(request, Arm) else 'commanded'

    def refuse(self):
        self.refused = (self.refused + 1) % 65536
        return 'refused'

    def sample(self, now_us, fault):
        """Return whether the board is armed, the torque that it applies, and if it is saturated and slewed."""
        if self.armed and (fault or now_us >= self.until_us):
            self.disarm()
        allowed = max(-TORQUE_LIMIT, min(TORQUE_LIMIT, self.wanted))
        self.torque = max(self.torque - SLEW, min(self.torque + SLEW, allowed))
        return self.armed, self.torque, allowed != self.wanted, self.torque != allowed


class BothBoards:
    """A boot of the boards in Python and in C, both with the plant of the board in Python."""

    def __init__(self, probe, clock_us, limits, faults, seed):
        settings = BoardSettings(
            torque_limit=TORQUE_LIMIT / 1e6,
            sample_period_us=PERIOD_US,
            watchdog_max_ms=WATCHDOG_MAX_MS,
            clock_start_us=clock_us,
            limits=limits,
        )
        self._probe, self._decoder = probe, Decoder()
        self._python = VirtualBoard(Plant(PAPER), settings, faults, seed)
        frames = self._python.sample()
        self.hello, self.state = self._decoder.feed(frames)
        options = {'limit': TORQUE_LIMIT, 'period_us': PERIOD_US, 'watchdog_max_ms': WATCHDOG_MAX_MS, 'limits': limits}
        probe.boot(self.hello.boot_id, torque_constant=self.hello.torque_constant, **options)
        assert probe.sample(clock_us)[1] == frames

    def step(self, late_us, now_us, fault, data):
        """Send bytes to both boards and take a sample of each; the frames must be equal."""
        python, now_us = self._python, now_us % 2**32
        python.move(late_us)
        python.receive(data)
        self._probe.receive(data, now_us, fault)
        frames, read = python.sample(), python.last
        assert self._probe.sample(now_us, read.enc1, read.enc2, read.current, read.vbus, fault)[1] == frames
        self.state = self._decoder.feed(frames)[-1]


def requests(rng, model, history):
    """Return a few random requests, None for a damaged one; many are valid, others have old boots, locks, sessions."""
    requests = []
    for _ in range(rng.choice([0, 1, 1, 2, 3, 6])):
        seq, kind = rng.randrange(65536), rng.random()
        session = model.session if rng.random() < 0.7 else rng.choice([0, 1, 2, 3, 0xFFFFFFFF])
        watchdog_ms = rng.choice([0, 1, 5, 20, 30, 31, 1000, 65535])
        if kind < 0.45:
            mode = 1 if rng.random() < 0.95 else rng.randrange(256)
            torque = rng.choice([-(2**31), 2**31 - 1, rng.randint(-1_200_000, 1_200_000)])
            requests.append(Command(seq, 0, mode, watchdog_ms, torque, session))
        elif kind < 0.75:
            boot_id = model.boot_id if rng.random() < 0.8 else rng.choice([0, model.boot_id ^ 1])
            lock = (model.lock + rng.choice([0, 0, 0, 0, 0, -1, 1])) % 65536
            session = rng.choice([1, 2, 3, session])
            requests.append(Arm(seq, 0, boot_id, session, lock, watchdog_ms))
        elif kind < 0.8:
            mode, session = rng.choice([(0, session), (2, model.boot_id)])
            requests.append(Command(seq, 0, mode, watchdog_ms, rng.randrange(1000), session))
        elif kind < 0.85:
            requests.append(HelloRequest(seq, 0))
        elif kind < 0.95 and history:
            requests.append(rng.choice(history))  # repeated, from this boot or an earlier one
        else:
            requests.append(None)
    return requests


def noise(rng):
    """Return random bytes and the end of a frame."""
    return rng.randbytes(rng.randrange(120)) + b'\0'


def damaged(rng):
    """Return altered, cut or joined frames, correct frames of invalid bodies, or noise."""
    kind = rng.randrange(7)
    body = struct.pack('<BBHI', rng.choice([2, 2, 5, 5, 4, 1, 3, rng.randrange(256)]), 2, rng.randrange(65536), 0)
    body += rng.randbytes(rng.choice([12, 13, 0, rng.randrange(85)]))
    if kind == 0:
        return noise(rng)
    if kind == 1:
        return frame(bytes([body[0], rng.randrange(256)]) + body[2:])
    if kind == 2:
        return frame(body[: rng.randrange(len(body) + 1)])
    if kind == 3:
        return bytes([7]) * rng.randrange(120) + encode(Command(1, 0, 0))
    data = bytearray(frame(body))
    at = rng.randrange(len(data))
    # Change, lose or add a byte, or none.
    data[at : at + rng.randrange(2)] = rng.randbytes(rng.randrange(2))
    return bytes(data)


def test_the_boards_agree_on_damaged_frames(probe):
    """A frame that lost its end continues in the next."""
    rng = random.Random(int(os.environ.get('FIRMWARE_SEED', '1')))
    boards, seen = BothBoards(probe, 0, Limits(), Faults(), 1), Counter()
    decoder = Decoder(accept=(Command, HelloRequest, Arm))
    for k in range(1, INPUTS):
        data = damaged(rng)
        boards.step(0, PERIOD_US * k, 0, data)
        events = decoder.feed(data)
        seen.update(event.reason if isinstance(event, Damaged) else type(event).__name__ for event in events)
    print(INPUTS, 'inputs:', dict(seen))
    assert set(seen) == {'overlong', 'cobs', 'length', 'crc', 'version', 'type', 'Command', 'HelloRequest', 'Arm'}


def test_torque_needs_an_arming_of_this_boot_and_a_command_of_its_session_in_time(probe):
    rng = random.Random(int(os.environ.get('OWNERSHIP_SEED', '1')))
    seen, history, frames = Counter(), [], 0
    while frames < FRAMES:
        clock_us = start_us = rng.choice([0, 0, 2**32 - 50_000])
        # Between the times of samples, so that rounding has no effect.
        stop_us, current_us = rng.randrange(50, 4_000_000, 100), rng.randrange(50, 1_000_000, 100)
        faults = Faults(emergency_stop_at=stop_us / 1e6, over_current_at=current_us / 1e6, stuck_at=rng.random())
        modelled = rng.random() < 0.5
        limits = {'torque_slew': SLEW} if modelled else {name: rng.choice(values) for name, values in TRIPPED.items()}
        boards = BothBoards(probe, clock_us, Limits(**limits), faults, rng.randrange(2**32))
        model = Model(boards.hello.boot_id)
        for _ in range(rng.randrange(1, 500)):
            late_us = rng.choice([0, 0, 0, 0, 0, 0, 300, 500, 501, 50_000])
            clock_us += PERIOD_US + late_us
            elapsed_us = clock_us - start_us
            fault = Status.EMERGENCY_STOP if elapsed_us >= stop_us else 0
            fault |= Status.OVER_CURRENT if 0 <= elapsed_us - current_us < OVER_CURRENT_US else 0
            sent = requests(rng, model, history)
            data = b''.join(encode(request) if request else noise(rng) for request in sent)
            boards.step(late_us, clock_us, int(fault), data)
            state, history = boards.state, (history + [request for request in sent if request])[-50:]
            frames += len(sent)
            seen.update(name for name, bit in BITS.items() if bit & state.status)
            seen.update(model.receive(request, clock_us, fault) for request in sent)
            was, actual = model.armed, (bool(state.status & Status.ARMED), state.torque, state.lock, state.refused)
            armed, torque, *shaped = model.sample(clock_us, fault)
            seen['samples with torque'] += torque != 0
            seen['disarmed by a fault' if fault else 'disarmed by the watchdog'] += was and not armed
            assert not modelled or actual == (armed, torque, model.lock, model.refused), (sent, model.__dict__)
            assert not modelled or [bool(state.status & bit) for bit in (Status.SATURATED, Status.SLEW)] == shaped
            assert not (actual[0] and state.status & FAULTS)
            model.armed, model.torque, model.lock, model.refused = actual
        seen['boots'] += 1
    print(frames, 'frames:', dict(seen))
    # Every outcome must be frequent enough.
    assert seen['refused'] > frames / 10
    assert min(seen['armed'], seen['commanded'], seen['samples with torque']) > frames / 40
    assert min(seen['disarmed by the watchdog'], seen['disarmed']) > frames / 80
    assert min(seen['disarmed by a fault'], seen['ignored'], seen['repeated'], seen['boots']) > frames / 4000
    assert all(seen[name] for name in ('SPEED', 'TRAVEL', 'STALL', 'OVERLOAD', 'OVERVOLTAGE', 'LATE', 'ZEROED'))
