"""The host's side of the protocol as a state machine: bytes and time in, samples, reports and bytes out.

Nothing here reads a clock or a port. Every method that can bring news takes the present time ``now`` [ns, of any
clock that never goes back] and returns events; what has to be written to the board is fetched by
:meth:`Host.data_to_send` afterwards.
"""

from __future__ import annotations

import math

from pendubot_identification.level import Level

from .clock import WRAP, BoardClock
from .host_config import HostConfig
from .joints import BELIEVED_AFTER, Joints
from .motor import MS, SECOND, Motor, names
from .news import ArmingFailed, Counters, HostEvent, News, Report, Sample
from .protocol import FAULTS, Damaged, Decoder, Hello, Sequence, State, Status
from .transmitter import Transmitter

HELLO_INTERVAL = 200 * MS
#: So many requests without an answer are reported.
UNANSWERED = 5
#: Link lost: nothing valid for the longer of so many sample periods and the configured time.
SILENT_PERIODS = 5
#: Who polls so late [ns] was held up itself.
HELD_UP = 50 * MS
WAITING = 'waiting for the board to say HELLO'
#: A clock that goes back further than this, not by its wrap, belongs to a board that restarted.
CLOCK_BACK_US = 10_000
#: No clock is faster than another by more than this.
FASTER = 1e-3

