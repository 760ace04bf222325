# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The firmware's protocol in C, in a separate process that a sanitizer may end."""

import struct
import subprocess

from pendubot_identification.link.protocol import Limits


class LinkProbe:
    """The program link_probe.c: a board's link."""

    def __init__(self, program):
        self._process = subprocess.Popen(
            [program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=False
        )

    def close(self):
        """End the program; fail with the message of a sanitizer."""
        _, errors = self._process.communicate()
        assert self._process.returncode == 0, errors.decode()

    def boot(
        self,
        boot_id=1,
        reset_cause=1,
        cpr=(4000, 4000),
        limit=2_000_000,
        period_us=10_000,
        watchdog_max_ms=500,
        firmware='virtual',
        limits=Limits(),  # noqa: B008
        fault_pc=0,
        fault_cause=0,
        build=0,
        torque_constant=0,
    ):
        settings = *cpr, limit, period_us, watchdog_max_ms, torque_constant, build, *limits, 0
        reset = fault_pc, fault_cause, reset_cause
        self._call('B', '@IIiIHII5I4HP IBB I17s0P', *settings, *reset, boot_id, firmware.encode())

    def receive(self, data, now=0, faults=0):
        self._call('R', '=III', now, faults, len(data))
        self._process.stdin.write(data)

    def note_overrun(self):
        self._call('O', '=')

    def sample(self, now=0, enc1=0, enc2=0, current=0, vbus=2400, faults=0, room=65536):
        """Return the torque and the frames of a sample."""
        self._call('S', '=iihHIII', enc1, enc2, current, vbus, faults, now, room)
        self._flush()
        torque, size = struct.unpack('=iI', self._read(8))
        return torque, self._read(size)

    def _call(self, name, layout, *values):
        self._process.stdin.write(name.encode() + struct.pack(layout, *values))

    def _flush(self):
        try:
            self._process.stdin.flush()
        except BrokenPipeError:
            self.close()

    def _read(self, size):
        data = self._process.stdout.read(size)
        if len(data) < size:
            self.close()
        return data
