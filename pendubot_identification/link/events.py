# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What the host of a board tells its program: samples, reports, how arming ended; and what it counts."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

from pendubot_identification.level import Level
from pendubot_identification.model.dynamics import Pair

from .clock import SECOND


class Sample(NamedTuple):
    """One sample to publish: positions [rad], velocities [rad/s], shoulder torque [N m] from now until the next.

    ``stamp_ns`` is the board's sampling time on the host's clock; it increases from sample to sample.
    """

    stamp_ns: int
    q: Pair
    qd: Pair
    effort: float


@dataclass(frozen=True, slots=True)
class Report:
    """Something that happened and that the user has to know; level ``OK`` is good news."""

    level: Level
    text: str


@dataclass(frozen=True, slots=True)
class Armed:
    """Arming succeeded: the board says that it is armed."""


@dataclass(frozen=True, slots=True)
class ArmingFailed:
    """Arming failed, or was given up, for this reason."""

    reason: str


HostEvent = Sample | Report | Armed | ArmingFailed


class Events:
    """Events in order, until they are taken."""

    def __init__(self) -> None:
        self._events: list[HostEvent] = []

    def tell(self, event: HostEvent) -> None:
        """Add an event."""
        self._events.append(event)

    def report(self, level: Level, text: str) -> None:
        """Add a report."""
        self._events.append(Report(level, text))

    def take(self) -> list[HostEvent]:
        """Return all events since the last call."""
        events, self._events = self._events, []
        return events


class Recurring:
    """Something that may happen again and again, and is reported once as long as it does."""

    def __init__(self) -> None:
        self._last: int | None = None

    def is_new(self, now: int) -> bool:
        """Note that it happened at ``now`` [ns]; tell whether it did not in the second before."""
        last, self._last = self._last, now
        return last is None or now - last > SECOND


@dataclass(slots=True)
class Counters:
    """What has happened since the start.

    Attributes:
        received: frames that were whole.
        published: samples.
        lost: frames missing by their sequence numbers, those that arrived damaged among them.
        duplicates: frames that came twice.
        out_of_order: frames that came after a later one.
        damaged: frames, by reason.
        unscaled: samples that came before HELLO.
        flagged: samples that would have needed too high a speed.
        jumps: new positions that were believed after several such samples.
        restarts: of the board.
        link_losses: how often the link was lost.
        trips: of the board's watchdog.
        discarded: effort commands that came while not armed.
        clamped: effort commands beyond the limit.
        not_finite: effort commands that were NaN or infinite.
        command_timeouts: how often effort commands stopped coming.
        sent: frames.
        board_damaged: STATEs in which the board noted a damaged frame from the host.
        board_overruns: STATEs in which the board noted that it could not send.
    """

    received: int = 0
    published: int = 0
    lost: int = 0
    duplicates: int = 0
    out_of_order: int = 0
    damaged: dict[str, int] = field(default_factory=dict)
    unscaled: int = 0
    flagged: int = 0
    jumps: int = 0
    restarts: int = 0
    link_losses: int = 0
    trips: int = 0
    discarded: int = 0
    clamped: int = 0
    not_finite: int = 0
    command_timeouts: int = 0
    sent: int = 0
    board_damaged: int = 0
    board_overruns: int = 0
