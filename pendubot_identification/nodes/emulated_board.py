# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The firmware of a real board, run by QEMU in the place of the virtual one; its encoders and motor are simulated."""

from __future__ import annotations

import re
import secrets
import shutil
import subprocess
from pathlib import Path

from pendubot_identification.errors import LinkError, PendubotError
from pendubot_identification.resources import resource

from .shutdown import Shutdown

#: Where the firmware looks for a number that makes its boot_id another one at every start.
SEED = '0x2001fffc'


def firmware() -> Path:
    """Return the firmware that samples at 100 Hz, as ``make -C firmware`` builds it.

    Raises:
        LinkError: there is none, or no QEMU to run it.
    """
    try:
        program = resource('firmware') / 'build' / 'emulated-100.elf'
    except PendubotError:
        raise LinkError('the firmware is not part of this install; run this in a source tree') from None
    if not program.exists():
        raise LinkError(f'{program} is missing; build it by: make -C firmware (Debian: gcc-arm-none-eabi)')
    for name, package in (('qemu-system-arm', 'qemu-system-arm'), ('setpriv', 'util-linux')):
        if shutil.which(name) is None:
            raise LinkError(f'{name} is not installed (Debian: {package})')
    return program


def emulate(link: Path | None, stop: Shutdown) -> None:
    """Run the firmware until ``stop`` says so; ``link`` becomes a symbolic link to its pseudo-terminal.

    Raises:
        LinkError: there is no firmware, no QEMU, or it did not start or ended; or the link cannot be made.
    """
    seed = f'loader,addr={SEED},data={secrets.randbits(32)},data-len=4'
    # It ends with this program, however that ends.
    words = [
        'setpriv',
        '--pdeathsig',
        'TERM',
        'qemu-system-arm',
        '-M',
        'netduinoplus2',
        '-nographic',
        '-monitor',
        'none',
        '-serial',
        'pty',
    ]
    words += ['-kernel', str(firmware()), '-device', seed]
    with subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True) as qemu:
        try:
            port = re.search(r'/dev/pts/\d+', qemu.stdout.readline() if qemu.stdout else '')
            if port is None:
                raise LinkError('QEMU opened no pseudo-terminal; try qemu-system-arm -M netduinoplus2 by hand')
            if link is not None:
                if link.is_symlink():
                    link.unlink()
                try:
                    link.symlink_to(port[0])
                except OSError as error:
                    raise LinkError(f'the link {link} cannot be made ({error.strerror}); name another') from error
            print(f'firmware in QEMU: virtual board on {link or port[0]}', flush=True)
            while not stop.wait(0.2):
                if qemu.poll() is not None:
                    raise LinkError(f'QEMU ended, with status {qemu.returncode}')
        finally:
            qemu.terminate()
            if link is not None and link.is_symlink():
                link.unlink()
