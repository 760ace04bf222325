# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A host and a virtual board over a bad line: no false accusation, and no torque that nobody wants."""

import random
from collections import deque
from dataclasses import dataclass, field

from hypothesis import given, settings
from hypothesis import strategies as st

from pendubot_identification.link.clock import MS
from pendubot_identification.link.events import ArmingEnded, Report
from pendubot_identification.link.host import Host, HostConfig
from pendubot_identification.link.virtual_board import VirtualBoard
from pendubot_identification.model.parameters import PAPER
from pendubot_identification.model.simulation import Plant

#: Reports with one of these words have a cause that no line has.
ACCUSATIONS = ('another program', 'did not send', 'instead of', 'wiring', 'clock', 'restarted', 'correct its firmware')


@dataclass
class Line:
    """One direction of a serial line, with a latency of up to ``latency`` [ms]; ``noise`` damages or loses frames."""

    rng: random.Random
    latency: float
    noise: float
    queue: deque = field(default_factory=deque)

    def send(self, data, now):
        if self.rng.random() < self.noise:
            data = data[: self.rng.randrange(len(data) + 1)]
        arrival = now + round(self.rng.uniform(0, self.latency) * MS)
        self.queue.append((max(arrival, self.queue[-1][0] if self.queue else 0), data))

    def receive(self, now):
        data = b''
        while self.queue and self.queue[0][0] <= now:
            data += self.queue.popleft()[1]
        return data


@settings(max_examples=12)
@given(
    seed=st.integers(0, 2**32),
    latency=st.sampled_from([1, 10, 40]),
    noise=st.sampled_from([0, 0.05]),
    pause=st.sampled_from([0, 20, 110, 700]),
)
def test_a_bad_line_and_a_suspended_program_cause_no_accusation_and_no_unwanted_torque(seed, latency, noise, pause):
    rng = random.Random(seed)
    board, host = VirtualBoard(Plant(PAPER), seed=seed), Host(HostConfig(confirm_zeros=False))
    to_board, to_host = (Line(rng, latency, noise) for _ in range(2))
    now, asleep, wanted, reports, alive = 10**12, 0, False, [], 0
    host.opened(now)
    for ms in range(2000):
        now += MS
        if ms % 10 == 0:
            board.receive(to_board.receive(now))
            to_host.send(board.sample(), now)
            board.move()
            # The last command expires after the watchdog time, but for the latency and a sample.
            assert board.last.torque == 0 or now - alive < (100 + latency + 20) * MS
        if asleep:
            asleep -= 1
            continue
        asleep = pause if rng.random() < 0.002 else 0
        host.receive(to_host.receive(now), now)
        host.poll(now)
        if rng.random() < 0.005:
            wanted = not wanted
            host.arm(now) if wanted else host.motor.disarm(now)
        if host.armed and ms % 7 == 0:
            host.motor.effort(rng.uniform(-0.2, 0.2), now)
        events = host.output.take_events()
        reports += [e.text for e in events if isinstance(e, Report)]
        reports += [e.reason for e in events if isinstance(e, ArmingEnded)]
        to_board.send(host.output.take_data(), now)
        alive = now if wanted else alive
    # A lost request to arm is repeated, unless the host is suspended for too long.
    wrong = ACCUSATIONS if pause > 500 else (*ACCUSATIONS, 'did not confirm')
    assert not [text for text in reports if any(word in text for word in wrong)]
