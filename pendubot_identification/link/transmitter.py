"""What the host sends: numbered, stamped, encoded, and kept until it is fetched."""

from __future__ import annotations

from .clock import WRAP
from .protocol import Command, HelloRequest, Message, Mode, encode


class Transmitter:
    """The host's direction of the link; while it is not ``open`` nothing is kept.

    Attributes:
        open: whether there is a port to write to.
        seq: number of the last frame.
        sent: frames that were handed out for sending.
    """

    def __init__(self) -> None:
        self.open = False
        self.seq = 0
        self.sent = 0
        self._out = bytearray()

    def request_hello(self, now: int) -> None:
        """Ask the board who it is, at ``now`` [ns]."""
        self._send(HelloRequest(self._next(), now // 1000 % WRAP))

    def command(self, mode: Mode, torque: int, watchdog_ms: int, now: int) -> None:
        """Command a torque [micro-N m] or disarm, at ``now`` [ns]."""
        self._send(Command(self._next(), now // 1000 % WRAP, mode, watchdog_ms, torque))

    def take(self) -> bytes:
        """Return, once, what has to be written to the port."""
        if not self._out:
            return b''
        data = bytes(self._out)
        self._out.clear()
        return data

    def clear(self) -> None:
        """Forget what was not fetched."""
        self._out.clear()

    def _next(self) -> int:
        self.seq = (self.seq + 1) & 0xFFFF
        return self.seq

    def _send(self, message: Message) -> None:
        if self.open:
            self._out += encode(message)
            self.sent += 1
