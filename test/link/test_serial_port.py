# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A real port on a real pseudo-terminal: reading, reopening, exclusive use; benchmarks/faults has lost ports."""

import errno
import os
import pty
import select
import threading
import time
import tty
from functools import partial

import pytest
import serial

from pendubot_identification.errors import LinkError
from pendubot_identification.link.protocol import Decoder, State, Status, encode
from pendubot_identification.link.pty_server import PtyServer
from pendubot_identification.link.serial_port import FrameWriter, SerialPort
from pendubot_identification.link.virtual_board import VirtualBoard
from pendubot_identification.model.parameters import PAPER
from pendubot_identification.model.simulation import Plant
from test.processes import Program, until


class Receiver:
    """Collects the data and events of a link."""

    def __init__(self, port):
        self.data, self.arrivals, self.opened, self.closed = b'', [], False, []
        self._changed = threading.Condition()
        opened = partial(self._change, opened=True)
        self.link = SerialPort(str(port), 115200, self._on_bytes, opened, self._on_closed)

    def __enter__(self):
        self.link.start()
        return self

    def __exit__(self, *_):
        self.link.close()

    def _change(self, **fields):
        with self._changed:
            vars(self).update(fields)
            self._changed.notify_all()

    def _on_bytes(self, data, arrival):
        self._change(data=self.data + data, arrivals=[*self.arrivals, arrival])

    def _on_closed(self, reason):
        self._change(closed=[*self.closed, reason])

    def wait(self, condition):
        with self._changed:
            assert self._changed.wait_for(lambda: condition(self), 10.0), vars(self)


class Pty:
    """A pseudo-terminal behind a symbolic link, like a device behind a udev link."""

    def __init__(self, link):
        self.master, slave = pty.openpty()
        tty.setraw(slave)
        self.slave = os.ttyname(slave)
        self.link = link
        link.unlink(missing_ok=True)
        link.symlink_to(self.slave)
        os.close(slave)

    def unplug(self):
        self.link.unlink()
        os.close(self.master)


@pytest.fixture
def port(tmp_path):
    return tmp_path / 'board'


def test_bytes_are_received_with_arrival_times_and_sent_and_stale_ones_are_discarded(port):
    device = Pty(port)
    os.write(device.master, b'stale' * 1000)
    with Receiver(port) as receiver:
        receiver.wait(lambda e: e.opened)
        before = time.monotonic_ns()
        os.write(device.master, b'\x00hello\r\n\x03\x11\x13')
        receiver.wait(lambda e: e.data == b'\x00hello\r\n\x03\x11\x13')
        assert before <= receiver.arrivals[0] <= time.monotonic_ns()
        assert receiver.link.write(b'\x00out\r\n\x04')
        assert os.read(device.master, 100) == b'\x00out\r\n\x04'
        device.unplug()


def test_the_arrival_time_of_bytes_is_never_before_their_sending(port, monkeypatch):
    """More bytes arrive between waking up and reading."""
    device, sent = Pty(port), []
    read = os.read

    def late(descriptor, size):
        if not sent:
            os.write(device.master, b'second')
            sent.append(time.monotonic_ns())
        return read(descriptor, size)

    with Receiver(port) as receiver:
        receiver.wait(lambda e: e.opened)
        monkeypatch.setattr('pendubot_identification.link.serial_port.os.read', late)
        os.write(device.master, b'first')
        receiver.wait(lambda e: e.data == b'firstsecond')
        assert receiver.arrivals[-1] >= sent[0]


def forbidden(*_, **__):
    """Fail like opening without permission, also for root."""
    raise serial.SerialException(errno.EACCES, 'could not open port')


#: For wrong names pyserial raises various exceptions, such as re.error and KeyError.
WRONG = '/dev/null', __file__, 'nonsense://x', 'hwgrep://[', 'loop://x?foo=1'


@pytest.mark.parametrize(
    ('trouble', 'text'),
    [
        ('busy', '(process {})'),
        ('forbidden', 'dialout'),
        ('missing', 'port'),
        *((wrong, f'the port {wrong} cannot be opened (') for wrong in WRONG),
    ],
)
def test_an_unusable_port_is_reported_once_with_the_remedy_and_opened_later(port, monkeypatch, trouble, text):
    device, tried, true_open = Pty(port), threading.Semaphore(0), serial.serial_for_url
    holder = serial.Serial(str(port), exclusive=True) if trouble == 'busy' else None
    path = trouble if trouble in WRONG else port
    if trouble == 'missing':
        port.unlink()
    present = forbidden if trouble == 'forbidden' else true_open

    def opening(_, *args, **given):
        tried.release()
        return present(str(path), *args, **given)

    monkeypatch.setattr(serial, 'serial_for_url', opening)
    with Receiver(path) as receiver:
        assert all(tried.acquire(timeout=10) for _ in range(3))
        if holder:
            holder.close()
        if trouble == 'missing':
            port.symlink_to(device.slave)
        path, present = port, true_open
        receiver.wait(lambda e: e.opened)
        (reason,) = receiver.closed
        assert trouble in reason
        assert text.format(os.getpid()) in reason
        assert '; ' in reason, 'the remedy'
        device.unplug()


def test_a_truncated_frame_does_not_damage_the_next(port):
    device = Pty(port)
    host = os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    writer, decoder, received = FrameWriter(host), Decoder(), []

    def receive(count):
        while len(received) < count:
            assert select.select([device.master], [], [], 10)[0]
            received.extend(e.seq for e in decoder.feed(os.read(device.master, 4096)) if isinstance(e, State))

    frames = [encode(State(k, 0, -1, -1, -1, -1, 1, 1, 1)) for k in range(2000)]
    whole = [k for k, frame in enumerate(frames) if writer.write(frame)]
    assert len(whole) < len(frames)
    receive(len(whole))
    assert writer.write(frames[0])
    receive(len(whole) + 1)
    os.close(host)
    assert received == [*whole, 0]
    device.unplug()


# The other end


def test_the_board_reports_an_overrun_while_the_host_does_not_read(port, tmp_path, each_board):
    trace = tmp_path / 'trace.csv'

    def overrun(since=0):
        return f',{Status.OVERRUN}\n' in trace.read_text()[since:]

    with Program('virtual_board', '--link', port, '--rate', 1000, '--trace', trace) as board:
        board.wait_for('virtual board on')
        until(overrun)  # without a reader
        device = os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        opened = len(trace.read_text())
        until(lambda: ',0\n' in trace.read_text()[opened:])
        begun = len(trace.read_text())
        until(lambda: overrun(begun))
        os.close(device)


def test_a_stale_link_is_replaced_and_anything_else_is_not(tmp_path):
    board = VirtualBoard(Plant(PAPER))
    stale, taken = tmp_path / 'stale', tmp_path / 'taken'
    stale.symlink_to('/dev/pts/99999')
    with PtyServer(board, stale):
        assert os.path.exists(stale)
    assert not stale.is_symlink()
    taken.write_text('precious')
    with pytest.raises(LinkError, match='no link to a pty'):
        PtyServer(board, taken)
    assert taken.read_text() == 'precious'
    with pytest.raises(LinkError, match='exists already'):
        PtyServer(board, None, taken)
    with pytest.raises(LinkError, match='cannot be made'):
        PtyServer(board, tmp_path / 'nowhere' / 'link')
