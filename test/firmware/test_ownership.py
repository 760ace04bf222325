# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Ownership of the motor: random and damaged requests to the boards in Python and C, which send the same frames.

Torque needs an ARM valid for this boot and COMMANDs of the same session within the watchdog period, and ends with any
disarming.
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

#: Number of frames to each board; for a million set OWNERSHIP_FRAMES=1000000.
FRAMES = int(os.environ.get('OWNERSHIP_FRAMES', '15000'))
PERIOD_US, WATCHDOG_MAX_MS, TORQUE_LIMIT = 1000, 30, 1_000_000
OVER_CURRENT_US = 100_000
#: Limits that a motion reaches.
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
        python.present = fault
        python.receive(data)
        self._probe.receive(data, now_us, fault)
        frames, read = python.sample(), python.last
        assert self._probe.sample(now_us, read.enc1, read.enc2, read.current, read.vbus, fault)[1] == frames
        self.state = self._decoder.feed(frames)[-1]


def requests(rng, boot_id, session, lock, history):
    """Return a few random requests, None for a damaged one; many are valid, others have old boots, locks, sessions."""
    requests = []
    for _ in range(rng.choice([0, 1, 1, 2, 3, 6])):
        seq, kind = rng.randrange(65536), rng.random()
        other = session if rng.random() < 0.7 else rng.choice([0, 1, 2, 3, 0xFFFFFFFF])
        watchdog_ms = rng.choice([0, 1, 5, 20, 30, 31, 1000, 65535])
        if kind < 0.45:
            mode = 1 if rng.random() < 0.95 else rng.randrange(256)
            torque = rng.choice([-(2**31), 2**31 - 1, rng.randint(-1_200_000, 1_200_000)])
            requests.append(Command(seq, 0, mode, watchdog_ms, torque, other))
        elif kind < 0.75:
            boot = boot_id if rng.random() < 0.8 else rng.choice([0, boot_id ^ 1])
            near = (lock + rng.choice([0, 0, 0, 0, 0, -1, 1])) % 65536
            requests.append(Arm(seq, 0, boot, rng.choice([1, 2, 3, other]), near, watchdog_ms))
        elif kind < 0.8:
            mode, target = rng.choice([(0, other), (2, boot_id)])
            requests.append(Command(seq, 0, mode, watchdog_ms, rng.randrange(1000), target))
        elif kind < 0.82:
            requests.append(HelloRequest(seq, 0))
        elif kind < 0.9 and history:
            requests.append(rng.choice(history))  # repeated, from this boot or an earlier one
        else:
            requests.append(None)
    return requests


def damaged(rng):
    """Return altered, cut or joined frames, correct frames of random bodies, or noise.

    A frame that lost its end continues in the next.
    """
    kind = rng.randrange(7)
    body = struct.pack('<BBHI', rng.choice([2, 2, 5, 5, 4, 1, 3, rng.randrange(256)]), 2, rng.randrange(65536), 0)
    body += rng.randbytes(rng.choice([12, 13, 0, rng.randrange(85)]))
    if kind == 0:
        return rng.randbytes(rng.randrange(120)) + b'\0'
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


def test_torque_needs_an_arming_of_this_boot_and_a_command_of_its_session_in_time(probe):
    rng = random.Random(int(os.environ.get('OWNERSHIP_SEED', '1')))
    seen, history, frames = Counter(), [], 0
    while frames < FRAMES:
        clock_us = start_us = rng.choice([0, 0, 2**32 - 50_000])
        stop_us, current_us = rng.randrange(4_000_000), rng.randrange(1_000_000)
        limits = {name: rng.choice(values) for name, values in TRIPPED.items() if rng.random() < 0.5}
        boards = BothBoards(probe, clock_us, Limits(**limits), Faults(stuck_at=rng.random()), rng.randrange(2**32))
        boot_id, state = boards.hello.boot_id, boards.state
        owner, session, commanded, until_us = 0, 0, False, 0
        decoder = Decoder(accept=(Command, HelloRequest, Arm))
        for _ in range(rng.randrange(1, 250)):
            late_us = rng.choice([0, 0, 0, 0, 0, 0, 300, 500, 501, 50_000])
            clock_us += PERIOD_US + late_us
            elapsed_us = clock_us - start_us
            fault = Status.EMERGENCY_STOP if elapsed_us >= stop_us else 0
            fault |= Status.OVER_CURRENT if 0 <= elapsed_us - current_us < OVER_CURRENT_US else 0
            sent = requests(rng, boot_id, session, state.lock, history)
            data = b''.join(encode(request) if request else damaged(rng) for request in sent)
            before = state
            boards.step(late_us, clock_us, int(fault), data)
            state, history = boards.state, (history + [request for request in sent if request])[-50:]
            frames += len(sent)

            lock = before.lock
            if not before.status & Status.ARMED:
                owner, commanded = 0, False
            for request in decoder.feed(data):
                seen[request.reason if isinstance(request, Damaged) else type(request).__name__] += 1
                if isinstance(request, Command) and request.mode == 0:
                    lock, owner, commanded = (lock + 1) % 65536, 0, False
                elif isinstance(request, Command) and request.mode == 1 and request.session == owner:
                    commanded, until_us = True, clock_us + 1000 * min(request.watchdog_ms, WATCHDOG_MAX_MS)
                elif isinstance(request, Arm) and not owner and (request.boot_id, request.lock) == (boot_id, lock):
                    owner = request.session
                    until_us = clock_us + 1000 * min(request.watchdog_ms, WATCHDOG_MAX_MS)
            session = owner or session
            if state.status & Status.ARMED:
                assert owner, 'armed without a valid ARM'
                assert clock_us < until_us
                assert not state.status & FAULTS
            assert not state.torque or (state.status & Status.ARMED and commanded)
            assert abs(state.torque) <= TORQUE_LIMIT
            seen.update(name for name, bit in BITS.items() if bit & state.status)
            seen['torque'] += state.torque != 0
        seen['boots'] += 1
    print(frames, 'frames:', dict(seen))
    # Every outcome must be frequent enough.
    assert min(seen['REFUSED'], seen['ARMED'], seen['torque']) > frames / 40
    assert min(seen['WATCHDOG'], seen['OVER_CURRENT'], seen['SATURATED'], seen['SLEW']) > frames / 400
    assert all(seen[name] for name in ('SPEED', 'TRAVEL', 'STALL', 'OVERLOAD', 'OVERVOLTAGE', 'LATE', 'ZEROED'))
    assert min(seen[name] for name in ('overlong', 'cobs', 'length', 'crc', 'version', 'type')) > frames / 400
