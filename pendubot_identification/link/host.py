# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The host's side of the protocol as a state machine: bytes and time in, samples, reports and bytes out.

This module reads no clock and no port. Methods take the present time ``now`` [ns, of any monotonic clock]. The caller
then takes the events, and the bytes for the board, from :attr:`Host.output`.
"""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from pendubot_identification.level import Level

from .clock import MS, SECOND, WRAP, BoardClock
from .events import ArmingEnded, HostConfig, Output, Report, Sample
from .joints import Joints
from .limits import LimitMonitor
from .motor import REPEAT_INTERVAL, UNCONFIRMED, Motor, names
from .protocol import FAULTS, VERSION, Command, Damaged, Decoder, Hello, HelloRequest, Limits, Mode, State, Status


@dataclass(frozen=True, slots=True)
class HostSettings:
    """The thresholds for a board that is silent, restarted or at rest."""

    hello_interval: int = 200 * MS  #: Interval of the requests for HELLO [ns].
    unanswered: int = 5  #: Number of requests without an answer that is reported.
    silent_periods: int = 5  #: Silence after which the link is lost [sample periods]; at least link_timeout.
    #: Upper bound of these sample periods while armed [ns], unless the watchdog time is longer.
    longest_unseen: int = 500 * MS
    held_up: int = 50 * MS  #: Interval between polls after which this program itself was delayed [ns].
    clock_back_us: int = 10_000  #: Backward step of the board's clock without a wrap that is a restart [us].
    clock_tolerance: float = 1e-3  #: Largest relative skew between the clocks of board and host.
    rest_counts: int = 2  #: Largest movement of an encoder at rest [counts].
    rest_us: int = 1_000_000  #: Time within ``rest_counts`` after which the rig is at rest [us of board time].
    steps: int = 10  #: Number of steps of the board's clock whose mean is compared with HELLO's period.
    period_tolerance: float = 0.1  #: Largest relative difference between HELLO's period and this mean.


SETTINGS = HostSettings()


class Host:
    """The host's end of one link.

    It starts with the port closed and disarmed, and arms only by :meth:`arm`; any loss of the link, restart, trip or
    fault disarms it.

    Args:
        config: the user's settings.
        new_session: returns a new number from 1 to 2^32 - 1 at every call, which no other host uses. The default
            counts from 1, for simulations only.

    Attributes:
        motor: arming, torque commands and disarming.
        output: events and bytes to take.
        state: the last accepted STATE; None before the first.
    """

    def __init__(self, config: HostConfig | None = None, new_session: Callable[[], int] | None = None) -> None:
        self.config = config or HostConfig()
        self.output = Output()
        if new_session is not None:
            # Two hosts on one port start with different sequence numbers.
            self.output.seq = new_session() & 0xFFFF
        self.counters = self.output.counters
        self.clock = BoardClock()
        self._decoder = Decoder()
        self.motor = Motor(self.config, self.output, new_session)
        # The link
        self._closed_because = 'the port was not opened yet'
        self._heard = False
        self._up = False
        self._fell_silent = False
        self._last_valid = 0
        self._last_poll: int | None = None
        self._held_up = False
        # The board
        self._forget_board()
        self._unusable = ''  # why its HELLO cannot be used
        self._asking = False
        self._last_request = 0
        self._unanswered = 0
        self._state_arrival = 0  # [ns]
        self._state_taken = 0  # host time at which the board took the last STATE [ns]
        self._other_version = 0
        self._zeros_sent = 0

    def _forget_board(self) -> None:
        """Reset the state for a board that has just booted."""
        self.state: State | None = None
        self._seq: int | None = None  # of the last frame, while the link is up
        self._boot_id: int | None = None
        self._board_us: int | None = None  # board time of the last STATE
        #: Steps of the board's clock between consecutive frames [us].
        self._steps: deque[int] = deque(maxlen=SETTINGS.steps)
        self._limits: LimitMonitor | None = None
        self._zeros_confirmed = False
        self._rest: tuple[int, int, int] | None = None  # counts of the present rest position and its start [board us]
        self.clock = BoardClock(self.clock.last_stamp)
        self._joints = Joints(self.config, self.output)
        self.motor.restarted()

    # Queries

    @property
    def armed(self) -> bool:
        """Whether the board is armed and commanded by this host."""
        return self.motor.armed

    @property
    def hello(self) -> Hello | None:
        """The last HELLO of the board; None before the first."""
        return self.motor.board

    @property
    def link(self) -> str:
        """State of the link: ``up``, ``silent`` (the port is open, without valid frames), or ``closed``."""
        if not self.output.open:
            return 'closed'
        return 'up' if self._up else 'silent'

    def age(self, now: int) -> float:
        """Return the age of the last STATE [s]; NaN before the first."""
        return (now - self._state_arrival) / SECOND if self.state else math.nan

    def condition(self, now: int) -> Report:
        """Return the most severe present problem; without a problem, whether the board is armed."""
        status = self.state.status if self.state else 0
        if not self.output.open:
            return Report(Level.ERROR, self._closed_because)
        if not self._up:
            return Report(Level.ERROR, self._version_text() or 'no valid sample arrives from the board')
        if self.motor.disobeyed:
            return Report(Level.ERROR, UNCONFIRMED)
        if status & FAULTS:
            return Report(Level.ERROR, names(status & FAULTS))
        if wrong := self._unusable or self._contradiction():
            return Report(Level.ERROR, wrong)
        if status & Status.WATCHDOG:
            return Report(Level.WARN, "the board's watchdog tripped; arm again")
        if not self.armed and (obstacle := self._obstacle(now)):
            return Report(Level.WARN, f'disarmed, and arming is refused: {obstacle}')
        if self.motor.effort_stopped:
            return Report(Level.WARN, 'armed at torque 0: no effort command arrives')
        if self.motor.lost:
            return Report(Level.WARN, f'disarmed: {self.motor.lost}; arm again when it is safe')
        if rate := self._rate_text():
            return Report(Level.WARN, rate)
        return Report(Level.OK, 'armed' if self.armed else 'disarmed')

    # The link

    def opened(self, now: int) -> None:
        """Handle an opened port: request HELLO, because the board may be another than before."""
        self._decoder = Decoder()
        self._seq = None
        self.output.open = True
        # The delimiter ends a frame that another host left unfinished, so that the first frame is not lost.
        self.output.data = b'\0'
        self._up, self._fell_silent = False, False
        self._other_version = 0
        self.motor.board = None
        self._unanswered = 0
        self._ask(now)

    def closed(self, reason: str, now: int) -> None:
        """Handle a port that failed or could not be opened; ``reason`` is a sentence for the user."""
        # The same reason is reported again only after a valid frame.
        if self._heard or reason != self._closed_because:
            self.output.report(Level.ERROR, reason)
        self.counters.link_losses += self._up
        self.output.open, self._up, self._heard = False, False, False
        self._closed_because = reason
        self.motor.stop('the link was lost', now)
        self.output.data = b''

    def receive(self, data: bytes, now: int) -> None:
        """Process bytes that arrived at ``now`` [ns]."""
        for event in self._decoder.feed(data):
            if isinstance(event, Damaged):
                damaged = self.counters.damaged
                damaged[event.reason] = damaged.get(event.reason, 0) + 1
                if event.version and event.version != self._other_version:
                    self._other_version = event.version
                    self.output.report(Level.ERROR, self._version_text())
                continue
            self.counters.received += 1
            self._heard = True
            self._last_valid = now
            if isinstance(event, State):
                if self._fell_silent:
                    self.output.report(Level.OK, 'the board sends again')
                self._up, self._fell_silent = True, False
                self._on_state(event, now)
            elif isinstance(event, Hello):
                # A board that stopped sampling may still answer: after a silence only a sample restores the link.
                self._up = not self._fell_silent
                self._on_hello(event, now)
        self.motor.poll(now)

    def poll(self, now: int) -> None:
        """Handle due requests, timeouts and repeated commands. :meth:`.Motor.next_poll` returns the time to call it."""
        # After a delay of this program itself, the bytes in the buffer are read before the link counts as lost.
        held_up = not self._held_up and self._last_poll is not None and now - self._last_poll > SETTINGS.held_up
        self._last_poll, self._held_up = now, held_up
        if self._up and not held_up and now - self._last_valid > self._silence_ns:
            self._up, self._fell_silent = False, True
            self.counters.link_losses += 1
            self.output.report(Level.ERROR, f'link lost: no valid frame for {(now - self._last_valid) / SECOND:.2f} s')
            self.motor.stop('the link was lost', now)
            self._seq = None
            self._ask(now)
        elif self.output.open and self._asking and now - self._last_request >= SETTINGS.hello_interval:
            if self._unanswered == SETTINGS.unanswered:
                text = f'the board did not answer {SETTINGS.unanswered} requests; check port, baud and wiring'
                self.output.report(Level.WARN, text)
            self._ask(now)
        self.motor.poll(now)

    def arm(self, now: int) -> None:
        """Start arming; :class:`.events.ArmingEnded` follows at once or within 0.5 s."""
        if not self._up or self.state is None:
            self.output.emit(ArmingEnded(f'no board: {self.condition(now).text}'))
        elif not self.armed and (obstacle := self._obstacle(now)):
            self.output.emit(ArmingEnded(obstacle))
        else:
            self.motor.arm(self.state, now)

    def confirm_zeros(self, now: int) -> tuple[bool, str]:
        """Confirm the angles of a rig at rest until the board restarts; return success and a message."""
        if not self._up or self.state is None or self._joints.q is None:
            return False, f'no angle arrives: {self.condition(now).text}'
        q1, q2 = self._joints.q
        angles = f'q1 = {q1:.4f} rad, q2 = {q2:.4f} rad'
        if self._board_us is None or self._rest is None or self._board_us - self._rest[2] < SETTINGS.rest_us:
            return False, f'the links were not at rest for a second ({angles}); let both hang, then call again'
        self._zeros_confirmed = True
        self._send_zeros(now)
        return True, f'confirmed: {angles}; if that is wrong, restart the board while both links hang at rest'

    def _send_zeros(self, now: int) -> None:
        """Store the confirmation of the zeros on the board until it restarts, for other hosts too."""
        self._zeros_sent = now
        if self.hello is not None:
            self.output.send(Command, now, mode=Mode.CONFIRM_ZEROS, session=self.hello.boot_id)

    def _obstacle(self, now: int) -> str:
        """Return the reason against arming the motor, and the correction; empty if there is none."""
        hello, config = self.hello, self.config
        if wrong := self._unusable or self._contradiction():
            return wrong
        if hello is None:
            return 'the board has not sent HELLO yet'
        if self.motor.contested(now):
            return 'another program sends commands to the board; end that program'
        limits = hello.limits
        for name, of_board, configured in (
            ('max_speed', limits.max_speed, config.max_speed),
            ('max_travel of the shoulder', limits.max_travel1, config.max_travel[0]),
            ('max_travel of the elbow', limits.max_travel2, config.max_travel[1]),
        ):
            if configured and not 0 < of_board <= configured * 1000:
                allowed = f'a limit of {of_board / 1000:g}' if of_board else 'no limit'
                return f'{name} is {configured:g}, and the board has {allowed}; lower its limit in rig.h, or raise this'
        known = self._zeros_confirmed or (self.state is not None and self.state.status & Status.ZEROED)
        if config.confirm_zeros and not known:
            return (
                'the board has restarted since somebody last confirmed its zeros, so the angles may be wrong; let both '
                'links hang at rest and call ~/confirm_zeros (or set confirm_zeros to false)'
            )
        return ''

    def _version_text(self) -> str:
        if not self._other_version:
            return ''
        return (
            f'the board uses version {self._other_version} of the protocol, and this bridge version {VERSION}: flash '
            'the firmware that belongs to this bridge (docs/rig.md)'
        )

    # Messages of the board

    def _on_state(self, state: State, now: int) -> None:
        self._detect_restart(state, now)
        if not self._accept(state):
            return
        frames = 1 if self.state is None else max(1, (state.seq - self.state.seq) & 0xFFFF)
        applied, status = self.state.torque if self.state else 0, state.status
        self.state, self._state_arrival = state, now
        if self._zeros_confirmed and not status & Status.ZEROED and now - self._zeros_sent >= REPEAT_INTERVAL:
            self._send_zeros(now)
        counters = self.counters
        if status:
            counters.board_damaged += bool(status & Status.DAMAGED_FRAME)
            counters.board_overruns += bool(status & Status.OVERRUN)
            counters.late_samples += bool(status & Status.LATE)
        self.motor.follow(state, now)
        board_us = self._board_time(state.t_us, now, frames)
        if self._limits is not None and self._board_us is not None:
            self._check_limits(state, board_us - self._board_us, applied, now)
        self._board_us = board_us
        self._note_rest(state, board_us)
        counts_per_turn = self._counts_per_turn(self.hello)
        if 0 in counts_per_turn:
            counters.unscaled += 1
            return
        sample = self._joints.update(board_us, (state.enc1, state.enc2), counts_per_turn, now)
        if sample is not None:
            counters.published += 1
            q, qd = sample
            stamp_ns = self.clock.stamp(self._state_taken)
            self.output.emit(Sample(stamp_ns, q, qd, state.torque / 1e6, state.current / 1e3))

    def _board_time(self, t_us: int, now: int, frames: int) -> int:
        """Return a sample's board time [us]; report a jump or a wrong rate of the clock."""
        clock, before, counters = self.clock, self._board_us, self.counters
        board_us = clock.observe(t_us, now, frames)
        self._state_taken = clock.host_time(board_us)
        counters.irregular_stamps += clock.irregular
        if clock.jump_us:
            counters.clock_jumps += 1
            text = f"the board's clock jumped by {clock.jump_us / 1e3:+g} ms; check its timer"
            self.output.report(Level.WARN, text)
        if frames == 1 and not clock.irregular and before is not None:
            self._steps.append(board_us - before)
        if rate := self._rate_text():
            self.output.report_new('rate', now, Level.WARN, rate)
        return board_us

    def _note_rest(self, state: State, board_us: int) -> None:
        enc1, enc2, _ = self._rest or (math.inf, math.inf, 0)
        if max(abs(state.enc1 - enc1), abs(state.enc2 - enc2)) > SETTINGS.rest_counts:
            self._rest = state.enc1, state.enc2, board_us

    def _rate_text(self) -> str:
        """Return a message with the rate error of the board's clock; empty within the tolerance of crystals."""
        rate = self.clock.wrong_rate
        if not rate:
            return ''
        faster = 'slow' if rate > 0 else 'fast'
        text = f"the board's clock runs {abs(rate) * 100:.2g} % {faster}: check CRYSTAL_MHZ, or its timer"
        return f'{text}; velocities and parameters have the same error'

    def _check_limits(self, state: State, elapsed_us: int, applied: int, now: int) -> None:
        """Disarm if a limit is exceeded and the board, whose limit is not higher, did not switch off."""
        assert self._limits is not None
        exceeded = self._limits.check(state, elapsed_us, applied)
        if exceeded and self.armed:
            text = f'a limit is exceeded ({names(exceeded)}), and the board does not switch off; correct its firmware'
            self.output.report(Level.ERROR, text)
            self.motor.stop(text, now)

    def _on_hello(self, hello: Hello, now: int) -> None:
        self._detect_restart(hello, now)
        self._accept(hello)
        self._boot_id = hello.boot_id
        self._unanswered = 0
        before, self._unusable = self._unusable, self._why_unusable(hello)
        self._asking = bool(self._unusable)
        if self._unusable:
            if self._unusable != before:
                self.output.report(Level.ERROR, self._unusable)
            return
        if self.hello is None or _introduction(hello) != _introduction(self.hello):
            self.output.report(Level.OK, _introduction(hello))
        self.motor.board = hello
        if self._limits is None:
            self._limits = LimitMonitor(self._own_limits(hello.limits), self._counts_per_turn(hello))

    def _own_limits(self, limits: Limits) -> Limits:
        """Return the limits that this host checks: the user's limits, or the board's where the user set none."""
        config = self.config
        travel = [
            round(1000 * configured) or board
            for configured, board in zip(config.max_travel, (limits.max_travel1, limits.max_travel2), strict=True)
        ]
        return limits._replace(max_speed=round(1000 * config.max_speed), max_travel1=travel[0], max_travel2=travel[1])

    def _why_unusable(self, hello: Hello) -> str:
        """Return the invalid value in a HELLO, and the correction; empty if all values are valid."""
        if 0 in self._counts_per_turn(hello):
            return 'the board reports 0 counts per turn; set counts_per_turn, or correct its firmware'
        if hello.torque_limit < 0:
            return f'the board reports a torque limit of {hello.torque_limit / 1e6:g} N m; correct its firmware'
        return ''

    @property
    def _period_us(self) -> float:
        """Mean period of the last samples on the board's clock [us]; 0 while there are too few."""
        return sum(self._steps) / SETTINGS.steps if len(self._steps) == SETTINGS.steps else 0.0

    def _contradiction(self) -> str:
        """Return the contradiction between HELLO's sampling period and the samples; empty if there is none."""
        measured = self._period_us
        if self.hello is None or not measured:
            return ''
        period = self.hello.sample_period_us
        if abs(period - measured) <= SETTINGS.period_tolerance * measured:
            return ''
        return (
            f'the board reports a sample period of {period / 1000:g} ms, and its samples are {measured / 1000:g} ms '
            'apart; correct its firmware'
        )

    def _accept(self, frame: State | Hello) -> bool:
        """Count lost, repeated and late frames; return whether this frame is new and in order."""
        step = 1 if self._seq is None else (frame.seq - self._seq) & 0xFFFF
        if step == 0:
            self.counters.duplicates += 1
            return False
        # During a pause of this program the numbers may have advanced by over half their range: use the board's clock.
        later = self.state is not None and 0 < (frame.t_us - self.state.t_us) % WRAP < WRAP // 2
        if step >= 0x8000 and not later:
            self.counters.out_of_order += 1
            return False
        self._seq = frame.seq
        self.counters.lost += step - 1
        return True

    def _detect_restart(self, frame: State | Hello, now: int) -> None:
        """Forget a board that has restarted, disarm, and request HELLO."""
        if isinstance(frame, Hello) and self._boot_id not in (None, frame.boot_id):
            reason = 'it has a new boot_id'
        elif self._clock_restarted(frame, now):
            reason = 'its clock and its sequence numbers restarted'
        else:
            return
        self.counters.restarts += 1
        self.output.report(Level.WARN, f'the board restarted: {reason}')
        self.motor.stop('the board restarted', now)
        self._forget_board()
        self._ask(now)

    def _clock_restarted(self, frame: State | Hello, now: int) -> bool:
        """Return whether the clock went back without a wrap, in a frame that does not follow the last frame."""
        if self.state is None or (self._seq is not None and frame.seq == (self._seq + 1) & 0xFFFF):
            return False
        if self.state.t_us - frame.t_us <= SETTINGS.clock_back_us:
            return False
        # A clock that wrapped has advanced by at most the time since the last STATE was sampled (not: read).
        elapsed_us = (now - self._state_taken) * 1e-3 * (1 + SETTINGS.clock_tolerance)
        return (frame.t_us - self.state.t_us) % WRAP > elapsed_us + SETTINGS.clock_back_us

    def _counts_per_turn(self, hello: Hello | None) -> tuple[int, int]:
        """Return the configured counts per turn, or else the board's; 0 if both are unknown."""
        first, second = self.config.counts_per_turn
        return first or (hello.cpr1 if hello else 0), second or (hello.cpr2 if hello else 0)

    @property
    def _silence_ns(self) -> int:
        # The measured period: a wrong period in HELLO must not delay the detection of a lost link.
        period_us = self._period_us or (self.hello.sample_period_us if self.hello else 0)
        periods = round(SETTINGS.silent_periods * period_us * 1000)
        if self.armed:
            periods = min(periods, max(self.motor.watchdog_ns, SETTINGS.longest_unseen))
        return max(round(self.config.link_timeout * SECOND), periods)

    def _ask(self, now: int) -> None:
        self._asking = True
        self._unanswered += 1
        self._last_request = now
        self.output.send(HelloRequest, now)


def _introduction(hello: Hello) -> str:
    """Return the contents of HELLO as a sentence."""
    return (
        f'board {hello.firmware!r}: {hello.cpr1} and {hello.cpr2} counts per turn, a sample every '
        f'{hello.sample_period_us / 1000:g} ms, torque limit {hello.torque_limit / 1e6:g} N m'
    )
