# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A virtual board and a bridge in their own processes, and a node that subscribes to their topics."""

import time
from functools import cached_property

import numpy as np
import rclpy
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from pendubot_identification.link.protocol import Status
from test.nodes.observer import Observer, values
from test.processes import Program, spin_until

ARMED, WATCHDOG = int(Status.ARMED), int(Status.WATCHDOG)
#: Long timeouts for a busy machine.
PATIENT = 'watchdog_ms:=500', 'link_timeout:=2.0', 'command_timeout:=1.0'
#: Options of a board whose motor may turn for any time.
ENDLESS = '--limit', 'max_travel1=0', '--limit', 'max_travel2=0'


class Rig(Observer):
    """Both programs, a subscriber to samples and diagnostics, and the board's trace."""

    def __init__(self, folder, rate, *board_options):
        super().__init__(rclpy)
        self.port, self.trace_file = folder / 'board', folder / 'trace.csv'
        #: Port of the bridge, if different from the board's.
        self.bridge_port = None
        self.board_options = ('--link', self.port, '--rate', rate, *board_options)
        #: ``diagnoses`` are the bridge's statuses.
        self.programs, self.samples, self.diagnoses = [], [], []
        self.float64, self.trigger = Float64, Trigger
        self.node.create_subscription(JointState, '/joint_states', self._on_sample, QoSProfile(depth=1000))

    @cached_property
    def effort_publisher(self):
        """The publisher of effort commands, created at its first use because it excludes others."""
        return self.node.create_publisher(self.float64, '/pendubot/effort_command', 1)

    def _on_sample(self, m):
        self.message = m
        stamp = m.header.stamp.sec * 10**9 + m.header.stamp.nanosec
        joints = (value for field in (m.position, m.velocity, m.effort, m.name) for value in field[:2])
        self.samples.append((time.time_ns(), stamp, *joints))

    def _on_diagnostics(self, array):
        super()._on_diagnostics(array)
        self.diagnoses += [status for status in array.status if status.name == 'bridge']

    def start(self, name, *words, before=()):
        self.programs.append(Program(name, *words, before=before))
        return self.programs[-1]

    def start_board(self, *options):
        self._read, self._rows = 0, np.empty((0, 5), dtype=np.int64)
        self.trace_file.unlink(missing_ok=True)
        board = self.start('virtual_board', *self.board_options, '--trace', self.trace_file, *options)
        board.wait_for('virtual board on')
        return board

    def start_bridge(self, *parameters, before=()):
        # Virtual boards start at their zeros; the last value of a parameter takes precedence.
        given = f'port:={self.bridge_port or self.port}', 'confirm_zeros:=false', *parameters
        options = [part for p in given for part in ('-p', p)]
        bridge = self.start('bridge', '--ros-args', *options, before=before)
        self.until(
            lambda: (
                self.node.count_publishers('/joint_states') and self.node.count_subscribers('/pendubot/effort_command')
            )
        )
        return bridge

    def until(self, condition, timeout=30.0):
        assert spin_until(self.node, condition, timeout), '\n'.join(p.output for p in self.programs)

    def until_samples(self, more=1, torque=None):
        """Wait for more samples; repeat an effort command meanwhile if one is given."""
        wanted = len(self.samples) + more
        self.drive_until(torque, lambda: len(self.samples) >= wanted)

    def call(self, service):
        """Call a service by its full name, or a service of the bridge."""
        return super().call(self.trigger, service if service[0] == '/' else f'/bridge/{service}')

    def disarm(self):
        """Disarm, again if a busy machine delayed the confirmation."""
        self.until(lambda: self.call('disarm').success)

    def effort(self, torque):
        self.effort_publisher.publish(self.float64(data=torque))

    def drive_until(self, torque, condition):
        """Repeat an effort command, if one is given, until a condition is true."""

        def and_command():
            if torque is not None:
                self.effort(torque)
            return condition()

        self.until(and_command)

    def trace(self):
        """Return the board's samples so far: t_us, enc1, enc2, torque, status."""
        with self.trace_file.open('rb') as file:
            file.seek(self._read)
            new = file.read()
        new = new[: new.rfind(b'\n') + 1]
        rows = [line.split(b',') for line in new.splitlines()[not self._read :]]
        self._read += len(new)
        if rows:
            self._rows = np.concatenate([self._rows, np.array(rows, dtype=np.int64)])
        return self._rows

    def renew(self):
        """Disarm; trace, samples and diagnoses begin here, and no program publishes effort commands."""
        if 'effort_publisher' in vars(self):
            self.node.destroy_publisher(vars(self).pop('effort_publisher'))
        self.disarm()
        self.until(lambda: not self.node.count_publishers('/pendubot/effort_command'))
        self.until(lambda: not self.trace()[-1, 3:].any())
        self._rows = self._rows[-1:]
        self.samples.clear()
        self.diagnoses.clear()
        self.until(lambda: self.samples and not self.samples[-1][6])

    def values(self):
        return values(self.diagnoses[-1])

    def fresh_values(self):
        """Return the values of a later diagnosis."""
        self.diagnoses.clear()
        self.until(lambda: len(self.diagnoses) >= 2)
        return self.values()

    def diagnosed(self, level, text):
        """Return whether a diagnosis with this text has at least this level."""
        return any(d.level >= bytes([level]) and text in d.message for d in self.diagnoses)

    def __exit__(self, *_):
        for program in reversed(self.programs):
            program.__exit__()
        super().__exit__()
