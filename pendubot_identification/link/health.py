"""How the link to the board is doing, second by second, for whoever has to know."""

from __future__ import annotations

from dataclasses import asdict, dataclass

from pendubot_identification.level import Level

from .host import Host
from .motor import SECOND
from .news import Report
from .protocol import Status

#: While one of these grows something is wrong, even if all seems well at the moment.
WORRYING = (
    'lost',
    'duplicates',
    'out_of_order',
    'damaged',
    'flagged',
    'clamped',
    'not_finite',
    'board_damaged',
    'board_overruns',
)


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """A level, a sentence or several, and by name every figure as text."""

    level: Level
    message: str
    values: dict[str, str]


class Health:
    """Sums up, from one :meth:`diagnose` to the next, what was reported and what the counters say."""

    def __init__(self) -> None:
        self._reports: list[Report] = []
        self._before: dict[str, int] = {}
        self._since: int | None = None

    def note(self, report: Report) -> None:
        """Keep a report for the next diagnosis; good news is none."""
        if report.level is not Level.OK:
            self._reports.append(report)

    def diagnose(self, host: Host, now: int) -> Diagnosis:
        """Return how things stand at ``now`` [ns], and what happened since the last time."""
        counters = asdict(host.counters())
        reasons = counters.pop('damaged')
        counters['damaged'] = sum(reasons.values())
        grown = {name: counters[name] - self._before.get(name, 0) for name in counters}
        elapsed = 1.0 if self._since is None else (now - self._since) / SECOND
        reports, self._reports = [host.condition(), *self._reports], []
        self._before, self._since = counters, now

        worries = [f'{name.replace("_", " ")}: {grown[name]} more' for name in WORRYING if grown[name] > 0]
        level = max([r.level for r in reports] + [Level.WARN] * bool(worries))
        # The condition that stands is often the one that was just reported: not to be said twice.
        message = '; '.join(dict.fromkeys([*(r.text for r in reports), *worries]))
        values: dict[str, object] = {
            'link': host.link,
            'armed': host.armed,
            'rate [Hz]': f'{grown["published"] / elapsed:.1f}',
            'received [Hz]': f'{grown["received"] / elapsed:.1f}',
            'sent [Hz]': f'{grown["sent"] / elapsed:.1f}',
            'age of the last sample [s]': f'{host.age(now):.3f}',
            'clock skew [ppm]': f'{host.clock.skew_ppm:.2f}',
            **counters,
            'damaged by reason': ', '.join(f'{name} {count}' for name, count in sorted(reasons.items())),
        }
        if host.state is not None:
            values['status'] = Status(host.state.status).value
            values['current [mA]'] = host.state.current
            values['supply [V]'] = host.state.vbus / 100
        if host.hello is not None:
            values['boot_id'] = host.hello.boot_id
            values['firmware'] = host.hello.firmware
            values['torque limit [N m]'] = min(host.config.torque_limit, host.hello.torque_limit / 1e6)
        return Diagnosis(level, message, {name: str(value) for name, value in values.items()})
