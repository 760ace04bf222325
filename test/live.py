# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A rig for a balancer: boards that start near upright, and a node in place of the identifier."""

import math

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import Float64MultiArray

from pendubot_identification.control.plan import HELD, deviation
from pendubot_identification.level import Level
from pendubot_identification.model.parameters import BALANCE, NAMES
from pendubot_identification.model.simulation import HANGING
from pendubot_identification.nodes.messages import LATCHED, parameters_message, status_message
from test.processes import spin_until
from test.rig import ARMED, Rig

COUNTS = 4000


class LiveRig(Rig):
    """A rig with the parameters ``BALANCE`` and a trace of the true motion for each board."""

    def __init__(self, folder, rate=200):
        super().__init__(folder, rate, '--preset', 'balance', '--counts', COUNTS)
        self.boards = 0
        self.identified = self.node.create_publisher(Float64MultiArray, '/pendubot/params', LATCHED)
        self.identification = self.node.create_publisher(DiagnosticArray, '/pendubot/identification', LATCHED)

    def start_board(self, *options, start='upright', spread=0.1, delay=0.004, seed=1):
        """Start a board at a position, with a new trace."""
        self.boards += 1
        self.trace_file = self.port.with_name(f'trace{self.boards}.csv')
        place = '--start', start, '--spread', spread, '--delay', delay, '--seed', seed
        return super().start_board(*place, *options)

    def publish(self, rig=BALANCE, level=0, message='identified', delay=0.004):
        """Publish parameters, or a vector of them, like the identifier."""
        theta = np.array(rig.vector() if hasattr(rig, 'vector') else rig)
        values = dict(zip(NAMES, theta, strict=False)) | {'effort.delay': delay}
        self.identification.publish(status_message(self.node, 'x', Level(level), message, values))
        self.identified.publish(parameters_message(theta))

    def said(self):
        return [status for status in self.statuses if status.name == 'balancer']

    def begin(self, timeout=60.0):
        """Start balancing as soon as balancer and board are ready."""
        self.until(lambda: spin_until(self.node, lambda: False, 0.2) or self.call('/balancer/start').success, timeout)

    def motion(self):
        """Return the board's trace so far: t [s], q [rad], torque [N m], status."""
        rows = self.trace()
        return rows[:, 0] * 1e-6, rows[:, 1:3] * (2 * math.pi / COUNTS) + HANGING, rows[:, 3] * 1e-6, rows[:, 4]

    def held(self):
        """Return the begin [s after arming] and the duration [s] of the present balancing; inf and 0 without."""
        t, q, _, status = self.motion()
        armed = np.flatnonzero(status & ARMED)
        if not armed.size:
            return math.inf, 0.0
        t, q = t[armed[0] :] - t[armed[0]], q[armed[0] :]
        out = np.flatnonzero(deviation(q) > HELD)
        first = out[-1] + 1 if out.size else 0
        return (float(t[first]), float(t[-1] - t[first])) if first < len(t) else (math.inf, 0.0)
