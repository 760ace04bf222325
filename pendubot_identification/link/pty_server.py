# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Serves a virtual board on a pseudo-terminal, in real time; a host opens it like a serial port."""

from __future__ import annotations

import contextlib
import os
import pty
import select
import time
import tty
from collections.abc import Callable
from pathlib import Path
from typing import TextIO

from pendubot_identification.errors import LinkError
from pendubot_identification.files import writing

from .serial_port import FrameWriter
from .virtual_board import VirtualBoard

#: A patient rig stops its time after a longer delay of this process, or of the host of an armed board [ns].
PAUSE = 50_000_000

TRACE_HEADER = 't_us,enc1,enc2,torque,status'


class PtyServer:
    """A pseudo-terminal that serves a virtual board; a context manager. A host opens ``path``.

    Args:
        board: the board.
        link: symbolic link to the pty, which gives the host a constant path.
        trace: CSV file of the board's samples (t_us, counts, micro-N m, status).
        report: called with ``cable out`` when the cable is pulled, and ``cable in`` when it is back.
        patient: stop the board's time while this process is delayed and, if the board is armed, while the host is
            connected but silent. So a pause of the computer does not separate the rig from its controller.

    Raises:
        LinkError: the link or the trace exists already, or the link cannot be created.
        ResultError: the trace cannot be written; :meth:`serve` and the exit raise it, too.
    """

    def __init__(
        self,
        board: VirtualBoard,
        link: Path | None = None,
        trace: Path | None = None,
        report: Callable[[str], None] = lambda _: None,
        patient: bool = False,
    ) -> None:
        self._board = board
        self._patient = patient
        self._heard = 0
        self._report = report
        self._link = link
        self._master: int | None = None
        self._slave_path = ''
        self._trace = _create(trace) if trace else None
        self._plugged_in = True
        try:
            self._plug()
        except LinkError:
            self.__exit__()
            if trace:
                trace.unlink()
            raise
        self.path = str(link or self._slave_path)

    def __enter__(self) -> PtyServer:
        return self

    def __exit__(self, *_: object) -> None:
        self._unplug()
        if self._trace is not None:
            with writing(self._trace.name):
                self._trace.close()

    def pull(self) -> None:
        """Pull the cable in the middle of the next frame; the board keeps running. Safe in a signal handler."""
        self._plugged_in = False

    def plug(self) -> None:
        """Reconnect the cable: the link points to a new pseudo-terminal."""
        self._plugged_in = True

    def serve(self, stopped: Callable[[], bool], duration: float = float('inf')) -> None:
        """Serve until ``stopped`` returns True or ``duration`` [s] is over.

        Samples are due at multiples of the period from the start, so that delays do not accumulate.
        """
        period = self._board.settings.sample_period_us * 1000
        start = due = time.monotonic_ns()
        while not stopped() and due - start < duration * 1e9:
            wait = max(0, due - time.monotonic_ns()) * 1e-9
            self._receive(wait)
            now = time.monotonic_ns()
            waits_for_host = self._board.armed and now - self._heard > PAUSE and self._host_is_there()
            if self._patient and (now - due > PAUSE or waits_for_host):
                due = now + period
            elif now >= due:
                data = self._board.sample()
                # Before the transmission, so that the trace contains every sample that a host receives.
                self._write_trace()
                if self._master is None and self._plugged_in:
                    self._plug()
                    self._report('cable in')
                if self._plugged_in:
                    self._send(data)
                elif self._master is not None:
                    self._send(data[: len(data) // 2])
                    self._report('cable out')
                    self._unplug()
                # After the transmission, so that the computation of the motion delays no sample.
                self._board.move()
                due += period

    def _plug(self) -> None:
        self._master, slave = pty.openpty()
        if os.ttyname(slave) == self._slave_path:
            # The system returned the same path; a reconnected device has another path, so take the next.
            former = self._master, slave
            self._master, slave = pty.openpty()
            for descriptor in former:
                os.close(descriptor)
        tty.setraw(slave)
        self._slave_path = os.ttyname(slave)
        # Closed here, so that the kernel reports a connected host, and buffers nothing without a host.
        os.close(slave)
        os.set_blocking(self._master, False)
        self._writer = FrameWriter(self._master)
        self._hangup = select.poll()
        self._hangup.register(self._master, 0)
        if self._link is not None:
            _replace_link(self._link, self._slave_path)

    def _unplug(self) -> None:
        if self._master is not None:
            os.close(self._master)
            self._master = None
        if self._link is not None and self._link.is_symlink() and os.readlink(self._link) == self._slave_path:
            self._link.unlink()

    def _host_is_there(self) -> bool:
        return self._master is not None and not any(events & select.POLLHUP for _, events in self._hangup.poll(0))

    def _receive(self, wait: float) -> None:
        """Receive bytes of the host, for at most ``wait`` [s]."""
        if self._master is None:
            time.sleep(wait)
            return
        if self._host_is_there():
            select.select([self._master], [], [], wait)
        else:
            time.sleep(wait)
        # A host that disconnected may have sent bytes before; without bytes, reading fails.
        with contextlib.suppress(OSError):
            self._board.receive(os.read(self._master, 4096))
            self._heard = time.monotonic_ns()

    def _send(self, data: bytes) -> None:
        # Like a UART, do not wait for a host that does not read.
        if not (self._host_is_there() and self._writer.write(data)):
            self._board.note_overrun()

    def _write_trace(self) -> None:
        s = self._board.last
        if self._trace is not None and s is not None:
            with writing(self._trace.name):
                self._trace.write(f'{s.t_us},{s.enc1},{s.enc2},{s.torque},{s.status}\n')


def _create(trace: Path) -> TextIO:
    if trace.exists():
        raise LinkError(f'{trace} exists already; remove it or name another trace file')
    with writing(trace):
        # Line-buffered, so that the trace is complete even after a kill.
        file = trace.open('x', buffering=1, encoding='ascii')
        file.write(TRACE_HEADER + '\n')
    return file


def _replace_link(link: Path, target: str) -> None:
    """Create a symbolic link; replace the link to a pty of an earlier board."""
    stale = link.is_symlink() and (not link.exists() or os.readlink(link).startswith('/dev/pts/'))
    if not stale and (link.exists() or link.is_symlink()):
        raise LinkError(f'{link} exists and is no link to a pty; remove it or choose another --link')
    try:
        if stale:
            link.unlink()
        link.symlink_to(target)
    except OSError as error:
        raise LinkError(f'the link {link} cannot be made ({error.strerror}); choose another --link') from error
