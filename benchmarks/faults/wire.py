# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Emulated serial wires with faults, numbered samples, and random damage of frames."""

import contextlib
import os
import pty
import select
import threading
import tty

from pendubot_identification.link.protocol import Decoder, Hello, Limits, State, encode

#: Counts per turn, and largest torque [micro-N m], of the emulated board.
CPR, LIMIT = 4000, 1_500_000


def hello(seq, t_us, boot_id=77):
    return Hello(seq, t_us, boot_id, 1, 0, 500, CPR, CPR, LIMIT, 1000, 0, 0, 0, Limits(max_speed=100_000), 'trial')


def numbered_state(k):
    """Return sample ``k`` of a motion whose samples encode their number."""
    return State(k & 0xFFFF, 1000 * k % 2**32, k, -2 * k, scrambled(k), 0, 2400, 0, 0)


def scrambled(k):
    """Return a torque that differs from the torques of nearby samples [micro-N m]."""
    return k * 2654435761 % 1_000_003


def damage(frame, rng):
    """Return a frame with one bit flipped, one byte dropped, or one byte doubled (a delimiter may be)."""
    data = bytearray(frame)
    kind, index = rng.integers(3), int(rng.integers(len(frame)))
    if kind == 0:
        data[index] ^= 1 << int(rng.integers(8))
    elif kind == 1:
        del data[index]
    else:
        data.insert(index, data[index])
    return bytes(data)


class Tap:
    """Both wires between a board and a host; they can be cut, rewritten, or written to by a third program.

    Args:
        board: path of the board's port.
        link: path of the port for the host.

    Attributes:
        cut: the wires that are cut: ``to_host``, ``to_board``.
        rewrite: function that replaces each message of the board; None passes the bytes on.
    """

    def __init__(self, board, link):
        self.cut, self.rewrite = set(), None
        self._board = os.open(board, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(self._board)
        self._host, slave = pty.openpty()
        tty.setraw(slave)
        link.symlink_to(os.ttyname(slave))
        self._slave = slave  # stays open, so that hosts can reconnect
        os.set_blocking(self._host, False)
        self._ended = threading.Event()
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._carry, daemon=True)
        self._thread.start()

    def inject(self, *messages):
        """Write to the board like another program on the port, between two frames."""
        data = b'\0' + b''.join(map(encode, messages))
        with self._lock:
            os.write(self._board, data)

    def _carry(self):
        decoder, frame = Decoder(), b''
        while not self._ended.is_set():
            ready, _, _ = select.select([self._board, self._host], [], [], 0.05)
            if self._host in ready:
                frame += os.read(self._host, 4096)
                whole, found, rest = frame.rpartition(b'\0')
                frame = rest
                if 'to_board' not in self.cut:
                    with self._lock:
                        os.write(self._board, whole + found)
            if self._board in ready:
                data = os.read(self._board, 4096)
                events = decoder.feed(data)
                if 'to_host' not in self.cut:
                    heard = data
                    if self.rewrite is not None:
                        heard = b''.join(encode(self.rewrite(e)) for e in events if isinstance(e, (State, Hello)))
                    # A host that does not read loses bytes that no longer fit, as on a serial line.
                    with contextlib.suppress(BlockingIOError):
                        os.write(self._host, heard)

    def close(self):
        self._ended.set()
        self._thread.join()
        for file in (self._board, self._host, self._slave):
            os.close(file)
