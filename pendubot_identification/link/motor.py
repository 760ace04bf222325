"""The motor as the host sees it: arming on request, commanding while armed, and disarming at any fault."""

from __future__ import annotations

import math
from enum import Enum, auto

from pendubot_identification.level import Level

from .host_config import HostConfig
from .news import Armed, ArmingFailed, News
from .protocol import FAULTS, Hello, Mode, State, Status
from .transmitter import Transmitter

MS = 1_000_000
SECOND = 1_000 * MS

ARMING_TIMEOUT = 500 * MS
#: A disarm is repeated this often while the board still says that it is armed.
DISARM_INTERVAL = 50 * MS

# As plain numbers: a status is looked at a thousand times a second, and an IntFlag takes its time.
_ARMED, _WATCHDOG, _FAULTS = int(Status.ARMED), int(Status.WATCHDOG), int(FAULTS)


class _Phase(Enum):
    DISARMED = auto()
    ARMING = auto()
    ARMED = auto()


class Motor:
    """It starts disarmed and arms only by :meth:`arm`; any fault, trip or :meth:`stop` disarms it.

    Args:
        config: limits and timeouts.
        transmitter: where commands go.
        news: where outcomes and reports go.

    Attributes:
        board: what the board said about itself; None while it has not.
        effort_stopped: whether it is armed at torque 0 because no effort command comes.
        trips: of the board's watchdog.
        discarded, clamped, not_finite, command_timeouts: effort commands, as in :class:`~.news.Counters`.
    """

    def __init__(self, config: HostConfig, transmitter: Transmitter, news: News) -> None:
        self.board: Hello | None = None
        self.effort_stopped = False
        self.trips = 0
        self.discarded = 0
        self.clamped = 0
        self.not_finite = 0
        self.command_timeouts = 0
        self._config = config
        self._timeout = round(config.command_timeout * SECOND)
        self._transmitter = transmitter
        self._news = news
        self._phase = _Phase.DISARMED
        self._arming_since = 0
        self._arming_seq = 0
        self._bit_was_set = False
        self._torque = 0
        self._effort_not_finite = False
        self._last_disarm = -10 * SECOND
        self._last_fault = -10 * SECOND
        self._faults_told = 0
        self._last_effort = 0
        self._last_clamp = -10 * SECOND
        self._last_sent = 0

    @property
    def armed(self) -> bool:
        """Whether the board is armed and commanded by this host."""
        return self._phase is _Phase.ARMED

    @property
    def watchdog_ns(self) -> int:
        """After this long without a command [ns] the board switches the motor off."""
        limit = self.board.watchdog_max_ms if self.board else self._config.watchdog_ms
        return min(self._config.watchdog_ms, limit) * MS

    def arm(self, state: State | None, now: int) -> None:
        """Begin to arm a board that is heard; ``state`` is its last."""
        status = state.status if state else 0
        if self.armed:
            self._news.tell(Armed())
        elif self.board is None:
            self._news.tell(ArmingFailed('the board has not said HELLO yet'))
        elif status & _FAULTS:
            self._news.tell(ArmingFailed(f'the board is in a fault: {names(status & _FAULTS)}'))
        elif self._phase is _Phase.DISARMED:
            self._phase = _Phase.ARMING
            self._arming_since = now
            self._bit_was_set = bool(status & _ARMED)
            self._torque = 0
            self.effort_stopped = self._effort_not_finite = False
            self._command(Mode.DISARM, now)
            self._command(Mode.TORQUE, now)
            self._arming_seq = self._transmitter.seq

    def stop(self, reason: str, now: int, wanted: bool = False) -> None:
        """Disarm; unless it was ``wanted``, losing an armed motor is reported."""
        phase, self._phase = self._phase, _Phase.DISARMED
        self._torque = 0
        self.effort_stopped = False
        if phase is _Phase.ARMING:
            self._news.tell(ArmingFailed(reason))
        elif phase is _Phase.ARMED and not wanted:
            self._news.report(Level.WARN, f'disarmed: {reason}; arm again when it is safe')
        self._command(Mode.DISARM, now)

    def effort(self, torque: float, now: int) -> None:
        """Take a torque wanted at the shoulder [N m]; it is sent at once when armed, else discarded."""
        if not math.isfinite(torque):
            self.not_finite += 1
            if not self._effort_not_finite:
                self._effort_not_finite = True
                self._news.report(
                    Level.ERROR, f'an effort command of {torque} came; only finite torques are sent: disarming'
                )
            self.stop('an effort command was not finite', now, wanted=True)
            return
        self._effort_not_finite = False
        if not self.armed or self.board is None:
            self.discarded += 1
            return
        limit = min(self._config.torque_limit, self.board.torque_limit / 1e6)
        clamped = max(-limit, min(limit, torque))
        if clamped != torque:
            self.clamped += 1
            # A controller that stays at the limit, or comes back to it at once, is one occurrence.
            if now - self._last_clamp > SECOND:
                self._news.report(
                    Level.WARN, f'an effort command of {torque:g} N m came; at most {limit:g} N m are sent'
                )
            self._last_clamp = now
        self._torque = round(clamped * 1e6)
        self._last_effort = now
        if self.effort_stopped:
            self.effort_stopped = False
            self._news.report(Level.OK, 'effort commands come again')
        self._command(Mode.TORQUE, now)

    def next_poll(self, now: int) -> int:
        """Return how soon [ns] :meth:`poll` has to be called again: at the moment when the torque has to be 0."""
        # An effort command may come, and stop, within this time: not longer than the time it is good for.
        regular = max(MS, min(10 * MS, self.watchdog_ns // 8, self._timeout))
        if not self.armed or self.effort_stopped:
            return regular
        return max(0, min(regular, self._last_effort + self._timeout - now))

    def poll(self, now: int) -> None:
        """Do what time alone brings: give arming up, refresh the command, take the torque back."""
        if self._phase is _Phase.DISARMED:
            return
        if self._phase is _Phase.ARMING and now - self._arming_since >= ARMING_TIMEOUT:
            self.stop('the board did not say within 0.5 s that it is armed', now)
        elif self.armed and not self.effort_stopped and now - self._last_effort >= self._timeout:
            self.effort_stopped = True
            self._torque = 0
            self.command_timeouts += 1
            self._news.report(
                Level.WARN, f'no effort command for {self._config.command_timeout:g} s: torque 0, still armed'
            )
            self._command(Mode.TORQUE, now)
        elif now - self._last_sent >= self.watchdog_ns // 4:
            self._command(Mode.TORQUE, now)

    def follow(self, state: State, before: int, now: int) -> None:
        """Take a STATE's status; ``before`` is the one before it, 0 where there was none."""
        status = state.status
        risen = status & ~before
        if status & _FAULTS:
            self._report_faults(risen & _FAULTS, now)
        if risen & _WATCHDOG:
            self.trips += 1
            self._news.report(Level.WARN, "the board's watchdog tripped")
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
            self._news.tell(Armed())

    def _report_faults(self, risen: int, now: int) -> None:
        # One that chatters, such as a supply that sags whenever the motor pulls, is one occurrence.
        if now - self._last_fault > SECOND:
            self._faults_told = 0
        self._last_fault = now
        if news := risen & ~self._faults_told:
            self._faults_told |= news
            self._news.report(Level.ERROR, f'the board reports a fault: {names(news)}')

    def _obeyed(self, state: State) -> bool:
        """Tell whether the board obeyed this arming's mode 1, or a command after it."""
        return (state.cmd_seq - self._arming_seq) & 0xFFFF <= (self._transmitter.seq - self._arming_seq) & 0xFFFF

    def _command(self, mode: Mode, now: int) -> None:
        torque = self._torque if mode is Mode.TORQUE else 0
        self._transmitter.command(mode, torque, self._config.watchdog_ms, now)
        self._last_sent = now
        if mode is Mode.DISARM:
            # What a closed port did not take has to be said as soon as it is open.
            self._last_disarm = now if self._transmitter.open else now - DISARM_INTERVAL


def names(status: int) -> str:
    """Return the bits' names in words, such as ``over current, encoder 1``."""
    return ', '.join(bit.name.lower().replace('_', ' ') for bit in Status if bit & status and bit.name)
