# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A real port object on a real pseudo-terminal: read at once, opened again, held alone.

Ports that come and go, and a virtual board in real time, are in benchmarks/faults.
"""

import errno
import os
import pty
import re
import select
import threading
import time
import tty

import pytest
import serial

from pendubot_identification.errors import LinkError
from pendubot_identification.link.protocol import Decoder, State, Status, encode
from pendubot_identification.link.pty_server import PtyServer
from pendubot_identification.link.serial_port import FrameWriter, SerialPort
from pendubot_identification.link.virtual_board import VirtualBoard
from pendubot_identification.model.parameters import PAPER
from pendubot_identification.model.simulation import Plant
from test.processes import Program


class Ear:
    """Keeps what a link says, and waits for it."""

    def __init__(self, port):
        self.data, self.arrivals, self.closed, self.opened = b'', [], [], 0
        self._changed = threading.Condition()
        self.link = SerialPort(str(port), 115200, self._on_bytes, self._on_opened, self._on_closed)

    def __enter__(self):
        self.link.start()
        return self

    def __exit__(self, *_):
        self.link.close()

    def _on_bytes(self, data, arrival):
        with self._changed:
            self.data += data
            self.arrivals.append(arrival)
            self._changed.notify_all()

    def _on_opened(self):
        with self._changed:
            self.opened += 1
            self._changed.notify_all()

    def _on_closed(self, reason):
        with self._changed:
            self.closed.append(reason)
            self._changed.notify_all()

    def wait(self, condition):
        with self._changed:
            assert self._changed.wait_for(lambda: condition(self), 10.0), vars(self)


class Pty:
    """A pseudo-terminal behind a link, as a device is behind a udev link."""

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


def test_bytes_arrive_with_their_time_and_go_out_and_older_ones_are_not_heard(port):
    device = Pty(port)
    os.write(device.master, b'stale' * 1000)
    with Ear(port) as ear:
        ear.wait(lambda e: e.opened)
        before = time.monotonic_ns()
        os.write(device.master, b'\x00hello\r\n\x03\x11\x13')
        ear.wait(lambda e: e.data == b'\x00hello\r\n\x03\x11\x13')
        assert before <= ear.arrivals[0] <= time.monotonic_ns()
        assert ear.link.write(b'\x00out\r\n\x04')
        assert os.read(device.master, 100) == b'\x00out\r\n\x04'
        device.unplug()


def test_bytes_that_came_while_they_were_read_do_not_seem_to_have_come_before_they_were_sent(port, monkeypatch):
    """As when this process loses the processor between waking up and reading."""
    device, sent = Pty(port), []
    read = os.read

    def late(descriptor, size):
        if not sent:
            os.write(device.master, b'second')
            sent.append(time.monotonic_ns())
        return read(descriptor, size)

    with Ear(port) as ear:
        ear.wait(lambda e: e.opened)
        monkeypatch.setattr('pendubot_identification.link.serial_port.os.read', late)
        os.write(device.master, b'first')
        ear.wait(lambda e: e.data == b'firstsecond')
        assert ear.arrivals[-1] >= sent[0]


@pytest.mark.parametrize('wrong', ['/dev/null', __file__, 'nonsense://x', 'hwgrep://[', 'loop://x?foo=1'])
def test_what_is_no_serial_port_is_told_once_in_a_sentence_and_tried_again(port, monkeypatch, wrong):
    """pyserial raises re.error and KeyError, too."""
    device, path, tried, true_open = Pty(port), wrong, threading.Semaphore(0), serial.serial_for_url

    def opening(_, *args, **given):
        tried.release()
        return true_open(path, *args, **given)

    monkeypatch.setattr(serial, 'serial_for_url', opening)
    with Ear(wrong) as ear:
        assert all(tried.acquire(timeout=10) for _ in range(3))
        path = str(port)
        ear.wait(lambda e: e.opened)
        (said,) = ear.closed
        assert re.fullmatch(rf'the port {re.escape(wrong)} cannot be opened \(.+\); set port to .*', said)
        device.unplug()


def forbidden(*_, **__):
    """As a user may not open it; the one of these tests may be root, who may."""
    raise serial.SerialException(errno.EACCES, 'could not open port')


@pytest.mark.parametrize(('trouble', 'said'), [('busy', '(process {})'), ('forbidden', 'dialout'), ('missing', 'port')])
def test_a_port_in_trouble_is_told_once_with_its_holder_or_the_remedy_and_opened_later(
    port, monkeypatch, trouble, said
):
    device, tried, true_open = Pty(port), threading.Semaphore(0), serial.serial_for_url
    holder = serial.Serial(str(port), exclusive=True) if trouble == 'busy' else None
    if trouble == 'missing':
        port.unlink()
    monkeypatch.setattr(serial, 'serial_for_url', forbidden if trouble == 'forbidden' else true_open)
    present = serial.serial_for_url

    def opening(*args, **given):
        tried.release()
        return present(*args, **given)

    monkeypatch.setattr(serial, 'serial_for_url', opening)
    with Ear(port) as ear:
        assert all(tried.acquire(timeout=10) for _ in range(3))
        if holder:
            holder.close()
        if trouble == 'missing':
            port.symlink_to(device.slave)
        present = true_open
        ear.wait(lambda e: e.opened)
        (reason,) = ear.closed
        assert trouble in reason
        assert said.format(os.getpid()) in reason
        device.unplug()


def test_a_frame_that_was_cut_short_does_not_take_the_next_along(port):
    device = Pty(port)
    host = os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    writer, decoder, heard = FrameWriter(host), Decoder(), []

    def hear(count):
        while len(heard) < count:
            assert select.select([device.master], [], [], 10)[0]
            heard.extend(e.seq for e in decoder.feed(os.read(device.master, 4096)) if isinstance(e, State))

    frames = [encode(State(k, 0, -1, -1, -1, -1, 1, 1, 1)) for k in range(2000)]
    whole = [k for k, frame in enumerate(frames) if writer.write(frame)]
    assert len(whole) < len(frames)
    hear(len(whole))
    assert writer.write(frames[0])
    hear(len(whole) + 1)
    os.close(host)
    assert heard == [*whole, 0]
    device.unplug()


# The other end


def test_a_host_that_does_not_read_is_told_of_the_overrun(port, tmp_path, each_board):
    trace = tmp_path / 'trace.csv'

    def wait(condition):
        deadline = time.monotonic() + 10.0
        while not condition():
            assert time.monotonic() < deadline
            time.sleep(0.001)

    def overrun(since=0):
        return f',{Status.OVERRUN}\n' in trace.read_text()[since:]

    with Program('virtual_board', '--link', port, '--rate', 1000, '--trace', trace) as board:
        board.wait_for('virtual board on')
        wait(overrun)  # nobody is there
        device = os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        opened = len(trace.read_text())
        wait(lambda: ',0\n' in trace.read_text()[opened:])
        begun = len(trace.read_text())
        wait(lambda: overrun(begun))
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
