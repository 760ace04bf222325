# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The diagnosis of the link to the board on ``/diagnostics``, from the host's reports and counters."""

from dataclasses import asdict

from pendubot_identification.level import Level

from .clock import SECOND
from .events import Report
from .host import Host

#: Counters that grow only in case of a fault.
WORRYING = ['lost', 'duplicates', 'out_of_order', 'damaged', 'flagged', 'irregular_stamps', 'late_samples']
WORRYING += ['clamped', 'not_finite', 'board_damaged', 'board_overruns', 'foreign_requests']


class Health:
    """Collects reports and compares counters, from one :meth:`diagnose` to the next."""

    def __init__(self) -> None:
        self._reports: list[Report] = []
        self._before: dict[str, int] = {}
        self._since: int | None = None

    def note(self, report: Report) -> None:
        """Keep a report for the next diagnosis, unless its level is OK."""
        if report.level is not Level.OK:
            self._reports.append(report)

    def diagnose(self, host: Host, now: int) -> tuple[Level, str, dict[str, str]]:
        """Return level, sentences and values of the link at ``now`` [ns], and of the events since the last call."""
        counters = asdict(host.counters)
        reasons = counters.pop('damaged')
        counters['damaged'] = sum(reasons.values())
        grown = {name: counters[name] - self._before.get(name, 0) for name in counters}
        elapsed = 1.0 if self._since is None else (now - self._since) / SECOND
        reports, self._reports = [host.condition(now), *self._reports], []
        self._before, self._since = counters, now

        worries = [f'{name.replace("_", " ")}: {grown[name]} more' for name in WORRYING if grown[name] > 0]
        level = max([r.level for r in reports] + [Level.WARN] * bool(worries))
        # Without repetition: the present condition was often just reported.
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
            values['status'] = host.state.status
            values['current [A]'] = host.state.current / 1000
            values['supply [V]'] = host.state.vbus / 100
        if (hello := host.hello) is not None:
            values['boot_id'] = hello.boot_id
            values['firmware'] = f'{hello.firmware} {hello.build:08x}' if hello.build else hello.firmware
            values['reset cause'] = hello.reset_cause
            if hello.fault_cause:
                values['last processor fault'] = f'exception {hello.fault_cause} at 0x{hello.fault_pc:08x}'
            values['sample period [s]'] = hello.sample_period_us / 1e6
            values['torque limit [N m]'] = min(host.motor.torque_limit, hello.torque_limit / 1e6)
            if hello.torque_constant:
                values['torque constant [N m/A]'] = hello.torque_constant / 1e6
            # Names and units are those in the protocol and in the firmware's rig.h.
            values |= hello.limits._asdict()
        return level, message, {name: str(value) for name, value in values.items()}
