# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The host's side of the protocol as a state machine: bytes and time in, samples, reports and bytes out.

Nothing here reads a clock or a port. Every method that something can follow from takes the present time ``now`` [ns, of
any clock that never goes back] and returns events; what has to be written to the board is fetched by
:meth:`Host.data_to_send` afterwards.

A STATE's way: :meth:`Host.receive` has the bytes decoded, its number is checked (``sequence``), the motor reacts to its
status (``motor``), its time is mapped to the host's (``clock``), its counts become positions and velocities
(``joints``), and a :class:`.events.Sample` is returned.
"""

from __future__ import annotations

import math

from pendubot_identification.level import Level

from .clock import MS, SECOND, WRAP, BoardClock
from .events import ArmingFailed, HostConfig, HostEvent, Output, Report, Sample
from .joints import Joints
from .motor import Motor, names
from .protocol import FAULTS, Damaged, Decoder, Hello, State, Status
from .sequence import Sequence

HELLO_INTERVAL = 200 * MS
#: So many requests without an answer are reported.
UNANSWERED = 5
#: The link is lost when nothing valid came for the longer of so many sample periods and the configured time.
SILENT_PERIODS = 5
#: Who polls so late [ns] was held up itself.
HELD_UP = 50 * MS
#: A board whose clock went back further than this, and did not wrap, has restarted.
CLOCK_BACK_US = 10_000
#: The board's clock and the host's differ by at most this part.
FASTER = 1e-3

# As plain numbers, because a status comes a thousand times a second and IntFlag is slow.
_DAMAGED_FRAME, _OVERRUN, _FAULTS = int(Status.DAMAGED_FRAME), int(Status.OVERRUN), int(FAULTS)


class Host:
    """The host's end of one link.

    It starts with the port closed and disarmed, and arms only by :meth:`arm`; any loss of the link, restart, trip or
    fault disarms it.

    ``state`` is the last STATE that was accepted; None before the first.
    """

    def __init__(self, config: HostConfig | None = None) -> None:
        self.config = config or HostConfig()
        self._output = Output()
        self.counters = self._output.counters
        self.clock = BoardClock()
        self.state: State | None = None
        self._decoder = Decoder()
        self._sequence = Sequence(self.counters)
        self._joints = Joints(self.config, self._output)
        self._motor = Motor(self.config, self._output)
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
        self._unusable = ''  # why its HELLO cannot be used
        self._asking = False
        self._last_request = 0
        self._unanswered = 0
        self._state_arrival = 0  # [ns]
        self._state_taken = 0  # host time at which the board took the last STATE [ns]

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
    def link(self) -> str:
        """``up``, ``silent`` (the port is open, but nothing valid comes), or ``closed``."""
        if not self._output.open:
            return 'closed'
        return 'up' if self._up else 'silent'

    def age(self, now: int) -> float:
        """Return how long ago [s] the last STATE came; NaN before the first."""
        return (now - self._state_arrival) / SECOND if self.state else math.nan

    def next_poll(self, now: int) -> float:
        """Return how soon [s] :meth:`poll` has to be called again, whatever else is called in between."""
        return self._motor.next_poll(now) / SECOND

    def condition(self) -> Report:
        """Return the worst of what is wrong now, or whether it is armed when all is well."""
        status = self.state.status if self.state else 0
        if not self._output.open:
            return Report(Level.ERROR, self._closed_because)
        if not self._up:
            return Report(Level.ERROR, 'no valid sample comes from the board')
        if status & _FAULTS:
            return Report(Level.ERROR, names(status & _FAULTS))
        if self.hello is None:
            waiting = Report(Level.WARN, 'waiting for the board to say HELLO')
            return Report(Level.ERROR, self._unusable) if self._unusable else waiting
        if status & Status.WATCHDOG:
            return Report(Level.WARN, "the board's watchdog tripped; arm again")
        if self._motor.effort_stopped:
            return Report(Level.WARN, 'armed at torque 0: no effort command comes')
        if self._motor.lost:
            return Report(Level.WARN, f'disarmed: {self._motor.lost}; arm again when it is safe')
        return Report(Level.OK, 'armed' if self.armed else 'disarmed')

    def data_to_send(self) -> bytes:
        """Return all that has to be written to the port since the last call."""
        data, self._output.data = self._output.data, b''
        return data

    # The link

    def opened(self, now: int) -> list[HostEvent]:
        """Note that the port was opened; ask who is there: it need not be the board that was there before."""
        self._decoder = Decoder()
        self._sequence.allow_gap()
        self._output.open = True
        # A delimiter, or a frame that another host left unfinished would take the first one along.
        self._output.data = b'\0'
        self._up, self._fell_silent = False, False
        self._motor.board = None
        self._unanswered = 0
        self._ask(now)
        return self._output.take_events()

    def closed(self, reason: str, now: int) -> list[HostEvent]:
        """Note that the port failed or could not be opened; ``reason`` is a sentence for the user."""
        # Not reported again where it fails for the same reason before anything was heard.
        if self._heard or reason != self._closed_because:
            self._output.report(Level.ERROR, reason)
        self.counters.link_losses += self._up
        self._output.open, self._up, self._heard = False, False, False
        self._closed_because = reason
        self._motor.stop('the link was lost', now)
        self._output.data = b''
        return self._output.take_events()

    def receive(self, data: bytes, now: int) -> list[HostEvent]:
        """Take bytes that arrived at ``now`` [ns]."""
        for event in self._decoder.feed(data):
            if isinstance(event, Damaged):
                damaged = self.counters.damaged
                damaged[event.reason] = damaged.get(event.reason, 0) + 1
                continue
            self.counters.received += 1
            self._heard = True
            self._last_valid = now
            if isinstance(event, State):
                if self._fell_silent:
                    self._output.report(Level.OK, 'the board is heard again')
                self._up, self._fell_silent = True, False
                self._on_state(event, now)
            elif isinstance(event, Hello):
                # A board that stopped sampling may still answer: after a silence only a sample shows that it is back.
                self._up = not self._fell_silent
                self._on_hello(event, now)
        self._motor.poll(now)
        return self._output.take_events()

    def poll(self, now: int) -> list[HostEvent]:
        """Do what is due: requests, timeouts, repeated commands. To be called as soon as :meth:`next_poll` says."""
        # After this program itself was held up, what came meanwhile has to be read before the link counts as lost.
        held_up = not self._held_up and self._last_poll is not None and now - self._last_poll > HELD_UP
        self._last_poll, self._held_up = now, held_up
        if self._up and not held_up and now - self._last_valid > self._silence_ns:
            self._up, self._fell_silent = False, True
            self.counters.link_losses += 1
            self._output.report(Level.ERROR, f'link lost: nothing valid for {(now - self._last_valid) / SECOND:.2f} s')
            self._motor.stop('the link was lost', now)
            self._sequence.allow_gap()
            self._ask(now)
        elif self._output.open and self._asking and now - self._last_request >= HELLO_INTERVAL:
            if self._unanswered == UNANSWERED:
                text = f'the board did not answer {UNANSWERED} requests; check port, baud and wiring'
                self._output.report(Level.WARN, text)
            self._ask(now)
        self._motor.poll(now)
        return self._output.take_events()

    # The motor

    def arm(self, now: int) -> list[HostEvent]:
        """Begin to arm; :class:`Armed` or :class:`ArmingFailed` follows, here or within 0.5 s."""
        if self._up:
            self._motor.arm(self.state, now)
        else:
            self._output.tell(ArmingFailed(f'no board: {self.condition().text}'))
        return self._output.take_events()

    def disarm(self, now: int) -> list[HostEvent]:
        """Disarm the board, whatever it is doing."""
        self._motor.stop('disarmed on request', now, wanted=True)
        return self._output.take_events()

    def effort(self, torque: float, now: int) -> list[HostEvent]:
        """Take a torque wanted at the shoulder [N m]; it is sent at once when armed, else discarded."""
        self._motor.effort(torque, now)
        return self._output.take_events()

    # What the board says

    def _on_state(self, state: State, now: int) -> None:
        if self._has_restarted(state, now):
            self._restarted('its clock and its sequence began again', now)
        if not self._sequence.accept(state.seq, self._is_later(state)):
            return
        status, before = state.status, self.state.status if self.state else 0
        self.state, self._state_arrival = state, now
        if status:
            self.counters.board_damaged += bool(status & _DAMAGED_FRAME)
            self.counters.board_overruns += bool(status & _OVERRUN)
        self._motor.follow(state, before, now)
        board_us = self.clock.observe(state.t_us, now)
        self._state_taken = self.clock.host_time(board_us)
        counts_per_turn = self._counts_per_turn(self.hello)
        if 0 in counts_per_turn:
            self.counters.unscaled += 1
            return
        moved = self._joints.update(board_us, (state.enc1, state.enc2), counts_per_turn, now)
        if moved is not None:
            self.counters.published += 1
            q, qd = moved
            self._output.tell(Sample(self.clock.stamp(self._state_taken), q, qd, state.torque / 1e6))

    def _on_hello(self, hello: Hello, now: int) -> None:
        if self._boot_id is not None and hello.boot_id != self._boot_id:
            self._restarted('it has a new boot_id', now)
        elif self._has_restarted(hello, now):
            self._restarted('its clock and its sequence began again', now)
        self._sequence.accept(hello.seq, self._is_later(hello))
        self._sequence.confirm_gap()
        self._boot_id = hello.boot_id
        self._unanswered = 0
        before, self._unusable = self._unusable, self._why_unusable(hello)
        self._asking = bool(self._unusable)
        if self._unusable:
            if self._unusable != before:
                self._output.report(Level.ERROR, self._unusable)
            return
        if self.hello is None or _introduction(hello) != _introduction(self.hello):
            self._output.report(Level.OK, _introduction(hello))
        self._motor.board = hello

    def _why_unusable(self, hello: Hello) -> str:
        """Return what in a HELLO makes no sense, and what to do; empty where all does."""
        if 0 in self._counts_per_turn(hello):
            return 'the board says 0 counts per turn; set counts_per_turn, or mend its firmware'
        if hello.torque_limit < 0:
            return f'the board says a torque limit of {hello.torque_limit / 1e6:g} N m; mend its firmware'
        return ''

    def _is_later(self, frame: State | Hello) -> bool:
        """Tell whether the board's clock went on since the last STATE; it may have wrapped."""
        return self.state is not None and 0 < (frame.t_us - self.state.t_us) % WRAP < WRAP // 2

    def _has_restarted(self, frame: State | Hello, now: int) -> bool:
        """Tell whether the clock went back, and did not wrap, in a frame that does not follow the one before."""
        if self.state is None or self._sequence.follows(frame.seq):
            return False
        if self.state.t_us - frame.t_us <= CLOCK_BACK_US:
            return False
        # A clock that wrapped has gone on by no more than the time since the last STATE was taken (not: read).
        elapsed_us = (now - self._state_taken) * 1e-3 * (1 + FASTER)
        return (frame.t_us - self.state.t_us) % WRAP > elapsed_us + CLOCK_BACK_US

    def _restarted(self, evidence: str, now: int) -> None:
        self.counters.restarts += 1
        self._output.report(Level.WARN, f'the board restarted: {evidence}')
        self._motor.stop('the board restarted', now)
        self._motor.board = None
        self._sequence.begin()
        self.clock.restart()
        self._joints.restart()
        self.state = None
        self._boot_id = None
        self._ask(now)

    def _counts_per_turn(self, hello: Hello | None) -> tuple[int, int]:
        """Return what was configured, or else what the board said; 0 where neither is known."""
        first, second = self.config.counts_per_turn
        return first or (hello.cpr1 if hello else 0), second or (hello.cpr2 if hello else 0)

    @property
    def _silence_ns(self) -> int:
        period = self.hello.sample_period_us * 1000 if self.hello else 0
        return max(round(self.config.link_timeout * SECOND), SILENT_PERIODS * period)

    def _ask(self, now: int) -> None:
        self._asking = True
        self._unanswered += 1
        self._last_request = now
        self._output.request_hello(now)


def _introduction(hello: Hello) -> str:
    """Return in a sentence what a board says about itself."""
    return (
        f'board {hello.firmware!r}: {hello.cpr1} and {hello.cpr2} counts per turn, a sample every '
        f'{hello.sample_period_us / 1000:g} ms, torque up to {hello.torque_limit / 1e6:g} N m'
    )
