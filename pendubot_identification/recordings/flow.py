# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Statistics of the messages of a topic: count, latency and losses."""

from collections.abc import Mapping
from dataclasses import dataclass

from pendubot_identification.level import Level

#: Latency from publishing to writing that causes a warning [s].
LATE = 1.0
#: Ratio of free space to reserve below which a warning is due.
SCARCE = 2


@dataclass
class Flow:
    """Counts the received and the lost messages of one topic.

    Gaps in the publisher's message numbers are losses. With several publishers on a topic, losses are not counted.
    """

    count: int = 0
    lost: int = 0
    _last: int | None = None
    _since: int = 0
    _lag_ns: int = 0

    def add(self, number: int | None, lag_ns: int, publishers: int = 1) -> None:
        """Count a message with its publisher's number for it, if known, and its latency [ns]."""
        self.count += 1
        self._since += 1
        self._lag_ns = max(self._lag_ns, lag_ns)
        if number is not None and self._last is not None and publishers == 1:
            # The number falls when the publisher restarts.
            self.lost += max(number - self._last - 1, 0)
        self._last = number if publishers == 1 else None

    def pause(self) -> None:
        """Do not count messages before the next one as lost."""
        self._last = None

    def report(self, elapsed: float) -> tuple[float, float]:
        """Return rate [Hz] and largest lag [s] since the last report, ``elapsed`` seconds ago."""
        result = self._since / elapsed, self._lag_ns / 1e9
        self._since = self._lag_ns = 0
        return result


def diagnose(
    flows: Mapping[str, Flow], elapsed: float, *, troubles: tuple[str, ...], free: int, reserve: int
) -> tuple[Level, str, dict[str, str]]:
    """Return level, sentences and values of a recording, ``elapsed`` seconds after the last call.

    ``troubles`` are further warnings. ``free`` is the free disk space [bytes]; the recording ends when it falls to
    ``reserve`` [bytes].
    """
    warnings: dict[str, bool] = {}  # condition by sentence
    values: dict[str, str] = {}
    for topic, flow in flows.items():
        rate, lag = flow.report(elapsed)
        shown = {'messages': flow.count, 'rate [Hz]': f'{rate:.1f}', 'lag [s]': f'{lag:.4f}', 'lost': flow.lost}
        values |= {f'{topic} {name}': str(value) for name, value in shown.items()}
        warnings |= {
            f'{topic}: {flow.lost} messages lost': flow.lost > 0,
            f'{topic}: written {lag:.1f} s late': lag > LATE,
            f'{topic}: nothing yet': not flow.count,
        }
    scarce = f'{free / 1e6:.0f} MB left on the disk; the bag is closed at {reserve / 1e6:.0f}'
    warnings |= {scarce: free < SCARCE * reserve, **dict.fromkeys(troubles, True)}
    values |= {'free [MB]': f'{free / 1e6:.1f}', 'reserve [MB]': f'{reserve / 1e6:.1f}'}
    message = '; '.join(sentence for sentence, holds in warnings.items() if holds)
    return Level.WARN if message else Level.OK, message or 'recording', values
