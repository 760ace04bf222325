# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A virtual rig, its bridge and a balancer in processes of their own, and a node in the identifier's place."""

import math
import time

import numpy as np

from pendubot_identification.control.plan import HELD, deviation
from pendubot_identification.model.parameters import BALANCE, NAMES
from pendubot_identification.model.simulation import HANGING
from test.processes import Program, call, parameters, spin_until

ARMED = 1
COUNTS = 4000


class LiveRig:
    """Programs that talk over a pty and DDS; what truly happened is in the board's trace.

    ``programs`` has them by name. Everything is ended by :meth:`close`.
    """

    def __init__(self, folder, rate=200):
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray
        from rclpy.qos import DurabilityPolicy, QoSProfile
        from std_msgs.msg import Float64MultiArray, MultiArrayDimension
        from std_srvs.srv import Trigger

        self.folder, self.rate = folder, rate
        self.port = folder / 'board'
        self.programs = {}
        self.boards = 0
        self.diagnoses = []
        self._types = Float64MultiArray, MultiArrayDimension, Trigger
        self.node = rclpy.create_node('identifier_in_place')
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._params = self.node.create_publisher(Float64MultiArray, '/pendubot/params', latched)
        self._identification = self.node.create_publisher(DiagnosticArray, '/pendubot/identification', latched)
        self.node.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 10)

    def _on_diagnostics(self, array):
        self.diagnoses += [s for s in array.status if s.name == 'balancer']

    def start_board(self, *options, start='upright', spread=0.1, delay=0.004, seed=1, preset='balance'):
        """Start a board at some place, with a trace of its own."""
        self.boards += 1
        self.trace_file = self.folder / f'trace{self.boards}.csv'
        words = {'link': self.port, 'rate': self.rate, 'trace': self.trace_file, 'start': start, 'spread': spread}
        words |= {'delay': delay, 'seed': seed, 'preset': preset, 'counts': COUNTS}
        board = Program('virtual_board', *(w for k, v in words.items() for w in (f'--{k}', v)), *options)
        self.programs['virtual_board'] = board
        board.wait_for('virtual board on')
        return board

    def start(self, name, **values):
        """Start another program with these parameters."""
        self.programs[name] = Program(name, *parameters(**values))
        return self.programs[name]

    def start_bridge(self, **values):
        return self.start('bridge', port=self.port, **values)

    def publish(self, rig=BALANCE, level=0, message='identified', delay=0.004):
        """Do as the identifier would with these parameters; level None: publish no judgement."""
        from pendubot_identification.level import Level
        from pendubot_identification.nodes.diagnostics import diagnostics_message

        array, dimension, _ = self._types
        theta = [float(value) for value in (rig.vector() if hasattr(rig, 'vector') else rig)]
        names = NAMES[: len(theta)]
        if level is not None:
            values = dict(zip(names, theta, strict=True)) | {'effort.delay': delay}
            stamp = self.node.get_clock().now().to_msg()
            self._identification.publish(diagnostics_message(stamp, 'x', Level(level), message, values))
        label = ','.join(names)
        parts = [dimension(label=label, size=len(theta), stride=len(theta))]
        params = array(data=theta)
        params.layout.dim = parts
        self._params.publish(params)

    def until(self, condition, timeout=20.0):
        said = '\n'.join(p.output for p in self.programs.values())
        assert spin_until(self.node, condition, timeout), said + '\n'.join(p.output for p in self.programs.values())

    def call(self, service):
        client = self.node.create_client(self._types[2], service)
        try:
            return call(self.node, client, self._types[2].Request())
        finally:
            self.node.destroy_client(client)

    def begin(self, timeout=60.0):
        """Start the balancer's work as soon as it is ready and the board is there."""
        answers = []
        deadline = time.monotonic() + timeout
        while not (answers and answers[-1].success):
            assert time.monotonic() < deadline, [a.message for a in answers]
            spin_until(self.node, lambda: False, 0.2)
            answers.append(self.call('/balancer/start'))

    def trace(self):
        """What the board did so far: t [s], q [rad], torque [N m], status."""
        lines = self.trace_file.read_text().splitlines(keepends=True)[1:]
        rows = np.array([line.split(',') for line in lines if line.endswith('\n')], dtype=np.int64).reshape(-1, 5)
        return rows[:, 0] * 1e-6, rows[:, 1:3] * (2 * math.pi / COUNTS) + HANGING, rows[:, 3] * 1e-6, rows[:, 4]

    def held(self, since=0.0):
        """Return since when, in s after arming, the rig is held without a break, and for how long; 0 where it is not.

        What happened before ``since`` [s after arming] does not count.
        """
        t, q, _, status = self.trace()
        armed = np.flatnonzero(status & ARMED)
        if not armed.size:
            return math.inf, 0.0
        t, q = t[armed[0] :] - t[armed[0]], q[armed[0] :]
        out = np.flatnonzero((deviation(q) > HELD) | (t < since))
        first = out[-1] + 1 if out.size else 0
        return (float(t[first]), float(t[-1] - t[first])) if first < len(t) else (math.inf, 0.0)

    def armed_for(self):
        """Return how long ago it was first armed, in the board's time [s]."""
        t, _, _, status = self.trace()
        armed = np.flatnonzero(status & ARMED)
        return float(t[-1] - t[armed[0]]) if armed.size else 0.0

    def close(self):
        for program in reversed(self.programs.values()):
            program.__exit__()
        self.node.destroy_node()
