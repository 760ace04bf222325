# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The motor as the host sees it: arming on request, commanding while armed, and disarming at any fault."""

from __future__ import annotations

import math
from enum import Enum, auto

from pendubot_identification.level import Level

from .clock import MS, SECOND
from .events import Armed, ArmingFailed, HostConfig, Output
from .protocol import FAULTS, Hello, Mode, State, Status

ARMING_TIMEOUT = 500 * MS
#: While the board says that it is armed though it must not be, disarming is repeated this often.
DISARM_INTERVAL = 50 * MS

# As plain numbers, because a status comes a thousand times a second and IntFlag is slow.
_ARMED, _WATCHDOG, _FAULTS = int(Status.ARMED), int(Status.WATCHDOG), int(FAULTS)


class _Phase(Enum):
    DISARMED = auto()
    ARMING = auto()
    ARMED = auto()


class Motor:
    """It starts disarmed and arms only by :meth:`arm`; any fault, trip or :meth:`stop` disarms it.

    Attributes:
        board: what the board said about itself; None while it has not.
        effort_stopped: whether it is armed at torque 0 because no effort command comes.
        lost: why it is disarmed though nobody wanted that, in words; '' from the next arming on.
    """

    def __init__(self, config: HostConfig, output: Output) -> None:
        self.board: Hello | None = None
        self.effort_stopped = False
        self.lost = ''
        self._config = config
        self._timeout = round(config.command_timeout * SECOND)
        self._output = output
        self._counters = output.counters
        self._phase = _Phase.DISARMED
        self._arming_since = 0
        self._arming_seq = 0
        self._bit_was_set = False
        self._torque = 0
        self._effort_not_finite = False
        self._faults_told = 0
        self._last_effort = 0
        self._last_sent = 0
        self._last_disarm = -10 * SECOND

    @property
    def armed(self) -> bool:
        """Whether the board is armed and commanded by this host."""
        return self._phase is _Phase.ARMED

    @property
    def _watchdog_ns(self) -> int:
        """After this long without a command [ns] the board switches the motor off."""
        ms = self._config.watchdog_ms
        return MS * (min(ms, self.board.watchdog_max_ms) if self.board else ms)

    def arm(self, state: State | None, now: int) -> None:
        """Begin to arm a board that is heard; ``state`` is its last one."""
        status = state.status if state else 0
        if self.armed:
            self._output.tell(Armed())
        elif self.board is None:
            self._output.tell(ArmingFailed('the board has not said HELLO yet'))
        elif status & _FAULTS:
            self._output.tell(ArmingFailed(f'the board is in a fault: {names(status & _FAULTS)}'))
        elif self._phase is _Phase.DISARMED:
            self._phase = _Phase.ARMING
            self.lost = ''
            self._arming_since = now
            self._bit_was_set = bool(status & _ARMED)
            self._torque = 0
            self.effort_stopped = self._effort_not_finite = False
            self._command(Mode.DISARM, now)
            self._command(Mode.TORQUE, now)
            self._arming_seq = self._output.seq

    def stop(self, reason: str, now: int, wanted: bool = False) -> None:
        """Disarm; unless it was ``wanted``, losing an armed motor is reported."""
        phase, self._phase = self._phase, _Phase.DISARMED
        self._torque = 0
        self.effort_stopped = False
        if phase is _Phase.ARMING:
            self._output.tell(ArmingFailed(reason))
        elif phase is _Phase.ARMED and not wanted:
            self.lost = reason
            self._output.report(Level.WARN, f'disarmed: {reason}; arm again when it is safe')
        self._command(Mode.DISARM, now)

    def effort(self, torque: float, now: int) -> None:
        """Take a torque wanted at the shoulder [N m]; it is sent at once when armed, else discarded."""
        if not math.isfinite(torque):
            self._counters.not_finite += 1
            if not self._effort_not_finite:
                text = f'an effort command of {torque} came; only finite torques are sent: disarming'
                self._output.report(Level.ERROR, text)
            self._effort_not_finite = True
            self.stop('an effort command was not finite', now, wanted=True)
            return
        self._effort_not_finite = False
        if not self.armed or self.board is None:
            self._counters.discarded += 1
            return
        limit = min(self._config.torque_limit, self.board.torque_limit / 1e6)
        clamped = max(-limit, min(limit, torque))
        if clamped != torque:
            self._counters.clamped += 1
            if self._output.is_new('clamped', now):
                text = f'an effort command of {torque:g} N m came; at most {limit:g} N m are sent'
                self._output.report(Level.WARN, text)
        self._torque = round(clamped * 1e6)
        self._last_effort = now
        if self.effort_stopped:
            self.effort_stopped = False
            self._output.report(Level.OK, 'effort commands come again')
        self._command(Mode.TORQUE, now)

    def next_poll(self, now: int) -> int:
        """Return how soon [ns] :meth:`poll` has to be called again: at the moment when the torque has to be 0."""
        # At least as often as the timeout, because an effort command may come meanwhile, and be the last one.
        regular = max(MS, min(10 * MS, self._watchdog_ns // 8, self._timeout))
        if not self.armed or self.effort_stopped:
            return regular
        return max(0, min(regular, self._last_effort + self._timeout - now))

    def poll(self, now: int) -> None:
        """Do what is due: give arming up, send the command again, set the torque to 0 where no effort command came."""
        if self._phase is _Phase.DISARMED:
            return
        if self._phase is _Phase.ARMING and now - self._arming_since >= ARMING_TIMEOUT:
            self.stop('the board did not say within 0.5 s that it is armed', now)
        elif self.armed and not self.effort_stopped and now - self._last_effort >= self._timeout:
            self.effort_stopped = True
            self._torque = 0
            self._counters.command_timeouts += 1
            text = f'no effort command for {self._timeout / SECOND:g} s: torque 0, still armed'
            self._output.report(Level.WARN, text)
            self._command(Mode.TORQUE, now)
        elif now - self._last_sent >= self._watchdog_ns // 4:
            self._command(Mode.TORQUE, now)

    def follow(self, state: State, before: int, now: int) -> None:
        """React to a STATE's status; ``before`` is the status before it, 0 where there was none."""
        status = state.status
        risen = status & ~before
        if status & _FAULTS:
            self._report_faults(risen & _FAULTS, now)
        if risen & _WATCHDOG:
            self._counters.trips += 1
            self._output.report(Level.WARN, "the board's watchdog tripped")
        if self._phase is _Phase.DISARMED:
            if status & _ARMED and now - self._last_disarm >= DISARM_INTERVAL:
                self._command(Mode.DISARM, now)
        elif status & _FAULTS:
            self.stop(f'the board is in a fault: {names(status & _FAULTS)}', now)
        elif self._phase is _Phase.ARMED:
            if not status & _ARMED:
                self.stop('the board is no longer armed', now)
        elif status & _ARMED and (not self._bit_was_set or self._obeyed(state)):
            self._phase = _Phase.ARMED
            self._last_effort = now
            self._output.tell(Armed())

    def _report_faults(self, risen: int, now: int) -> None:
        # Some faults come and go, such as a supply that sags whenever the motor pulls.
        if self._output.is_new('fault', now):
            self._faults_told = 0
        if untold := risen & ~self._faults_told:
            self._faults_told |= untold
            self._output.report(Level.ERROR, f'the board reports a fault: {names(untold)}')

    def _obeyed(self, state: State) -> bool:
        """Tell whether the board obeyed this arming's mode 1, or a command after it."""
        return (state.cmd_seq - self._arming_seq) & 0xFFFF <= (self._output.seq - self._arming_seq) & 0xFFFF

    def _command(self, mode: Mode, now: int) -> None:
        torque = self._torque if mode is Mode.TORQUE else 0
        self._output.command(mode, torque, self._config.watchdog_ms, now)
        self._last_sent = now
        if mode is Mode.DISARM:
            # A closed port took nothing: once it is open, the disarm is repeated at once.
            self._last_disarm = now if self._output.open else now - DISARM_INTERVAL


def names(status: int) -> str:
    """Return the bits' names in words, such as ``over current, encoder 1``."""
    return ', '.join(bit.name.lower().replace('_', ' ') for bit in Status if bit & status and bit.name)
