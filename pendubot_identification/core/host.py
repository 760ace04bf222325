"""The host's side of the protocol as a state machine: bytes and time in, samples, reports and bytes out.

Nothing here reads a clock or a port. Every method that can bring news takes the present time ``now`` [ns, of any
clock that never goes back] and returns events; what has to be written to the board is fetched by
:meth:`Host.data_to_send` afterwards.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, auto

from .clock import WRAP, BoardClock
from .joints import BELIEVED_AFTER, Joints, Pair
from .level import Level
from .news import Armed, ArmingFailed, Counters, HostEvent, Report, Sample
from .protocol import (
    FAULTS,
    Command,
    Damaged,
    Decoder,
    Hello,
    HelloRequest,
    Message,
    Mode,
    Sequence,
    State,
    Status,
    encode,
)

MS = 1_000_000
SECOND = 1_000 * MS

HELLO_INTERVAL = 200 * MS
#: So many requests without an answer are reported.
UNANSWERED = 5
ARMING_TIMEOUT = 500 * MS
#: Link lost: nothing valid for the longer of this and five sample periods.
SILENCE = 100 * MS
SILENT_PERIODS = 5
#: A disarm is repeated this often while the board still says that it is armed.
DISARM_INTERVAL = 50 * MS
#: A clock that goes back further than this, not by its wrap, belongs to a board that restarted.
CLOCK_BACK_US = 10_000
#: A wrap moves the clock on by about what passed here, plus what may have waited in a buffer.
WRAP_SLACK_US = 10_000_000


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
        max_speed: a sample that would need more [rad/s] is flagged.
    """

    sign: Pair = (1.0, 1.0)
    zero: Pair = (-math.pi / 2, 0.0)
    counts_per_turn: tuple[int, int] = (0, 0)
    torque_limit: float = 2.0
    watchdog_ms: int = 100
    command_timeout: float = 0.1
    max_speed: float = 100.0


class _Phase(Enum):
    DISARMED = auto()
    ARMING = auto()
    ARMED = auto()


