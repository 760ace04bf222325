# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The host's state machine of the motor: arm on request, command while armed, disarm at any contradiction.

The host owns the motor from the first STATE that confirms its ARM until the first disarming. In every STATE it compares
the executed command and the applied torque with its own commands.
"""

import math
from collections import OrderedDict
from collections.abc import Callable
from itertools import count

from pendubot_identification.level import Level

from .clock import MS, SECOND
from .events import ArmingEnded, HostConfig, Output
from .protocol import BITS, FAULTS, Arm, Command, Hello, Mode, State, Status

ARMING_TIMEOUT = 500 * MS
#: Repetition interval of requests to arm and to disarm, until the board has executed them [ns].
REPEAT_INTERVAL = 50 * MS
#: The report while the board does not execute the request to disarm.
UNCONFIRMED = 'the board does not confirm that it is disarmed: press the emergency stop, then check its wiring'
#: The previous STATE of the first STATE.
_NO_STATE = State(0, 0, 0, 0, 0, 0, 0, 0, 0)
#: The sequence numbers of frames wrap at this value; half of them tell old frames from new ones.
_SEQS = 1 << 16


class Motor:
    """The motor of one board: :meth:`arm` arms it; any fault, trip, contradiction or :meth:`stop` disarms it.

    Args:
        new_session: returns a number from 1 to 2^32 - 1 that no other host uses; called for every arming.

    Attributes:
        armed: whether the board is armed and commanded by this host.
        board: the board's HELLO; None before the first.
        effort_stopped: whether the motor is armed at torque 0 because no effort command arrives.
        torque_limit: largest torque that is sent [N m].
        lost: reason of the last unrequested disarming, in words; '' from the next arming on.
        disarming: whether no STATE has confirmed the last request to disarm yet.
        disobeyed: whether the board does not confirm it in time.
    """

    def __init__(self, config: HostConfig, output: Output, new_session: Callable[[], int] | None = None) -> None:
        self.armed = self.effort_stopped = False
        self.lost = ''
        self._config = config
        self._timeout = round(config.command_timeout * SECOND)
        self.torque_limit = config.torque_limit
        self._output = output
        self._counters = output.counters
        self._new_session = new_session or count(1).__next__
        self._session = 0
        self._arming_since: int | None = None
        self.disarming = False
        #: Torques [micro-N m] by sequence number, of this host's COMMANDs and ARMs from the last disarming on.
        self._sent: OrderedDict[int, int] = OrderedDict()
        self._disarms: set[int] = set()  # sequence numbers of the COMMANDs before this arming
        self._last_foreign = -SECOND
        self._torque = 0
        self._last_effort = 0
        self._last_sent = 0
        self.restarted()

    def contested(self, now: int) -> bool:
        """Return whether another program sent commands to the board in the last second."""
        return now - self._last_foreign < SECOND

    @property
    def watchdog_ns(self) -> int:
        """Time without a command [ns] after which the board switches the motor off."""
        ms = self._config.watchdog_ms
        return MS * (min(ms, self.board.watchdog_max_ms) if self.board else ms)

    def restarted(self) -> None:
        """Handle a restart of the board: it is disarmed, without a session."""
        self.board: Hello | None = None
        self.disobeyed = False
        self._lock: int | None = None  # lock number in the last ARM, until a STATE confirms a mode 0
        self._before = _NO_STATE  # the last STATE
        self._refused: int | None = None

    def arm(self, state: State, now: int) -> None:
        """Start arming a connected board; ``state`` is its last STATE."""
        if self.armed:
            self._output.emit(ArmingEnded())
        elif self._arming_since is None:
            self.lost = ''
            self._session = self._new_session()
            self._arming_since = now
            self._torque = 0
            self.effort_stopped = False
            self._go_on_arming(state, now)

    def stop(self, reason: str, now: int, wanted: bool = False) -> None:
        """Disarm, and report it if the motor was armed and the disarming is not ``wanted``."""
        was_armed, arming_since = self.armed, self._arming_since
        self.armed = self.effort_stopped = False
        self._arming_since, self._torque = None, 0
        if arming_since is not None:
            self._output.emit(ArmingEnded(reason))
        elif was_armed and not wanted:
            self.lost = reason
            self._output.report(Level.WARN, f'disarmed: {reason}; arm again when it is safe')
        if not self.disarming:
            self.disarming = True
            self._sent.clear()
        self._command(Mode.DISARM, now)

    def disarm(self, now: int) -> None:
        """Disarm the board in any state."""
        self.stop('disarmed on request', now, wanted=True)

    def effort(self, torque: float, now: int) -> None:
        """Send an effort command for the shoulder [N m] at once if armed, else discard it."""
        if not math.isfinite(torque):
            self._counters.not_finite += 1
            text = f'an effort command is {torque}; only finite torques are sent'
            self._output.report_new('not finite', now, Level.ERROR, text)
            # Only once: repeated requests would look like requests that the board ignores.
            if self.armed or self._arming_since is not None:
                self.stop('an effort command was not finite', now)
            return
        if not self.armed or self.board is None:
            self._counters.discarded += 1
            return
        limit = min(self.torque_limit, self.board.torque_limit / 1e6)
        clamped = max(-limit, min(limit, torque))
        if clamped != torque:
            self._counters.clamped += 1
            text = f'an effort command is {torque:g} N m; at most {limit:g} N m are sent'
            self._output.report_new('clamped', now, Level.WARN, text)
        self._torque = round(clamped * 1e6)
        self._last_effort = now
        if self.effort_stopped:
            self.effort_stopped = False
            self._output.report(Level.OK, 'effort commands arrive again')
        self._command(Mode.TORQUE, now)

    def set_torque_limit(self, limit: float, now: int) -> None:
        """Set the largest torque that is sent [N m] and clamp the present torque; a limit is not raised while armed."""
        self.torque_limit = min(limit, self.torque_limit) if self.armed else limit
        largest = round(self.torque_limit * 1e6)
        if abs(self._torque) > largest:
            self._torque = max(-largest, min(largest, self._torque))
            self._command(Mode.TORQUE, now)

    def next_poll(self, now: int) -> int:
        """Return the time [ns] until the next call of :meth:`.Host.poll`, not after the timeout of effort commands."""
        # At least once per timeout, because the last effort command may arrive in the meantime.
        regular = max(MS, min(10 * MS, self.watchdog_ns // 8, self._timeout))
        if not self.armed or self.effort_stopped:
            return regular
        return max(0, min(regular, self._last_effort + self._timeout - now))

    def poll(self, now: int) -> None:
        """Repeat due requests and commands, time out the arming, and command 0 after the last effort command."""
        if self._output.open and now - self._last_sent >= REPEAT_INTERVAL:
            if self.disarming:
                self._command(Mode.DISARM, now)
            elif self._arming_since is not None and self._lock is not None:
                self._request(self._lock, now)
        if self._arming_since is not None and now - self._arming_since >= ARMING_TIMEOUT:
            self.stop('the board did not confirm the arming within 0.5 s', now)
        elif not self.armed:
            return
        elif not self.effort_stopped and now - self._last_effort >= self._timeout:
            self.effort_stopped = True
            self._torque = 0
            self._counters.command_timeouts += 1
            text = f'no effort command for {self._timeout / SECOND:g} s: torque 0, still armed'
            self._output.report(Level.WARN, text)
            self._command(Mode.TORQUE, now)
        elif now - self._last_sent >= self.watchdog_ns // 4:
            self._command(Mode.TORQUE, now)

    def follow(self, state: State, now: int) -> None:
        """Compare a STATE with the sent commands and with the previous STATE."""
        status = state.status
        if risen := status & ~self._before.status:
            self._report_faults(risen & FAULTS, now)
        self._counters.trips += bool(risen & Status.WATCHDOG)
        self._count_refused(state, now)
        if self._arming_since is not None:
            self._go_on_arming(state, now)
        elif not self.armed:
            self._follow_disarmed(state, risen, now)
        elif reason := self._contradiction(state):
            if not status & (FAULTS | Status.WATCHDOG):
                self._output.report(Level.ERROR, reason)
            self.stop(reason, now)
        self._before = state

    def _follow_disarmed(self, state: State, risen: int, now: int) -> None:
        on, was_on = (bool(s.status & Status.ARMED or s.torque) for s in (state, self._before))
        # Switched on without an ARM of this host, or on although it was disarmed.
        foreign = on and (not self.disarming or not (was_on or state.lock == self._lock))
        if foreign:
            self.lost = 'another program armed the motor, or a bridge that was killed'
            text = f'the board applies {state.torque / 1e6:g} N m, armed by another program; disarming it'
            self._output.report_new('armed by another', now, Level.ERROR, f'{text}: end that program')
            self.stop(self.lost, now)
        elif not self.disarming:
            if risen & FAULTS:
                self.stop('a fault', now)  # a mode 0 clears a fault that is over
        elif not on and state.cmd_seq in self._sent:
            self.disarming, self.disobeyed, self._lock = False, False, None
        elif on and len(self._sent) > ARMING_TIMEOUT // REPEAT_INTERVAL and not self.disobeyed:
            self.disobeyed = True
            self._output.report(Level.ERROR, UNCONFIRMED)

    def _go_on_arming(self, state: State, now: int) -> None:
        """Request the arming after the board has executed the last mode 0; detect its success or failure."""
        if self.disarming:
            self._follow_disarmed(state, 0, now)
        if self.disarming:
            return
        status = state.status
        if status & FAULTS:
            self.stop(f'the board is in a fault: {names(status & FAULTS)}', now)
        elif status & Status.ARMED and state.cmd_seq in self._sent and state.lock == self._lock:
            self.armed, self._arming_since = True, None
            self._last_effort = now
            self._output.emit(ArmingEnded())
        elif self._lock is None:
            self._disarms = {*self._sent}
            self._request(state.lock, now)
        elif status & Status.ARMED or (state.lock != self._lock and state.cmd_seq not in self._disarms):
            self.stop(self._contradiction(state), now)
        elif state.lock != self._lock:  # a repeated mode 0 of this host arrived late
            self._request(state.lock, now)

    def _contradiction(self, state: State) -> str:
        """Return the reason why this STATE after an ARM disarms; empty if the STATE is as expected."""
        status = state.status
        if status & FAULTS:
            return f'the board is in a fault: {names(status & FAULTS)}'
        if status & Status.WATCHDOG:
            return "the board's watchdog tripped"
        own = state.cmd_seq in self._sent
        if not status & Status.ARMED:
            return 'the board is no longer armed' if own else 'another program disarmed the board'
        if not own or state.lock != self._lock:
            return (
                f'the board executes frame {state.cmd_seq}, which this host did not send; another program commands it'
            )
        low, high = self._expected(state)
        if not low <= state.torque <= high:
            applied, commanded = state.torque / 1e6, self._sent[state.cmd_seq] / 1e6
            return f'the board applies {applied:g} N m instead of the commanded {commanded:g} N m; check its firmware'
        return ''

    def _expected(self, state: State) -> tuple[int, int]:
        """Return the smallest and the largest torque [micro-N m] of a board that executes this frame."""
        wanted = self._sent[state.cmd_seq]
        if state.status & Status.SATURATED and self.board is not None:
            limit = self.board.torque_limit
            wanted = max(-limit, min(limit, wanted))
        if not state.status & Status.SLEW:
            return wanted, wanted
        # The slewing torque lies among the previous torque, the command at that time (the torque went on towards it in
        # lost STATEs), and the commands since then.
        before = self._before
        steps = (state.cmd_seq - before.cmd_seq) % _SEQS if before.cmd_seq in self._sent else 0
        since = (self._sent.get((state.cmd_seq - k) % _SEQS, wanted) for k in range(1, min(steps, 1000) + 1))
        passed = [wanted, before.torque, *since]
        return min(passed), max(passed)

    def _count_refused(self, state: State, now: int) -> None:
        """Count and report the requests of other programs that the board refused."""
        more = 0 if self._refused is None else (state.refused - self._refused) % _SEQS
        self._refused = state.refused
        # Until a STATE confirms an arming or a mode 0, an earlier request of this host may be among them.
        if more and (self.armed or (self._arming_since is None and not self.disarming)):
            self._counters.foreign_requests += more
            self._last_foreign = now
            text = 'another program sends commands to the board, which refuses them; end that program'
            self._output.report_new('foreign', now, Level.WARN, text)

    def _report_faults(self, risen: int, now: int) -> None:
        # Some faults are intermittent, such as a supply that sags under the motor's load.
        if new := sum(bit for name, bit in BITS.items() if bit & risen and self._output.is_new(name, now)):
            self._output.report(Level.ERROR, f'the board reports a fault: {names(new)}')

    def _request(self, lock: int, now: int) -> None:
        if self.board is not None:
            self._lock = lock
            self._send(Arm, now, 0, boot_id=self.board.boot_id, lock=lock)

    def _command(self, mode: Mode, now: int) -> None:
        torque = self._torque if mode is Mode.TORQUE else 0
        self._send(Command, now, torque, mode=mode, torque=torque)

    def _send(self, message: type[Command | Arm], now: int, wanted: int, **fields: int) -> None:
        """Send a message after which the board wants this torque [micro-N m]."""
        self._output.send(message, now, session=self._session, watchdog_ms=self._config.watchdog_ms, **fields)
        self._sent[self._output.seq] = wanted
        if len(self._sent) > _SEQS // 2:
            self._sent.popitem(last=False)
        # A closed port took nothing: once it is open, the request to disarm is repeated at once.
        self._last_sent = now if self._output.open else now - REPEAT_INTERVAL


def names(status: int) -> str:
    """Return the bits' names in words, such as ``over current, encoder 1``."""
    return ', '.join(name.lower().replace('_', ' ') for name, bit in BITS.items() if bit & status)
