# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The serial port on the host's side: a thread reads it, and opens it again whenever it was lost."""

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

#: A port that failed or is missing is tried again this often [s].
RETRY = 0.02

#: A silent port is checked this often [s]; closing waits for the thread at most so long.
_READ_TIMEOUT = 0.05
#: A device whose buffer takes nothing for so long [s] is gone.
_WRITE_TIMEOUT = 0.02

_MISSING, _BUSY, _FORBIDDEN = 'missing', 'busy', 'forbidden'
_TROUBLES = dict.fromkeys((errno.ENOENT, errno.ENXIO, errno.ENODEV), _MISSING)
_TROUBLES |= dict.fromkeys((errno.EBUSY, errno.EAGAIN), _BUSY) | dict.fromkeys((errno.EACCES, errno.EPERM), _FORBIDDEN)


class SerialPort:
    """A port, read by a thread of its own from :meth:`start` until :meth:`close`.

    The thread calls ``on_bytes`` with what arrived and when [ns, time.monotonic_ns], ``on_opened`` after the port was
    opened, and ``on_closed`` with a sentence when it was lost, or could not be opened for another reason than the last
    time. ``port`` is a path, or any URL that pyserial understands.
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
        """Begin to open and read."""
        self._thread.start()

    def write(self, data: bytes) -> bool:
        """Write at once, from any thread; return whether all of it went out. A closed port takes nothing."""
        with self._lock, contextlib.suppress(OSError, termios.error):
            return self._write is not None and self._write(data)
        return False

    def close(self) -> None:
        """Stop the thread and close the port; what was written still goes out."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join(2.0)

    def _run(self) -> None:
        reported = ''
        while not self._stopping.is_set():
            try:
                device = open_port(self._port, self._baud)
            except Exception as error:
                trouble = _TROUBLES.get(getattr(error, 'errno', None) or 0, str(error) or type(error).__name__)
                # Only for new trouble: to find who holds a busy port takes a while.
                if trouble != reported:
                    reported = trouble
                    self._on_closed(_sentence(self._port, trouble))
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
                # That it is missing now is not reported too.
                reported = _MISSING
                self._stopping.wait(RETRY)

    def _read(self, device: serial.SerialBase) -> str:
        """Read until the port fails, and return why, or until the link is closed."""
        while not self._stopping.is_set():
            try:
                data = _wait_and_read(device)
                # Only now: while this process waits for the processor more may come, is read too, and must not seem to
                # have arrived before it was sent.
                arrival = time.monotonic_ns()
            except (OSError, termios.error) as error:
                return str(error)
            if data:
                self._on_bytes(data, arrival)
        return 'closed'


def open_port(port: str, baud: int) -> serial.SerialBase:
    """Open a port for this program alone; what came before is dropped.

    Raises:
        OSError, termios.error, ValueError: it is missing, busy, forbidden, or no serial port.
        Exception: a URL that pyserial does not understand, such as re.error or KeyError.
    """
    device = serial.serial_for_url(port, baud, timeout=_READ_TIMEOUT, write_timeout=_WRITE_TIMEOUT, exclusive=True)
    if not isinstance(device, serial.Serial):
        return device
    try:
        # pyserial's lock stops only programs that ask for it; this stops all. Not on a pty: there it would stay after a
        # crash, as long as the other end is open, and stop the next bridge.
        if not os.ttyname(device.fd).startswith('/dev/pts/'):
            fcntl.ioctl(device.fd, termios.TIOCEXCL)
    except (OSError, termios.error):
        device.close()
        raise
    # Not every driver has it; without it several frames may come together.
    with contextlib.suppress(AttributeError, NotImplementedError, ValueError, OSError):
        device.set_low_latency_mode(True)
    return device


def _writer(device: serial.SerialBase) -> Callable[[bytes], bool]:
    if isinstance(device, serial.Serial):
        return FrameWriter(device.fd).write
    return lambda data: device.write(data) == len(data)


def _wait_and_read(device: serial.SerialBase) -> bytes:
    """Wait for bytes; return all that are there, none after a while."""
    data = b''
    if not isinstance(device, serial.Serial):
        data = device.read(1)
        data += device.read(device.in_waiting) if data else b''
    # Not through pyserial: at 1 kHz its reading costs as much as all the rest of the bridge.
    elif select.select([device.fd], [], [], _READ_TIMEOUT)[0]:
        with contextlib.suppress(BlockingIOError):
            data = os.read(device.fd, 4096)
            if not data:
                raise OSError(errno.ENODEV, 'the device is gone')
    return data


def _sentence(port: str, trouble: str) -> str:
    """Return why a port could not be opened, and what to do."""
    if trouble == _MISSING:
        return f'the port {port} is missing; plug the board in, or set port to where it is'
    if trouble == _BUSY:
        names = ' and '.join(_holders(port)) or f'a program of another user (sudo fuser -v {port} names it)'
        return f'the port {port} is busy: {names} holds it; end that program'
    if trouble == _FORBIDDEN:
        remedy = 'add the user to the group dialout (sudo adduser $USER dialout) and log in again'
        return f'the port {port} is forbidden to this user; {remedy}'
    return f'the port {port} cannot be opened ({trouble}); set port to a serial port or a pyserial URL'


def _holders(port: str) -> list[str]:
    """Return, as ``name (process 123)``, the programs that have a device open; those of other users stay hidden."""
    device = Path(port).resolve()
    found = []
    for process in Path('/proc').glob('[0-9]*'):
        # Processes come and go meanwhile, and those of others may not be looked into.
        with contextlib.suppress(OSError):
            if any(descriptor.resolve() == device for descriptor in (process / 'fd').iterdir()):
                found.append(f'{(process / "comm").read_text().strip()} (process {process.name})')
    return found


class FrameWriter:
    """Writes frames to a descriptor that does not block, or drops them: a late torque or sample is of no use."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._cut = False

    def write(self, data: bytes) -> bool:
        """Write at once; return whether all of it went out.

        Raises:
            OSError: the device is gone.
        """
        # After a frame that was cut short a delimiter ends it: else the next one would be lost with it.
        data = b'\0' + data if self._cut else data
        sent = 0
        with contextlib.suppress(BlockingIOError):
            sent = os.write(self._descriptor, data)
        complete = sent == len(data)
        self._cut = not complete and (self._cut or sent > 0)
        return complete
