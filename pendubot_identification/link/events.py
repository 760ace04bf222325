# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The interface between a host and its program: configuration in; samples, reports, bytes and counters out."""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

from pendubot_identification.level import Level
from pendubot_identification.model.dynamics import Pair

from .clock import SECOND, WRAP
from .protocol import Arm, Command, HelloRequest, encode


@dataclass(frozen=True, slots=True)
class HostConfig:
    """The user's settings of the link."""

    sign: Pair = (1.0, 1.0)  #: Sign of each encoder, +1 or -1; the torque keeps its sign.
    zero: Pair = (-math.pi / 2, 0.0)  #: Position [rad] of each joint at count 0.
    counts_per_turn: tuple[int, int] = (0, 0)  #: Counts per turn of each encoder; 0: the value in the board's HELLO.
    torque_limit: float = 2.0  #: Largest torque that is sent [N m].
    watchdog_ms: int = 100  #: Time without a command [ms] after which the board switches its motor off.
    command_timeout: float = 0.1  #: Time without an effort command [s] after which the torque is 0.
    #: Time without a valid frame [s] after which the link is lost; at least five sample periods.
    link_timeout: float = 0.1
    max_speed: float = 100.0  #: A sample that implies a higher speed [rad/s] is flagged; three in a row disarm.
    max_travel: Pair = (0.0, 0.0)  #: Largest distance of each joint from count 0 [rad]; 0: the board's limit.
    confirm_zeros: bool = True  #: Whether the zeros have to be confirmed once for every boot of the board.


class Sample(NamedTuple):
    """One sample of the board, in SI units."""

    stamp_ns: int  #: The board's sampling time on the host's clock [ns]; increases from sample to sample.
    q: Pair  #: Positions [rad].
    qd: Pair  #: Velocities [rad/s].
    effort: float  #: Torque of the shoulder until the next sample [N m].
    current: float  #: Measured motor current [A].


@dataclass(frozen=True, slots=True)
class Report:
    """An event to report to the user; level ``OK`` is information."""

    level: Level
    text: str


@dataclass(frozen=True, slots=True)
class ArmingEnded:
    """The end of an arming request: the board is armed if ``reason`` is empty, else ``reason`` is the failure."""

    reason: str = ''


HostEvent = Sample | Report | ArmingEnded


@dataclass(slots=True)
class Counters:
    """Numbers of events since the start."""

    received: int = 0  #: Valid frames.
    published: int = 0  #: Samples.
    lost: int = 0  #: Frames missing in the sequence numbers while the link was up, damaged frames included.
    duplicates: int = 0  #: Frames that arrived twice.
    out_of_order: int = 0  #: Frames that arrived after a later frame.
    damaged: dict[str, int] = field(default_factory=dict)  #: Damaged frames by reason.
    unscaled: int = 0  #: Samples before the first HELLO.
    flagged: int = 0  #: Samples that imply a speed above ``max_speed``.
    jumps: int = 0  #: New positions that were accepted after several flagged samples.
    irregular_stamps: int = 0  #: Samples with an implausible ``t_us``, which was replaced.
    clock_jumps: int = 0  #: Jumps of the board's clock.
    late_samples: int = 0  #: Samples that the board took more than half a period late.
    foreign_requests: int = 0  #: Requests of other programs that the board refused.
    restarts: int = 0  #: Restarts of the board.
    link_losses: int = 0
    trips: int = 0  #: Trips of the board's watchdog.
    discarded: int = 0  #: Effort commands while disarmed.
    clamped: int = 0  #: Effort commands beyond the limit.
    not_finite: int = 0  #: Effort commands that were NaN or infinite.
    command_timeouts: int = 0  #: Interruptions of the effort commands.
    sent: int = 0  #: Frames sent to the board.
    board_damaged: int = 0  #: STATEs that report a damaged frame from the host.
    board_overruns: int = 0  #: STATEs that report a frame that the board could not send.


class Output:
    """The output queue of a host: events and, while the port is ``open``, frames; and the host's counters.

    ``seq`` is the sequence number of the last frame.
    """

    def __init__(self) -> None:
        self.counters = Counters()
        self.open = False
        self.seq = 0
        self.data = b''
        self._events: list[HostEvent] = []
        self._last: dict[str, int] = {}

    def emit(self, event: HostEvent) -> None:
        """Add an event."""
        self._events.append(event)

    def report(self, level: Level, text: str) -> None:
        """Add a report."""
        self._events.append(Report(level, text))

    def is_new(self, name: str, now: int) -> bool:
        """Record an occurrence of a recurring event at ``now`` [ns]; return whether the second before had none."""
        last, self._last[name] = self._last.get(name), now
        return last is None or now - last > SECOND

    def report_new(self, name: str, now: int, level: Level, text: str) -> None:
        """Add a report of a recurring event, unless it occurred in the second before."""
        if self.is_new(name, now):
            self.report(level, text)

    def take_events(self) -> list[HostEvent]:
        """Return all events since the last call."""
        events, self._events = self._events, []
        return events

    def take_data(self) -> bytes:
        """Return the bytes to write to the port since the last call."""
        data, self.data = self.data, b''
        return data

    def send(self, message: type[HelloRequest | Command | Arm], now: int, **fields: int) -> None:
        """Send a message with the next sequence number at ``now`` [ns]; a closed port drops it."""
        self.seq = (self.seq + 1) & 0xFFFF
        if self.open:
            self.data += encode(message(self.seq, now // 1000 % WRAP, **fields))
            self.counters.sent += 1
