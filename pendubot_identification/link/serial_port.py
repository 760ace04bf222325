# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The serial port on the host's side: a thread reads it, and reopens it after every loss."""

import contextlib
import errno
import fcntl
import os
import select
import termios
import threading
import time
from collections.abc import Callable
from pathlib import Path

import serial

#: Interval of attempts to open a failed or missing port [s].
RETRY = 0.02

#: Timeout of one read [s]; closing the port takes at most this time.
_READ_TIMEOUT = 0.05
#: Time with a full buffer after which the device counts as lost [s].
_WRITE_TIMEOUT = 0.02

#: Reasons why a port could not be opened, each with the correction.
_MISSING = 'is missing; connect the board, or set port to its path'
_BUSY = 'is busy'
_FORBIDDEN = 'is forbidden to this user; add the user to the group dialout (sudo adduser $USER dialout), log in again'
_UNUSABLE = 'cannot be opened ({}); set port to a serial port or a pyserial URL'
_TROUBLES = dict.fromkeys((errno.ENOENT, errno.ENXIO, errno.ENODEV), _MISSING)
_TROUBLES |= dict.fromkeys((errno.EBUSY, errno.EAGAIN), _BUSY) | dict.fromkeys((errno.EACCES, errno.EPERM), _FORBIDDEN)


class SerialPort:
    """A serial port that its own thread reads from :meth:`start` until :meth:`close`.

    The thread calls ``on_bytes`` with the bytes and their arrival [ns, time.monotonic_ns], and ``on_opened`` after the
    port was opened. It calls ``on_closed`` with a message after a loss, and after a failure to open for a new reason.
    ``port`` is a path or a pyserial URL.
    """

    def __init__(
        self,
        port: str,
        baud: int,
        on_bytes: Callable[[bytes, int], None],
        on_opened: Callable[[], None],
        on_closed: Callable[[str], None],
    ) -> None:
        self._port = port
        self._baud = baud
        self._on_bytes = on_bytes
        self._on_opened = on_opened
        self._on_closed = on_closed
        self._write: Callable[[bytes], bool] | None = None
        self._lock = threading.Lock()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name='serial port', daemon=True)

    def start(self) -> None:
        """Start the thread, which opens and reads the port."""
        self._thread.start()

    def write(self, data: bytes) -> bool:
        """Write at once, from any thread; return whether all bytes were written, which a closed port refuses."""
        with self._lock, contextlib.suppress(OSError, termios.error):
            return self._write is not None and self._write(data)
        return False

    def close(self) -> None:
        """Stop the thread and close the port; bytes already written are still transmitted."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join(2.0)

    def _run(self) -> None:
        reported = ''
        while not self._stopping.is_set():
            try:
                device = open_port(self._port, self._baud)
            except Exception as error:
                unusable = _UNUSABLE.format(str(error) or type(error).__name__)
                trouble = _TROUBLES.get(getattr(error, 'errno', None) or 0, unusable)
                # Only for a new reason: the search for the program that holds a busy port is slow.
                if trouble != reported:
                    reported = trouble
                    holders = f': {_holders(self._port)} holds it; end that program' if trouble == _BUSY else ''
                    self._on_closed(f'the port {self._port} {trouble}{holders}')
                self._stopping.wait(RETRY)
                continue
            with self._lock:
                self._write = _writer(device)
            self._on_opened()
            reason = self._read(device)
            with self._lock:
                self._write = None
                device.close()
            if not self._stopping.is_set():
                self._on_closed(f'the port {self._port} was lost ({reason}); it is opened again when it returns')
                # The loss is reported; do not report the missing port, too.
                reported = _MISSING
                self._stopping.wait(RETRY)

    def _read(self, device: serial.SerialBase) -> str:
        """Read until the port fails or is closed; return the reason."""
        while not self._stopping.is_set():
            try:
                data = _wait_and_read(device)
                # After the read: it returns bytes that arrived while this process waited for the processor, and an
                # earlier time would precede their transmission.
                arrival = time.monotonic_ns()
            except (OSError, termios.error) as error:
                return str(error)
            if data:
                self._on_bytes(data, arrival)
        return 'closed'


def open_port(port: str, baud: int) -> serial.SerialBase:
    """Open a port exclusively and drop its buffered bytes.

    Raises:
        OSError, termios.error, ValueError: it is missing, busy, forbidden, or no serial port.
        Exception: an invalid pyserial URL, such as re.error or KeyError.
    """
    device = serial.serial_for_url(port, baud, timeout=_READ_TIMEOUT, write_timeout=_WRITE_TIMEOUT, exclusive=True)
    if not isinstance(device, serial.Serial):
        return device
    try:
        # pyserial's lock is advisory; this one excludes all programs. Not on a pty: there it would remain after a crash
        # while the other end is open, and exclude the next bridge.
        if not os.ttyname(device.fd).startswith('/dev/pts/'):
            fcntl.ioctl(device.fd, termios.TIOCEXCL)
    except (OSError, termios.error):
        device.close()
        raise
    # Some drivers lack the low-latency mode; then several frames may arrive together.
    with contextlib.suppress(AttributeError, NotImplementedError, ValueError, OSError):
        device.set_low_latency_mode(True)
    return device


def _writer(device: serial.SerialBase) -> Callable[[bytes], bool]:
    if isinstance(device, serial.Serial):
        return FrameWriter(device.fd).write
    return lambda data: device.write(data) == len(data)


def _wait_and_read(device: serial.SerialBase) -> bytes:
    """Wait for bytes; return the buffered bytes, or none after the timeout."""
    data = b''
    if not isinstance(device, serial.Serial):
        data = device.read(1)
        data += device.read(device.in_waiting) if data else b''
    # Without pyserial, whose reads at 1 kHz cost as much as the rest of the bridge.
    elif select.select([device.fd], [], [], _READ_TIMEOUT)[0]:
        with contextlib.suppress(BlockingIOError):
            data = os.read(device.fd, 4096)
            if not data:
                raise OSError(errno.ENODEV, 'the device is gone')
    return data


def _holders(port: str) -> str:
    """Return the names of this user's programs that have a device open, as ``name (process 123)``."""
    device = Path(port).resolve()
    holders = []
    for process in Path('/proc').glob('[0-9]*'):
        # Processes may end in the meantime, and other users' processes are not readable.
        with contextlib.suppress(OSError):
            if any(descriptor.resolve() == device for descriptor in (process / 'fd').iterdir()):
                holders.append(f'{(process / "comm").read_text().strip()} (process {process.name})')
    return ' and '.join(holders) or f'a program of another user (sudo fuser -v {port} names it)'


class FrameWriter:
    """Writes frames to a non-blocking descriptor, or drops them, because a late torque or sample is useless."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._cut = False

    def write(self, data: bytes) -> bool:
        """Write at once; return whether all bytes were written. Raises OSError: the device is gone."""
        # A delimiter ends a truncated frame; otherwise the next frame would be lost with it.
        data = b'\0' + data if self._cut else data
        sent = 0
        with contextlib.suppress(BlockingIOError):
            sent = os.write(self._descriptor, data)
        complete = sent == len(data)
        self._cut = not complete and (self._cut or sent > 0)
        return complete
