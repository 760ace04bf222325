"""What the host of a board has to tell: samples to publish, reports for the user, how arming ended, counters."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

from pendubot_identification.level import Level

from .joints import Pair


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
    """Something the user has to know, once for each time it happens; ``OK`` is good news."""

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


class News:
    """What was not fetched yet, in order."""

    def __init__(self) -> None:
        self._events: list[HostEvent] = []

    def tell(self, event: HostEvent) -> None:
        """Add an event."""
        self._events.append(event)

    def report(self, level: Level, text: str) -> None:
        """Add a report."""
        self._events.append(Report(level, text))

    def take(self) -> list[HostEvent]:
        """Return, once, all that was told."""
        events, self._events = self._events, []
        return events


@dataclass(frozen=True, slots=True)
class Counters:
    """What has happened since the start.

    ``received`` frames that were whole; ``published`` samples; ``lost`` (those that arrived damaged among them),
    ``duplicates``, ``out_of_order`` frames by their sequence numbers; ``damaged`` frames by reason; samples
    ``unscaled`` (before HELLO) and ``flagged`` (too fast), ``jumps`` believed; ``restarts`` of the board,
    ``link_losses``, watchdog ``trips``; effort commands ``discarded`` while not armed, ``clamped``, ``not_finite``, and
    ``command_timeouts``; ``sent`` frames; STATEs in which the board noted damaged frames from here
    (``board_damaged``) and transmit overruns (``board_overruns``).
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
