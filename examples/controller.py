# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Subscribe to the parameters of the pendubot and their level: python3 controller.py, in a ROS terminal."""

import contextlib
import math

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Float64MultiArray

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
GRAVITY = 9.81


class Controller(Node):
    """A subscriber of the latched level and parameters, which may start after they are published."""

    def __init__(self):
        super().__init__('controller')
        self.trusted = False
        self.parameters = None
        self.create_subscription(DiagnosticArray, 'pendubot/identification', self.on_identification, LATCHED)
        self.create_subscription(Float64MultiArray, 'pendubot/params', self.on_parameters, LATCHED)

    def on_identification(self, message):
        """Store whether the next parameters have level OK."""
        (status,) = message.status
        self.trusted = status.level == DiagnosticStatus.OK
        self.get_logger().info(f'level {status.level[0]}: {status.message}')

    def on_parameters(self, message):
        """Store the parameters by name."""
        names = message.layout.dim[0].label.split(',')
        self.parameters = dict(zip(names, message.data, strict=True))
        self.get_logger().info(f'parameters: {self.parameters}')
        self.get_logger().info(f'to hold link 1 horizontal takes {self.holding_torque(0.0, -math.pi / 2):.4f} N m')

    def holding_torque(self, q1, q2):
        """Return the torque of the shoulder against gravity [N m]."""
        p = self.parameters
        return GRAVITY * (p['P4'] * math.cos(q1) + p['P5'] * math.cos(q1 + q2))


def main():
    """Run until Ctrl-C."""
    rclpy.init()
    # At Ctrl-C rclpy itself shuts down; a second shutdown at the same time would fail.
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(Controller())


if __name__ == '__main__':
    main()
