"""When what was recorded is due: the recording's time against another clock, at any rate, with pauses."""

from __future__ import annotations

import math

SECOND = 1_000_000_000


class Pace:
    """The time of a recording [ns], which goes ``rate`` times as fast as the clock that is told to it [ns].

    Args:
        position: where it stands.
        rate: above 0.
        now: the clock.
    """

    def __init__(self, position: int, rate: float, now: int) -> None:
        self._position = position
        self._rate = rate
        self._since = now
        self.paused = False

    def position(self, now: int) -> int:
        """Return where the recording stands."""
        return self._position if self.paused else self._position + round((now - self._since) * self._rate)

    def wait(self, until: int, now: int) -> float:
        """Return for how long a position is not due yet [s]: 0 when it is, infinite while paused."""
        if self.paused:
            return math.inf
        return max(0.0, (until - self.position(now)) / self._rate / SECOND)

    def set_rate(self, rate: float, now: int) -> None:
        """Go on at another rate."""
        self.jump(self.position(now), now)
        self._rate = rate

    def pause(self, paused: bool, now: int) -> None:
        """Stand still, or go on."""
        self.jump(self.position(now), now)
        self.paused = paused

    def jump(self, position: int, now: int) -> None:
        """Go on from another position."""
        self._position, self._since = position, now
