# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""How messages come in on a topic: how many, how late, and which never came."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from pendubot_identification.level import Diagnosis, Level

#: A message that is written so much later than it was published is worth a warning [s].
LATE = 1.0

#: A warning is due when the room left is this many reserves.
SCARCE = 2


@dataclass
class Flow:
    """One topic's messages: how many came, and how many were published in between and never came.

    A publisher numbers its messages from 1 on. Whose number it is nobody says, so that with several publishers each
    number is counted for the one whose last number is just below.
    """

    count: int = 0
    lost: int = 0
    _last: list[int] = field(default_factory=list)
    _since: int = 0
    _lag_ns: int = 0

    def heard(self, number: int | None, lag_ns: int, publishers: int = 1) -> None:
        """Take in a message: its publisher's number for it, if there is one, and how late it came [ns]."""
        self.count += 1
        self._since += 1
        self._lag_ns = max(self._lag_ns, lag_ns)
        if number is None:
            return
        below = [k for k, last in enumerate(self._last) if last < number]
        nearest = max(below, key=lambda k: self._last[k], default=None)
        if nearest is not None and (self._last[nearest] == number - 1 or len(self._last) >= publishers):
            self.lost += number - self._last[nearest] - 1
            self._last[nearest] = number
        elif len(self._last) < publishers:
            self._last.append(number)
        else:
            # One of them began anew.
            self._last[self._last.index(max(self._last))] = number

    def report(self, elapsed: float) -> tuple[float, float]:
        """Return rate [Hz] and largest lag [s] since the last report, ``elapsed`` seconds ago."""
        result = self._since / elapsed, self._lag_ns / 1e9
        self._since = self._lag_ns = 0
        return result


def diagnose(
    flows: Mapping[str, Flow], elapsed: float, *, troubles: tuple[str, ...], free: int, reserve: int
) -> Diagnosis:
    """Return how a recording is doing, ``elapsed`` seconds after the last time; ``troubles`` are worth a warning, too.

    ``free`` is the room left on the disk, ``reserve`` that at which the recording ends [bytes].
    """
    worries: list[str] = []
    values: dict[str, str] = {}
    for topic, flow in flows.items():
        rate, lag = flow.report(elapsed)
        values |= {
            f'{topic} messages': str(flow.count),
            f'{topic} rate [Hz]': f'{rate:.1f}',
            f'{topic} lag [s]': f'{lag:.4f}',
            f'{topic} lost': str(flow.lost),
        }
        if flow.lost:
            worries.append(f'{topic}: {flow.lost} messages lost')
        if lag > LATE:
            worries.append(f'{topic}: written {lag:.1f} s late')
        if not flow.count:
            worries.append(f'{topic}: nothing yet')
    if free < SCARCE * reserve:
        worries.append(f'{free / 1e6:.0f} MB left on the disk; the bag is closed at {reserve / 1e6:.0f}')
    worries += troubles
    values |= {'free [MB]': f'{free / 1e6:.1f}', 'reserve [MB]': f'{reserve / 1e6:.1f}'}
    return Diagnosis(Level.WARN if worries else Level.OK, '; '.join(worries) or 'recording', values)