# As plain numbers: a status is looked at a thousand times a second, and an IntFlag takes its time.
_DAMAGED_FRAME, _OVERRUN, _FAULTS = int(Status.DAMAGED_FRAME), int(Status.OVERRUN), int(FAULTS)


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
        self._news = News()
        self._transmitter = Transmitter()
        self._motor = Motor(self.config, self._transmitter, self._news)
        # Counted here; the rest is counted where it happens.
        self._damaged: dict[str, int] = {}
        self._received = 0
        self._published = 0
        self._unscaled = 0
        self._restarts = 0
        self._link_losses = 0
        self._board_damaged = 0
        self._board_overruns = 0
        # The link
        self._closed_because = 'the port was not opened yet'
        self._heard = False
        self._up = False
        self._fell_silent = False
        self._last_valid = 0
        self._last_poll: int | None = None
        self._held_up = False
        # The board
        self._boot_id: int | None = None
        self._nonsense: str | None = None  # what HELLO said that nobody can work with
        self._asking = False
        self._last_request = 0
        self._unanswered = 0
        self._state: State | None = None
        self._state_arrival = 0
        self._state_taken = 0  # when it was taken, by the board's clock as it is mapped [ns]
        self._last_jump = -10 * SECOND

    # What can be asked at any time

    @property
    def armed(self) -> bool:
        """Whether the board is armed and commanded by this host."""
        return self._motor.armed

    @property
    def hello(self) -> Hello | None:
        """What the board said about itself; None before it did."""
        return self._motor.board

    @property
    def state(self) -> State | None:
        """The last STATE that was accepted."""
        return self._state

    @property
    def link(self) -> str:
        """``up``, ``silent`` (the port is open, but nothing valid comes), or ``closed``."""
        if not self._transmitter.open:
            return 'closed'
        return 'up' if self._up else 'silent'

    def age(self, now: int) -> float:
        """Return how long ago [s] the last STATE came; NaN before the first."""
        return (now - self._state_arrival) / SECOND if self._state else math.nan

    def next_poll(self, now: int) -> float:
        """Return how soon [s] :meth:`poll` has to be called again, whatever else is called in between."""
        return self._motor.next_poll(now) / SECOND

    def counters(self) -> Counters:
        """Return what has happened so far."""
        sequence, joints, motor = self._sequence, self._joints, self._motor
        return Counters(
            received=self._received,
            published=self._published,
            lost=sequence.lost,
            duplicates=sequence.duplicates,
            out_of_order=sequence.out_of_order,
            damaged=dict(self._damaged),
            unscaled=self._unscaled,
            flagged=joints.flagged,
            jumps=joints.jumps,
            restarts=self._restarts,
            link_losses=self._link_losses,
            trips=motor.trips,
            discarded=motor.discarded,
            clamped=motor.clamped,
            not_finite=motor.not_finite,
            command_timeouts=motor.command_timeouts,
            sent=self._transmitter.sent,
            board_damaged=self._board_damaged,
            board_overruns=self._board_overruns,
        )

    def condition(self) -> Report:
        """Return the worst of what stands at present, or whether it is armed when all is well."""
        status = self._state.status if self._state else 0
        if not self._transmitter.open:
            return Report(Level.ERROR, self._closed_because)
        if not self._up:
            return Report(Level.ERROR, 'no valid sample comes from the board')
        if status & _FAULTS:
            return Report(Level.ERROR, names(status & _FAULTS))
        if self.hello is None:
            return Report(*((Level.ERROR, self._nonsense) if self._nonsense else (Level.WARN, WAITING)))
        if status & Status.WATCHDOG:
            return Report(Level.WARN, "the board's watchdog tripped; arm again")
        if self._motor.effort_stopped:
            return Report(Level.WARN, 'armed at torque 0: no effort command comes')
        return Report(Level.OK, 'armed' if self.armed else 'disarmed')

    def data_to_send(self) -> bytes:
        """Return, once, what has to be written to the port."""
        return self._transmitter.take()

    # The link

    def opened(self, now: int) -> list[HostEvent]:
        """Note that the port was opened; ask who is there: it need not be the board that was there before."""
        self._decoder = Decoder()
        self._sequence.allow_gap()
        self._transmitter.open = True
        self._up, self._fell_silent = False, False
        self._motor.board = None
        self._unanswered = 0
        self._ask(now)
        return self._news.take()

    def closed(self, reason: str, now: int) -> list[HostEvent]:
        """Note that the port failed or could not be opened; ``reason`` is a sentence for the user."""
        # A port that fails again before anything was heard, for the same reason, is no news.
        if self._heard or reason != self._closed_because:
            self._news.report(Level.ERROR, reason)
        self._link_losses += self._up
        self._transmitter.open, self._up, self._heard = False, False, False
        self._closed_because = reason
        self._motor.stop('the link was lost', now)
        self._transmitter.clear()
        return self._news.take()

    def receive(self, data: bytes, now: int) -> list[HostEvent]:
        """Take bytes that arrived at ``now`` [ns]."""
        for event in self._decoder.feed(data):
            if isinstance(event, Damaged):
                self._damaged[event.reason] = self._damaged.get(event.reason, 0) + 1
                continue
            self._received += 1
            self._heard = True
            self._last_valid = now
            if isinstance(event, State):
                if self._fell_silent:
                    self._news.report(Level.OK, 'the board is heard again')
                self._up, self._fell_silent = True, False
                self._on_state(event, now)
            elif isinstance(event, Hello):
                # A board that stopped sampling may still answer: after a silence only a sample shows that it is back.
                self._up = not self._fell_silent
                self._on_hello(event, now)
        self._motor.poll(now)
        return self._news.take()

    def poll(self, now: int) -> list[HostEvent]:
        """Do what time alone brings: asking, timeouts, refreshed commands; as soon as :meth:`next_poll` says."""
        # Where this program itself was held up, what came meanwhile waits to be read: no silence of the board's.
        held_up = not self._held_up and self._last_poll is not None and now - self._last_poll > HELD_UP
        self._last_poll, self._held_up = now, held_up
        if self._up and not held_up and now - self._last_valid > self._silence_ns:
            self._up, self._fell_silent = False, True
            self._link_losses += 1
            self._news.report(Level.ERROR, f'link lost: nothing valid for {(now - self._last_valid) / SECOND:.2f} s')
            self._motor.stop('the link was lost', now)
            self._sequence.allow_gap()
            self._ask(now)
        elif self._transmitter.open and self._asking and now - self._last_request >= HELLO_INTERVAL:
            if self._unanswered == UNANSWERED:
                self._news.report(
                    Level.WARN, f'the board did not answer {UNANSWERED} requests; check port, baud and wiring'
                )
            self._ask(now)
        self._motor.poll(now)
        return self._news.take()

    # The motor

    def arm(self, now: int) -> list[HostEvent]:
        """Begin to arm; :class:`Armed` or :class:`ArmingFailed` follows, here or within 0.5 s."""
        if self._up:
            self._motor.arm(self._state, now)
        else:
            self._news.tell(ArmingFailed(f'no board: {self.condition().text}'))
        return self._news.take()

    def disarm(self, now: int) -> list[HostEvent]:
        """Disarm the board, whatever it is doing."""
        self._motor.stop('disarmed on request', now, wanted=True)
        return self._news.take()

    def effort(self, torque: float, now: int) -> list[HostEvent]:
        """Take a torque wanted at the shoulder [N m]; it is sent at once when armed, else discarded."""
        self._motor.effort(torque, now)
        return self._news.take()

    # What the board says

    def _on_hello(self, hello: Hello, now: int) -> None:
        if self._boot_id is not None and hello.boot_id != self._boot_id:
            self._restarted('it has a new boot_id', now)
        elif self._has_restarted(hello, now):
            self._restarted('its clock and its sequence began again', now)
        self._sequence.accept(hello.seq, self._is_later(hello))
        self._sequence.confirm_gap()
        self._boot_id = hello.boot_id
        self._unanswered = 0
        before, self._nonsense = self._nonsense, self._nonsense_in(hello)
        self._asking = self._nonsense is not None
        if self._nonsense is not None:
            if self._nonsense != before:
                self._news.report(Level.ERROR, self._nonsense)
            return
        if self.hello is None or _introduction(hello) != _introduction(self.hello):
            self._news.report(Level.OK, _introduction(hello))
        self._motor.board = hello

    def _nonsense_in(self, hello: Hello) -> str | None:
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
        if not self._sequence.accept(state.seq, self._is_later(state)):
            return
        before = self._state
        self._state, self._state_arrival = state, now
        if state.status:
            self._board_damaged += bool(state.status & _DAMAGED_FRAME)
            self._board_overruns += bool(state.status & _OVERRUN)
        self._motor.follow(state, before.status if before else 0, now)
        board_us = self.clock.observe(state.t_us, now)
        self._state_taken = self.clock.taken(board_us)
        cpr = self._counts_per_turn
        if cpr is None:
            self._unscaled += 1
            return
        jumps = self._joints.jumps
        motion = self._joints.update(board_us, (state.enc1, state.enc2), cpr)
        if motion is not None:
            self._published += 1
            self._news.tell(Sample(self.clock.map(board_us), motion.q, motion.qd, state.torque / 1e6))
        elif self._joints.jumps > jumps:
            # A joint that goes on faster than it may is one occurrence, not one every five samples.
            news = now - self._last_jump > SECOND
            self._last_jump = now
            if not news:
                return
            self._news.report(
                Level.WARN,
                f'{BELIEVED_AFTER} samples in a row would have needed more than {self.config.max_speed:g} rad/s: the '
                'new place is believed; check the encoders',
            )

    def _is_later(self, frame: State | Hello) -> bool:
        """Tell whether the board's clock went on since the last STATE, by its wrap perhaps."""
        return self._state is not None and 0 < (frame.t_us - self._state.t_us) % WRAP < WRAP // 2

    def _has_restarted(self, frame: State | Hello, now: int) -> bool:
        """Tell whether the clock went back, not by its wrap, in a frame that does not follow the one before."""
        if self._state is None or self._sequence.follows(frame.seq):
            return False
        if self._state.t_us - frame.t_us <= CLOCK_BACK_US:
            return False
        # A wrap moves the clock on by no more than what passed since the sample before was taken, however long that
        # waited somewhere: no frame is sent before its time.
        elapsed_us = (now - self._state_taken) * 1e-3 * (1 + FASTER)
        return (frame.t_us - self._state.t_us) % WRAP > elapsed_us + CLOCK_BACK_US

    def _restarted(self, evidence: str, now: int) -> None:
        self._restarts += 1
        self._news.report(Level.WARN, f'the board restarted: {evidence}')
        self._motor.stop('the board restarted', now)
        self._motor.board = None
        self._sequence.begin()
        self.clock.restart()
        self._joints.restart()
        self._state = None
        self._boot_id = None
        self._ask(now)

    # What follows from it

    @property
    def _counts_per_turn(self) -> tuple[int, int] | None:
        first, second = self.config.counts_per_turn
        if first and second:
            return first, second
        if self.hello is None:
            return None
        return first or self.hello.cpr1, second or self.hello.cpr2

    @property
    def _silence_ns(self) -> int:
        period = self.hello.sample_period_us * 1000 if self.hello else 0
        return max(round(self.config.link_timeout * SECOND), SILENT_PERIODS * period)

    def _ask(self, now: int) -> None:
        self._asking = True
        self._unanswered += 1
        self._last_request = now
        self._transmitter.request_hello(now)


def _introduction(hello: Hello) -> str:
    """Return in a sentence what a board says about itself."""
    return (
        f'board {hello.firmware!r}: {hello.cpr1} and {hello.cpr2} counts per turn, a sample every '
        f'{hello.sample_period_us / 1000:g} ms, torque up to {hello.torque_limit / 1e6:g} N m'
    )
