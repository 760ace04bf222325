# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What passes between a host and its program: configuration in; samples, reports, bytes and counts out."""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

from pendubot_identification.level import Level
from pendubot_identification.model.dynamics import Pair

from .clock import SECOND, WRAP
from .protocol import Arm, Command, HelloRequest, encode


@dataclass(frozen=True, slots=True)
class HostConfig:
    """What the user decides."""

    sign: Pair = (1.0, 1.0)  #: +1 or -1 for each joint; it turns the encoder, not the torque.
    zero: Pair = (-math.pi / 2, 0.0)  #: Position [rad] of each joint at count 0.
    counts_per_turn: tuple[int, int] = (0, 0)  #: Of each encoder; 0 takes it from the board's HELLO.
    torque_limit: float = 2.0  #: Largest torque ever sent [N m].
    watchdog_ms: int = 100  #: After this long without a command the board switches its motor off.
    command_timeout: float = 0.1  #: After this long [s] without an effort command the torque sent is 0.
    #: After this long [s], and five sample periods, without anything valid from the board the link is lost.
    link_timeout: float = 0.1
    max_speed: float = 100.0  #: A sample that would need more [rad/s] is flagged; three in a row disarm.
    max_travel: Pair = (0.0, 0.0)  #: Of each joint to either side of count 0 [rad]; 0 leaves it to the board.
    confirm_zeros: bool = True  #: Whether the zeros have to be confirmed once for every boot of the board.


class Sample(NamedTuple):
    """One sample to publish: positions [rad], velocities [rad/s], shoulder torque [N m] from now until the next.

    ``current`` is the motor's [A], as measured at the sample. ``stamp_ns`` is the board's sampling time on the host's
    clock; it increases from sample to sample.
    """

    stamp_ns: int
    q: Pair
    qd: Pair
    effort: float
    current: float


@dataclass(frozen=True, slots=True)
class Report:
    """Something that happened and that the user has to know; level ``OK`` is good news."""

    level: Level
    text: str


@dataclass(frozen=True, slots=True)
class ArmingEnded:
    """The board says that it is armed; or arming failed, or was given up, for a reason."""

    reason: str = ''


HostEvent = Sample | Report | ArmingEnded


@dataclass(slots=True)
class Counters:
    """What has happened since the start."""

    received: int = 0  #: Frames that were whole.
    published: int = 0  #: Samples.
    lost: int = 0  #: Frames missing by their numbers while the link was up, those that arrived damaged among them.
    duplicates: int = 0  #: Frames that came twice.
    out_of_order: int = 0  #: Frames that came after a later one.
    damaged: dict[str, int] = field(default_factory=dict)  #: Frames, by reason.
    unscaled: int = 0  #: Samples that came before HELLO.
    flagged: int = 0  #: Samples that would have needed too high a speed.
    jumps: int = 0  #: New positions that were accepted after several such samples.
    irregular_stamps: int = 0  #: Samples whose ``t_us`` could not be true and was replaced.
    clock_jumps: int = 0  #: How often the board's clock jumped and went on from there.
    late_samples: int = 0  #: Samples that the board took more than half a period late.
    foreign_requests: int = 0  #: Requests of other programs that the board refused.
    restarts: int = 0  #: Of the board.
    link_losses: int = 0
    trips: int = 0  #: Of the board's watchdog.
    discarded: int = 0  #: Effort commands that came while not armed.
    clamped: int = 0  #: Effort commands beyond the limit.
    not_finite: int = 0  #: Effort commands that were NaN or infinite.
    command_timeouts: int = 0  #: How often effort commands stopped coming.
    sent: int = 0  #: Frames.
    board_damaged: int = 0  #: STATEs in which the board noted a damaged frame from the host.
    board_overruns: int = 0  #: STATEs in which the board noted that it could not send.


class Output:
    """Events and, while the port is ``open``, frames that leave a host, until they are taken; and its counters.

    ``seq`` is the number of the last frame, ``frames`` how many there were.
    """

    def __init__(self) -> None:
        self.counters = Counters()
        self.open = False
        self.seq = self.frames = 0
        self.data = b''
        self._events: list[HostEvent] = []
        self._last: dict[str, int] = {}

    def emit(self, event: HostEvent) -> None:
        """Add an event."""
        self._events.append(event)

    def report(self, level: Level, text: str) -> None:
        """Add a report."""
        self._events.append(Report(level, text))

    def is_new(self, what: str, now: int) -> bool:
        """Note that something recurring happened at ``now`` [ns]; return whether it did not in the second before."""
        last, self._last[what] = self._last.get(what), now
        return last is None or now - last > SECOND

    def take_events(self) -> list[HostEvent]:
        """Return all events since the last call."""
        events, self._events = self._events, []
        return events

    def take_data(self) -> bytes:
        """Return all that has to be written to the port since the last call."""
        data, self.data = self.data, b''
        return data

    def send(self, message: type[HelloRequest | Command | Arm], now: int, **fields: int) -> None:
        """Send a message of these fields under the next number, at ``now`` [ns]; a closed port takes nothing."""
        self.seq = (self.seq + 1) & 0xFFFF
        self.frames += 1
        if self.open:
            self.data += encode(message(self.seq, now // 1000 % WRAP, **fields))
            self.counters.sent += 1