class Host:
    """The host's end of one link.

    It starts with the port closed and disarmed, and arms only by :meth:`arm`; any loss of the link, restart, trip or
    fault disarms it.
    """

    def __init__(self, config: HostConfig | None = None) -> None:
        self.config = config or HostConfig()
        self.clock = BoardClock()
        self._joints = Joints(self.config.sign, self.config.zero, self.config.max_speed)
        self._decoder = Decoder()
        self._sequence = Sequence()
        self._tally = dict.fromkeys(
            (
                'published',
                'unscaled',
                'restarts',
                'link_losses',
                'trips',
                'discarded',
                'clamped',
                'not_finite',
                'command_timeouts',
                'sent',
                'board_damaged',
                'board_overruns',
            ),
            0,
        )
        self._damaged: dict[str, int] = {}
        self._events: list[HostEvent] = []
        self._out = bytearray()
        self._seq = 0
        # The link
        self._closed_because = 'the port was not opened yet'
        self._open = False
        self._up = False
        self._fell_silent = False
        self._last_valid = 0
        self._last_poll: int | None = None
        self._held_up = False
        # The board
        self._hello: Hello | None = None
        self._boot_id: int | None = None
        self._hello_refused = False
        self._asking = False
        self._last_request = 0
        self._unanswered = 0
        self._state: State | None = None
        self._state_arrival = 0
        self._last_jump = -10 * SECOND
        # The motor
        self._phase = _Phase.DISARMED
        self._arming_since = 0
        self._arming_seq = 0
        self._bit_was_set = False
        self._last_disarm = 0
        self._torque = 0
        self._last_effort = 0
        self._last_clamp = -10 * SECOND
        self._last_sent = 0
        self._effort_stopped = False
        self._effort_not_finite = False

    # What can be asked at any time

    @property
    def armed(self) -> bool:
        """Whether the board is armed and commanded by this host."""
        return self._phase is _Phase.ARMED

    @property
    def hello(self) -> Hello | None:
        """What the board said about itself; None before it did."""
        return self._hello

    @property
    def state(self) -> State | None:
        """The last STATE that was accepted."""
        return self._state

    @property
    def link(self) -> str:
        """``up``, ``silent`` (the port is open, but nothing valid comes), or ``closed``."""
        if not self._open:
            return 'closed'
        return 'up' if self._up else 'silent'

    def age(self, now: int) -> float:
        """Return how long ago [s] the last STATE came; NaN before the first."""
        return (now - self._state_arrival) / SECOND if self._state else math.nan

    @property
    def poll_interval(self) -> float:
        """How often :meth:`poll` has to be called at least [s]."""
        return max(0.001, min(0.005, self._watchdog_ns / SECOND / 8))

    def counters(self) -> Counters:
        """Return what has happened so far."""
        s, j = self._sequence, self._joints
        return Counters(
            lost=s.lost,
            duplicates=s.duplicates,
            out_of_order=s.out_of_order,
            damaged=dict(self._damaged),
            flagged=j.flagged,
            jumps=j.jumps,
            **self._tally,
        )

    def condition(self) -> Report:
        """Return the worst of what stands at present, or whether it is armed when all is well."""
        status = Status(self._state.status) if self._state else Status(0)
        if not self._open:
            return Report(Level.ERROR, self._closed_because)
        if not self._up:
            return Report(Level.ERROR, 'no valid sample comes from the board')
        if status & FAULTS:
            return Report(Level.ERROR, _names(status & FAULTS))
        if self._hello is None:
            return Report(Level.WARN, 'waiting for the board to say HELLO')
        if status & Status.WATCHDOG:
            return Report(Level.WARN, "the board's watchdog tripped; arm again")
        if self._effort_stopped:
            return Report(Level.WARN, 'armed at torque 0: no effort command comes')
        return Report(Level.OK, 'armed' if self.armed else 'disarmed')

    def data_to_send(self) -> bytes:
        """Return, once, what has to be written to the port."""
        data = bytes(self._out)
        self._out.clear()
        return data

    # The link

    def opened(self, now: int) -> list[HostEvent]:
        """Note that the port was opened; ask who is there: it need not be the board that was there before."""
        self._decoder = Decoder()
        self._sequence.allow_gap()
        self._open, self._up, self._fell_silent = True, False, False
        self._hello = None
        self._unanswered = 0
        self._out.clear()
        self._ask(now)
        return self._news()

    def closed(self, reason: str, now: int) -> list[HostEvent]:
        """Note that the port failed or could not be opened; ``reason`` is a sentence for the user."""
        if self._up:
            self._tally['link_losses'] += 1
        self._open, self._up = False, False
        self._closed_because = reason
        self._stop('the link was lost', now)
        self._out.clear()
        self._report(Level.ERROR, reason)
        return self._news()

    def receive(self, data: bytes, now: int) -> list[HostEvent]:
        """Take bytes that arrived at ``now`` [ns]."""
        for event in self._decoder.feed(data):
            if isinstance(event, Damaged):
                self._damaged[event.reason] = self._damaged.get(event.reason, 0) + 1
                continue
            self._last_valid = now
            # A board that stopped sampling may still answer: after a silence only a sample shows that it is back.
            if isinstance(event, State) or not self._fell_silent:
                if self._fell_silent:
                    self._report(Level.OK, 'the board is heard again')
                self._up, self._fell_silent = True, False
            if isinstance(event, State):
                self._on_state(event, now)
            elif isinstance(event, Hello):
                self._on_hello(event, now)
        self._refresh(now)
        return self._news()

    def poll(self, now: int) -> list[HostEvent]:
        """Do what time alone brings: asking, timeouts, refreshed commands; at least every :attr:`poll_interval`."""
        # Where this program itself was held up, what came meanwhile waits to be read: no silence of the board's.
        held_up = not self._held_up and self._last_poll is not None and now - self._last_poll > SILENCE // 2
        self._last_poll, self._held_up = now, held_up
        if self._up and not held_up and now - self._last_valid > self._silence_ns:
            self._up, self._fell_silent = False, True
            self._tally['link_losses'] += 1
            self._report(Level.ERROR, f'link lost: nothing valid for {(now - self._last_valid) / SECOND:.2f} s')
            self._stop('the link was lost', now)
            self._sequence.allow_gap()
            self._ask(now)
        elif self._open and self._asking and now - self._last_request >= HELLO_INTERVAL:
            if self._unanswered == UNANSWERED:
                self._report(Level.WARN, f'the board did not answer {UNANSWERED} requests; check port, baud and wiring')
            self._ask(now)
        if self._phase is _Phase.ARMING and now - self._arming_since >= ARMING_TIMEOUT:
            self._stop('the board did not say within 0.5 s that it is armed', now)
        self._refresh(now)
        return self._news()

    # The motor

    def arm(self, now: int) -> list[HostEvent]:
        """Begin to arm; :class:`Armed` or :class:`ArmingFailed` follows, here or within 0.5 s."""
        status = Status(self._state.status) if self._state else Status(0)
        if self.armed:
            self._events.append(Armed())
        elif not self._open or not self._up:
            self._events.append(ArmingFailed(f'no board: {self.condition().text}'))
        elif self._hello is None:
            self._events.append(ArmingFailed('the board has not said HELLO yet'))
        elif status & FAULTS:
            self._events.append(ArmingFailed(f'the board is in a fault: {_names(status & FAULTS)}'))
        elif self._phase is _Phase.DISARMED:
            self._phase = _Phase.ARMING
            self._arming_since = now
            self._bit_was_set = bool(status & Status.ARMED)
            self._torque = 0
            self._effort_stopped = self._effort_not_finite = False
            self._command(Mode.DISARM, now)
            self._command(Mode.TORQUE, now)
            self._arming_seq = self._seq
        return self._news()

    def disarm(self, now: int) -> list[HostEvent]:
        """Disarm the board, whatever it is doing."""
        self._stop('disarmed on request', now, wanted=True)
        return self._news()

    def effort(self, torque: float, now: int) -> list[HostEvent]:
        """Take a torque wanted at the shoulder [N m]; it is sent at once when armed, else discarded."""
        if not math.isfinite(torque):
            self._tally['not_finite'] += 1
            if not self._effort_not_finite:
                self._effort_not_finite = True
                self._report(
                    Level.ERROR, f'an effort command of {torque} came; only finite torques are sent: disarming'
                )
            self._stop('an effort command was not finite', now, wanted=True)
            return self._news()
        self._effort_not_finite = False
        if not self.armed or self._hello is None:
            self._tally['discarded'] += 1
            return self._news()
        limit = min(self.config.torque_limit, self._hello.torque_limit / 1e6)
        clamped = max(-limit, min(limit, torque))
        if clamped != torque:
            self._tally['clamped'] += 1
            # A controller that stays at the limit, or comes back to it at once, is one occurrence.
            if now - self._last_clamp > SECOND:
                self._report(Level.WARN, f'an effort command of {torque:g} N m came; at most {limit:g} N m are sent')
            self._last_clamp = now
        self._torque = round(clamped * 1e6)
        self._last_effort = now
        if self._effort_stopped:
            self._effort_stopped = False
            self._report(Level.OK, 'effort commands come again')
        self._command(Mode.TORQUE, now)
        return self._news()

    # What the board says

    def _on_hello(self, hello: Hello, now: int) -> None:
        if self._boot_id is not None and hello.boot_id != self._boot_id:
            self._restarted('it has a new boot_id', now)
        elif self._has_restarted(hello, now):
            self._restarted('its clock and its sequence began again', now)
        self._sequence.accept(hello.seq)
        self._sequence.confirm_gap()
        self._boot_id = hello.boot_id
        self._unanswered = 0
        nonsense = self._nonsense(hello)
        self._asking = nonsense is not None
        if nonsense is not None:
            if not self._hello_refused:
                self._report(Level.ERROR, nonsense)
            self._hello_refused = True
            return
        self._hello_refused = False
        if self._hello is None or _introduction(hello) != _introduction(self._hello):
            self._report(Level.OK, _introduction(hello))
        self._hello = hello

    def _nonsense(self, hello: Hello) -> str | None:
        """Return why nobody can work with what the board says, or None."""
        said = (hello.cpr1, hello.cpr2)
        if 0 in (given or own for given, own in zip(self.config.counts_per_turn, said, strict=True)):
            return 'the board says 0 counts per turn; set counts_per_turn, or mend its firmware'
        if hello.torque_limit < 0:
            return f'the board says a torque limit of {hello.torque_limit / 1e6:g} N m; mend its firmware'
        return None

    def _on_state(self, state: State, now: int) -> None:
        if self._has_restarted(state, now):
            self._restarted('its clock and its sequence began again', now)
        if not self._sequence.accept(state.seq):
            return
        before = self._state
        self._state, self._state_arrival = state, now
        self._follow_status(before.status if before else 0, state, now)
        board_us = self.clock.observe(state.t_us, now)
        cpr = self._counts_per_turn
        if cpr is None:
            self._tally['unscaled'] += 1
            return
        jumps = self._joints.jumps
        motion = self._joints.update(board_us, (state.enc1, state.enc2), cpr)
        if motion is not None:
            self._tally['published'] += 1
            self._events.append(Sample(self.clock.map(board_us), motion.q, motion.qd, state.torque / 1e6))
        elif self._joints.jumps > jumps:
            # A joint that goes on faster than it may is one occurrence, not one every five samples.
            news = now - self._last_jump > SECOND
            self._last_jump = now
            if not news:
                return
            self._report(
                Level.WARN,
                f'{BELIEVED_AFTER} samples in a row would have needed more than {self.config.max_speed:g} rad/s: the '
                'new place is believed; check the encoders',
            )

    def _follow_status(self, before: int, state: State, now: int) -> None:
        status = Status(state.status)
        risen = Status(state.status & ~before)
        self._tally['board_damaged'] += bool(status & Status.DAMAGED_FRAME)
        self._tally['board_overruns'] += bool(status & Status.OVERRUN)
        if risen & FAULTS:
            self._report(Level.ERROR, f'the board reports a fault: {_names(risen & FAULTS)}')
        if risen & Status.WATCHDOG:
            self._tally['trips'] += 1
            self._report(Level.WARN, "the board's watchdog tripped")
        if self._phase is _Phase.DISARMED:
            if status & Status.ARMED and now - self._last_disarm >= DISARM_INTERVAL:
                self._command(Mode.DISARM, now)
        elif status & FAULTS:
            self._stop(f'the board is in a fault: {_names(status & FAULTS)}', now)
        elif self._phase is _Phase.ARMED:
            if not status & Status.ARMED:
                self._stop('the board is no longer armed', now)
        elif status & Status.ARMED and (not self._bit_was_set or self._obeyed(state)):
            self._phase = _Phase.ARMED
            self._last_effort = now
            self._events.append(Armed())

    def _obeyed(self, state: State) -> bool:
        """Tell whether the board obeyed this arming's mode 1, or a command after it."""
        return (state.cmd_seq - self._arming_seq) & 0xFFFF <= (self._seq - self._arming_seq) & 0xFFFF

    def _has_restarted(self, frame: State | Hello, now: int) -> bool:
        """Tell whether the clock went back, not by its wrap, in a frame that does not follow the one before."""
        if self._state is None or self._sequence.follows(frame.seq):
            return False
        if self._state.t_us - frame.t_us <= CLOCK_BACK_US:
            return False
        elapsed_us = (now - self._state_arrival) // 1000
        return (frame.t_us - self._state.t_us) % WRAP > elapsed_us + WRAP_SLACK_US

    def _restarted(self, evidence: str, now: int) -> None:
        self._tally['restarts'] += 1
        self._report(Level.WARN, f'the board restarted: {evidence}')
        self._stop('the board restarted', now)
        self._sequence.begin()
        self.clock.restart()
        self._joints.restart()
        self._state = None
        self._hello = None
        self._boot_id = None
        self._ask(now)

    # What follows from it

    @property
    def _counts_per_turn(self) -> tuple[int, int] | None:
        first, second = self.config.counts_per_turn
        if first and second:
            return first, second
        if self._hello is None:
            return None
        return first or self._hello.cpr1, second or self._hello.cpr2

    @property
    def _silence_ns(self) -> int:
        period = self._hello.sample_period_us * 1000 if self._hello else 0
        return max(SILENCE, SILENT_PERIODS * period)

    @property
    def _watchdog_ns(self) -> int:
        limit = self._hello.watchdog_max_ms if self._hello else self.config.watchdog_ms
        return min(self.config.watchdog_ms, limit) * MS

    def _refresh(self, now: int) -> None:
        if self._phase is _Phase.DISARMED:
            return
        if self.armed and not self._effort_stopped and now - self._last_effort > self.config.command_timeout * SECOND:
            self._effort_stopped = True
            self._torque = 0
            self._tally['command_timeouts'] += 1
            self._report(Level.WARN, f'no effort command for {self.config.command_timeout:g} s: torque 0, still armed')
            self._command(Mode.TORQUE, now)
        elif now - self._last_sent >= self._watchdog_ns // 4:
            self._command(Mode.TORQUE, now)

    def _stop(self, reason: str, now: int, wanted: bool = False) -> None:
        """Disarm; unless it was ``wanted``, losing an armed motor is reported."""
        phase, self._phase = self._phase, _Phase.DISARMED
        self._torque = 0
        self._effort_stopped = False
        if phase is _Phase.ARMING:
            self._events.append(ArmingFailed(reason))
        elif phase is _Phase.ARMED and not wanted:
            self._report(Level.WARN, f'disarmed: {reason}; arm again when it is safe')
        self._command(Mode.DISARM, now)

    def _ask(self, now: int) -> None:
        self._asking = True
        self._unanswered += 1
        self._last_request = now
        self._send(HelloRequest(self._next_seq(), now // 1000 % WRAP))

    def _command(self, mode: Mode, now: int) -> None:
        torque = self._torque if mode is Mode.TORQUE else 0
        self._send(Command(self._next_seq(), now // 1000 % WRAP, mode, self.config.watchdog_ms, torque))
        self._last_sent = now
        if mode is Mode.DISARM:
            self._last_disarm = now

    def _next_seq(self) -> int:
        self._seq = (self._seq + 1) & 0xFFFF
        return self._seq

    def _send(self, message: Message) -> None:
        if self._open:
            self._out += encode(message)
            self._tally['sent'] += 1

    def _report(self, level: Level, text: str) -> None:
        self._events.append(Report(level, text))

    def _news(self) -> list[HostEvent]:
        events, self._events = self._events, []
        return events


def _introduction(hello: Hello) -> str:
    """Return in a sentence what a board says about itself."""
    return (
        f'board {hello.firmware!r}: {hello.cpr1} and {hello.cpr2} counts per turn, a sample every '
        f'{hello.sample_period_us / 1000:g} ms, torque up to {hello.torque_limit / 1e6:g} N m'
    )


def _names(status: Status) -> str:
    """Return the bits' names in words, such as ``over current, encoder 1``."""
    return ', '.join(bit.name.lower().replace('_', ' ') for bit in Status if bit in status and bit.name)
