# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Sequence numbers (u16, wrapping): checked in the frames that the host hears, given to those that it sends."""

from __future__ import annotations

from .clock import WRAP
from .events import Counters
from .protocol import Command, HelloRequest, Message, Mode, encode


class Sequence:
    """Accounts for the numbers of the frames that come.

    Args:
        counters: where it counts frames that are lost, that come twice in a row, and that come after a later one. One
            that comes too late stays lost, since it is not used.
    """

    def __init__(self, counters: Counters) -> None:
        self._counters = counters
        self._last: int | None = None
        self._gap = False
        self._lost_in_gap = 0

    def begin(self) -> None:
        """Forget the last number: the sender begins anew. So nothing was lost in a gap that is not confirmed."""
        self._counters.lost -= self._lost_in_gap
        self._lost_in_gap = 0
        self._last = None

    def allow_gap(self) -> None:
        """Take the next frame as later than the last: during a silence the numbers may go more than half round."""
        self._gap = True

    def confirm_gap(self) -> None:
        """Note that the sender is the same as before the gap: what is missing was lost."""
        self._lost_in_gap = 0

    def follows(self, seq: int) -> bool:
        """Tell whether this is the next number, or the first."""
        return self._last is None or seq == (self._last + 1) & 0xFFFF

    def accept(self, seq: int, later: bool = False) -> bool:
        """Count a frame; return whether to use it: it is neither a duplicate nor too late.

        ``later`` says that it was sent after the last: during a silence the numbers may go more than half round.
        """
        step = 1 if self._last is None else (seq - self._last) & 0xFFFF
        if step == 1 and not self._gap:
            self._last = seq
            return True
        if step == 0:
            self._counters.duplicates += 1
            return False
        if not (self._gap or later) and step >= 0x8000:
            self._counters.out_of_order += 1
            return False
        missing = (step - 1) & 0xFFFF
        if self._gap:
            self._lost_in_gap = missing
        self._gap = False
        self._last = seq
        self._counters.lost += missing
        return True


class Transmitter:
    """Numbers, stamps and encodes what the host sends, and keeps it until it is taken; nothing while not ``open``.

    Attributes:
        open: whether there is a port to write to.
        seq: number of the last frame.
    """

    def __init__(self, counters: Counters) -> None:
        self.open = False
        self.seq = 0
        self._counters = counters
        self._out = bytearray()

    def request_hello(self, now: int) -> None:
        """Ask the board who it is, at ``now`` [ns]."""
        self._send(HelloRequest(self._next(), now // 1000 % WRAP))

    def command(self, mode: Mode, torque: int, watchdog_ms: int, now: int) -> None:
        """Command a torque [micro-N m] or disarm, at ``now`` [ns]."""
        self._send(Command(self._next(), now // 1000 % WRAP, mode, watchdog_ms, torque))

    def take(self) -> bytes:
        """Return all that has to be written to the port since the last call."""
        if not self._out:
            return b''
        data = bytes(self._out)
        self._out.clear()
        return data

    def clear(self) -> None:
        """Drop what was not taken."""
        self._out.clear()

    def _next(self) -> int:
        self.seq = (self.seq + 1) & 0xFFFF
        return self.seq

    def _send(self, message: Message) -> None:
        if self.open:
            self._out += encode(message)
            self._counters.sent += 1
