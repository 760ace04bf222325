"""What the user of a rig decides about the host's side of the link."""

from __future__ import annotations

import math
from dataclasses import dataclass

from .joints import Pair


@dataclass(frozen=True, slots=True)
class HostConfig:
    """What the user decides.

    Attributes:
        sign: +1 or -1 for each joint; it turns the encoder, not the torque.
        zero: position [rad] of each joint at count 0.
        counts_per_turn: of each encoder; 0 takes it from the board's HELLO.
        torque_limit: largest torque ever sent [N m].
        watchdog_ms: after this long without a command the board switches its motor off.
        command_timeout: after this long [s] without an effort command the torque sent is 0.
        link_timeout: after this long [s] without anything valid from the board the link is lost, though not before five
            of its sample periods.
        max_speed: a sample that would need more [rad/s] is flagged.
    """

    sign: Pair = (1.0, 1.0)
    zero: Pair = (-math.pi / 2, 0.0)
    counts_per_turn: tuple[int, int] = (0, 0)
    torque_limit: float = 2.0
    watchdog_ms: int = 100
    command_timeout: float = 0.1
    link_timeout: float = 0.1
    max_speed: float = 100.0
