# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The motor as the host sees it: arming on request, commanding while armed, and disarming at anything unexpected.

The host owns the motor from the STATE that shows its ARM obeyed until the first disarming. In every STATE it compares
what the board obeyed and applied with what it sent itself.
"""

import math
from array import array
from collections.abc import Callable
from itertools import count

from pendubot_identification.level import Level

from .clock import MS, SECOND
from .events import ArmingEnded, HostConfig, Output
from .protocol import BITS, FAULTS, Arm, Command, Hello, Mode, State, Status

ARMING_TIMEOUT = 500 * MS
#: Requests to arm and to disarm are repeated this often until the board has obeyed them.
REPEAT_INTERVAL = 50 * MS
#: So long after its last command a request that the board refuses may be this host's own, of an ended session.
IN_FLIGHT = 200 * MS
#: What is reported while the board goes on without obeying the request to disarm.
DISOBEYED = 'the board does not obey the request to disarm: press the emergency stop, then look at its wiring'
#: In the place of a STATE before the first.
_NO_STATE = State(0, 0, 0, 0, 0, 0, 0, 0, 0)
#: The numbers of frames wrap here.
_SEQS = 1 << 16


class Motor:
    """It starts disarmed and arms only by :meth:`arm`; any fault, trip, contradiction or :meth:`stop` disarms it.

    Args:
        new_session: returns a number from 1 to 2^32 - 1 that no other host uses; it is called for every arming.

    Attributes:
        armed: whether the board is armed and commanded by this host.
        board: what the board said about itself; None while it has not.
        effort_stopped: whether it is armed at torque 0 because no effort command comes.
        torque_limit: the largest torque ever sent [N m].
        lost: why it is disarmed though nobody wanted that, in words; '' from the next arming on.
        disobeyed: whether the board goes on without obeying the request to disarm.
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
        self._lock: int | None = None  # what the ARM under way carries
        self._frames_before = 0  # the last disarming; what was sent since is this host's own
        self._arm_seq = 0  # number of the first ARM of this arming
        self._sent = array('i', bytes(4 * _SEQS))  # torques [micro-N m] by the numbers of their frames
        self._last_foreign = -SECOND
        self._torque = 0
        self._last_effort = 0
        self._last_sent = 0
        self._last_torque_sent = -SECOND
        self.restarted()

    def contested(self, now: int) -> bool:
        """Return whether another program sent commands to the board in the last second."""
        return now - self._last_foreign < SECOND

    @property
    def watchdog_ns(self) -> int:
        """After this long without a command [ns] the board switches the motor off."""
        ms = self._config.watchdog_ms
        return MS * (min(ms, self.board.watchdog_max_ms) if self.board else ms)

    def restarted(self) -> None:
        """Note that the board restarted: it is disarmed, and knows of no session."""
        self.board: Hello | None = None
        self.disobeyed = False
        self._disarming_since: int | None = None  # until a STATE shows a mode 0 obeyed
        self._before = _NO_STATE  # the last STATE
        self._refused: int | None = None

    def arm(self, state: State, now: int) -> None:
        """Begin to arm a board that is heard; ``state`` is its last one."""
        if self.armed:
            self._output.emit(ArmingEnded())
        elif self._arming_since is None:
            self.lost = ''
            self._session = self._new_session()
            self._arming_since = now
            self._lock = None
            self._torque = 0
            self.effort_stopped = False
            self._go_on_arming(state, now)

    def stop(self, reason: str, now: int, wanted: bool = False) -> None:
        """Disarm; unless it was ``wanted``, losing an armed motor is reported."""
        was_armed, arming_since = self.armed, self._arming_since
        self.armed = self.effort_stopped = False
        self._arming_since, self._torque = None, 0
        if arming_since is not None:
            self._output.emit(ArmingEnded(reason))
        elif was_armed and not wanted:
            self.lost = reason
            self._output.report(Level.WARN, f'disarmed: {reason}; arm again when it is safe')
        if self._disarming_since is None:
            self._disarming_since = now
            self._frames_before = self._output.frames
        self._send(Mode.DISARM, now)

    def disarm(self, now: int) -> None:
        """Disarm the board, whatever it is doing."""
        self.stop('disarmed on request', now, wanted=True)

    def effort(self, torque: float, now: int) -> None:
        """Take a torque wanted at the shoulder [N m]; it is sent at once when armed, else discarded."""
        if not math.isfinite(torque):
            self._counters.not_finite += 1
            if self._output.is_new('not finite', now):
                text = f'an effort command of {torque} came; only finite torques are sent: disarming'
                self._output.report(Level.ERROR, text)
            self.stop('an effort command was not finite', now, wanted=True)
            return
        if not self.armed or self.board is None:
            self._counters.discarded += 1
            return
        limit = min(self.torque_limit, self.board.torque_limit / 1e6)
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
        self._send(Mode.TORQUE, now)

    def set_torque_limit(self, limit: float, now: int) -> None:
        """Change the largest torque ever sent [N m], which is not raised while armed; lower a torque beyond it."""
        self.torque_limit = min(limit, self.torque_limit) if self.armed else limit
        largest = round(self.torque_limit * 1e6)
        if abs(self._torque) > largest:
            self._torque = max(-largest, min(largest, self._torque))
            self._send(Mode.TORQUE, now)

    def next_poll(self, now: int) -> int:
        """Return how soon [ns] :meth:`.Host.poll` has to be called again: at the latest when the torque has to be 0."""
        # At least as often as the timeout, because an effort command may come meanwhile, and be the last one.
        regular = max(MS, min(10 * MS, self.watchdog_ns // 8, self._timeout))
        if not self.armed or self.effort_stopped:
            return regular
        return max(0, min(regular, self._last_effort + self._timeout - now))

    def poll(self, now: int) -> None:
        """Do what is due: repeat requests and commands, give arming up, command 0 where no effort command came."""
        if self._disarming_since is not None and self._output.open and now - self._last_sent >= REPEAT_INTERVAL:
            self._send(Mode.DISARM, now)
        if self._arming_since is not None and now - self._arming_since >= ARMING_TIMEOUT:
            self.stop('the board did not say within 0.5 s that it is armed', now)
        elif not self.armed:
            return
        elif not self.effort_stopped and now - self._last_effort >= self._timeout:
            self.effort_stopped = True
            self._torque = 0
            self._counters.command_timeouts += 1
            text = f'no effort command for {self._timeout / SECOND:g} s: torque 0, still armed'
            self._output.report(Level.WARN, text)
            self._send(Mode.TORQUE, now)
        elif now - self._last_sent >= self.watchdog_ns // 4:
            self._send(Mode.TORQUE, now)

    def follow(self, state: State, now: int) -> None:
        """Compare a STATE with what was sent, and with the one before it."""
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
        moves, moved = (bool(each.status & Status.ARMED or each.torque) for each in (state, self._before))
        # From off to on without an ARM of this host, or on although it was disarmed.
        foreign = moves and (self._disarming_since is None or not (moved or state.lock == self._lock))
        if foreign:
            self.lost = 'another program armed the motor, or a bridge that was killed'
            if self._output.is_new('armed by another', now):
                text = f'the board gives {state.torque / 1e6:g} N m, armed by another program; disarming it'
                self._output.report(Level.ERROR, f'{text}: end that program')
            self.stop(self.lost, now)
        elif self._disarming_since is None:
            if risen & FAULTS:
                self.stop('a fault', now)  # asks it to forget a fault that is over
        elif not moves and self._is_own(state.cmd_seq):
            self._disarming_since, self.disobeyed = None, False
        elif moves and now - self._disarming_since >= ARMING_TIMEOUT and not self.disobeyed:
            self.disobeyed = True
            self._output.report(Level.ERROR, DISOBEYED)

    def _go_on_arming(self, state: State, now: int) -> None:
        """Ask the board to be armed once it has obeyed the last mode 0; notice when it is, or will not be."""
        if self._disarming_since is not None:
            self._follow_disarmed(state, 0, now)
        if self._disarming_since is not None:
            return
        status, own = state.status, self._is_own(state.cmd_seq)
        if status & FAULTS:
            self.stop(f'the board is in a fault: {names(status & FAULTS)}', now)
        elif status & Status.ARMED and own and state.lock == self._lock:
            self.armed, self._arming_since = True, None
            self._last_effort = now
            self._output.emit(ArmingEnded())
        elif self._lock is None:
            self._request(state.lock, now)
            self._arm_seq = self._output.seq
        elif status & Status.ARMED or (
            state.lock != self._lock and not (own and self._is_before_arming(state.cmd_seq))
        ):
            self.stop('another program armed or disarmed the board meanwhile; end that program', now)
        elif state.lock != self._lock or now - self._last_sent >= REPEAT_INTERVAL:
            # A mode 0 of this host's own that was repeated came late, or the ARM was lost.
            self._request(state.lock, now)

    def _contradiction(self, state: State) -> str:
        """Return why this STATE of an armed board ends the arming; empty where it is as expected."""
        status = state.status
        if status & FAULTS:
            return f'the board is in a fault: {names(status & FAULTS)}'
        if status & Status.WATCHDOG:
            return "the board's watchdog tripped"
        own = self._is_own(state.cmd_seq)
        if not status & Status.ARMED:
            return 'the board is no longer armed' if own else 'another program disarmed the board'
        if not own or state.lock != self._lock:
            return (
                f'the board obeys frame {state.cmd_seq}, which this host did not send; another program moves the motor'
            )
        low, high = self._expected(state)
        if not low <= state.torque <= high:
            given, wanted = state.torque / 1e6, self._sent[state.cmd_seq] / 1e6
            return f'the board gives {given:g} N m where {wanted:g} N m were commanded; look at its firmware'
        return ''

    def _expected(self, state: State) -> tuple[int, int]:
        """Return between which torques [micro-N m] a board that obeys this frame may be."""
        wanted = self._sent[state.cmd_seq]
        if state.status & Status.SATURATED and self.board is not None:
            limit = self.board.torque_limit
            wanted = max(-limit, min(limit, wanted))
        if not state.status & Status.SLEW:
            return wanted, wanted
        # On its way from the torque before, past those that were wanted in between.
        before = self._before
        steps = (state.cmd_seq - before.cmd_seq) % _SEQS if self._is_own(before.cmd_seq) else 0
        passed = [wanted, before.torque, *(self._sent[(state.cmd_seq - k) % _SEQS] for k in range(1, min(steps, 1000)))]
        return min(passed), max(passed)

    def _count_refused(self, state: State, now: int) -> None:
        """Count the requests of others that the board refused, and report them."""
        more = 0 if self._refused is None else (state.refused - self._refused) % _SEQS
        self._refused = state.refused
        # One of an ended session, or an ARM that came too late, may be this host's own.
        if more and (self.armed or now - self._last_torque_sent >= IN_FLIGHT):
            self._counters.foreign_requests += more
            self._last_foreign = now
            if self._output.is_new('foreign', now):
                text = 'another program sends commands to the board, which refuses them; end that program'
                self._output.report(Level.WARN, text)

    def _report_faults(self, risen: int, now: int) -> None:
        # Some faults come and go, such as a supply that sags whenever the motor pulls.
        if new := sum(bit for name, bit in BITS.items() if bit & risen and self._output.is_new(name, now)):
            self._output.report(Level.ERROR, f'the board reports a fault: {names(new)}')

    def _is_own(self, seq: int) -> bool:
        """Return whether a frame was sent since the last disarming began; of a long time, in its last half minute."""
        return (self._output.seq - seq) % _SEQS < min(self._output.frames - self._frames_before, _SEQS // 2)

    def _is_before_arming(self, seq: int) -> bool:
        return (self._output.seq - seq) % _SEQS > (self._output.seq - self._arm_seq) % _SEQS

    def _request(self, lock: int, now: int) -> None:
        if self.board is not None:
            self._lock = lock
            own = {'session': self._session, 'watchdog_ms': self._config.watchdog_ms}
            self._output.send(Arm, now, boot_id=self.board.boot_id, lock=lock, **own)
            self._sent[self._output.seq] = 0
            self._last_sent = self._last_torque_sent = now

    def _send(self, mode: Mode, now: int) -> None:
        torque = self._torque if mode is Mode.TORQUE else 0
        own = {'session': self._session, 'watchdog_ms': self._config.watchdog_ms}
        self._output.send(Command, now, mode=mode, torque=torque, **own)
        self._sent[self._output.seq] = torque
        if mode is Mode.TORQUE:
            self._last_torque_sent = now
        # A closed port took nothing: once it is open, the request to disarm is repeated at once.
        self._last_sent = now if self._output.open else now - REPEAT_INTERVAL


def names(status: int) -> str:
    """Return the bits' names in words, such as ``over current, encoder 1``."""
    return ', '.join(name.lower().replace('_', ' ') for name, bit in BITS.items() if bit & status)
