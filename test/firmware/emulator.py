# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The STM32F4's program on QEMU's netduinoplus2, with access to its memory through the debugger."""

import contextlib
import os
import re
import select
import socket
import subprocess
import time
import tty

from pendubot_identification.link.protocol import Decoder

from .building import made, need

#: Address of the number from which the board computes its boot_id.
SEED = 0x2001FFFC


class Emulator:
    """A context manager around QEMU.

    Args:
        folder: for the log of unimplemented devices (``-d unimp``) and the debugger's socket.

    Attributes:
        port: the pseudo-terminal of the USART.
    """

    def __init__(self, folder):
        need('qemu-system-arm', 'qemu-system-arm')
        need('arm-none-eabi-gcc', 'gcc-arm-none-eabi libnewlib-arm-none-eabi')
        self.elf = made('arm') / 'emulated.elf'
        self._log, self._socket = folder / 'qemu.log', folder / 'debugger'
        words = ['qemu-system-arm', '-M', 'netduinoplus2', '-nographic', '-monitor', 'none', '-serial', 'pty']
        words += ['-kernel', self.elf, '-device', f'loader,addr={SEED},data={os.getpid()},data-len=4']
        words += ['-d', 'unimp', '-D', self._log, '-gdb', f'unix:path={self._socket},server=on,wait=off']
        self._process = subprocess.Popen(
            list(map(str, words)), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        self.port = re.search(r'/dev/pts/\d+', self._process.stdout.readline())[0]
        while not self._socket.exists():
            assert self._process.poll() is None
            time.sleep(0.01)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._process.terminate()
        self._process.wait(10)

    def written(self, device, offset):
        """Return the values written to a register of a device that QEMU does not implement, in order."""
        pattern = rf'{device}: unimplemented device write \(size 4, offset 0x0*{offset:x}, value 0x([0-9a-f]+)\)'
        return [int(value, 16) for value in re.findall(pattern, self.log(), re.IGNORECASE)]

    def log(self):
        """Return QEMU's log of accesses to unimplemented registers."""
        return self._log.read_text()

    def place(self, symbol):
        """Return the address and size of a function or variable."""
        names = subprocess.run(['arm-none-eabi-nm', '-S', self.elf], capture_output=True, text=True, check=True).stdout
        address, size = re.search(rf'^([0-9a-f]+) ([0-9a-f]+) \w {symbol}$', names, re.MULTILINE).groups()
        return int(address, 16) & ~1, int(size, 16)

    @contextlib.contextmanager
    def debugger(self):
        """Halt the program; yield a function that sends a command of the debugger protocol and returns the answer."""
        with socket.socket(socket.AF_UNIX) as line:
            line.settimeout(10)
            line.connect(str(self._socket))

            def ask(command):
                line.sendall(f'${command}#{sum(command.encode()) % 256:02x}'.encode())
                # At connection QEMU sends an additional stop reply.
                unrequested = () if command in ('s', 'c') else ('T',)
                while (answer := packet()).startswith(unrequested):
                    pass
                return answer

            def packet():
                nonlocal received
                while (match := re.search(rb'\$([^#]*)#..', received)) is None:
                    received += line.recv(4096)
                received = received[match.end() :]
                line.sendall(b'+')
                return match[1].decode()

            received = b''
            ask('qXfer:features:read:target.xml:0,fff')  # required for access to single registers
            yield ask
            ask('D')

    def patch(self, symbol, instruction):
        """Write an instruction (16 bits) at the beginning of a function."""
        with self.debugger() as ask:
            assert ask(f'M{self.place(symbol)[0]:x},2:{instruction.to_bytes(2, "little").hex()}') == 'OK'

    def stands_at(self, symbol):
        """Return whether the next instruction is a function's first."""
        with self.debugger() as ask:
            return int.from_bytes(bytes.fromhex(ask('pf')), 'little') == self.place(symbol)[0]


class Line:
    """A host's end of a board's pseudo-terminal, without a bridge."""

    def __init__(self, port):
        self._file = os.open(port, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(self._file)
        self._decoder = Decoder()
        self._waiting = []

    def write(self, data):
        os.write(self._file, data)

    def events(self, seconds, enough=lambda event: False):
        """Return the events within so many seconds, or until ``enough`` is true for one."""
        events, end = [], time.monotonic() + seconds
        while time.monotonic() < end:
            while self._waiting:
                events.append(self._waiting.pop(0))
                if enough(events[-1]):
                    return events
            if select.select([self._file], [], [], 0.05)[0]:
                self._waiting += self._decoder.feed(os.read(self._file, 4096))
        return events

    def close(self):
        os.close(self._file)
