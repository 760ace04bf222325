# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Waits for the parameters of the pendubot, however late it starts, and says how far to trust them."""

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
    def __init__(self):
        super().__init__('controller')
        self.trusted = False
        self.parameters = None
        self.create_subscription(DiagnosticArray, 'pendubot/identification', self.on_identification, LATCHED)
        self.create_subscription(Float64MultiArray, 'pendubot/params', self.on_parameters, LATCHED)

    def on_identification(self, message):
        (status,) = message.status
        self.trusted = status.level == DiagnosticStatus.OK
        self.get_logger().info(f'level {status.level[0]}: {status.message}')

    def on_parameters(self, message):
        names = message.layout.dim[0].label.split(',')
        self.parameters = dict(zip(names, message.data))
        self.get_logger().info(f'parameters: {self.parameters}')
        self.get_logger().info(f'to hold link 1 horizontal takes {self.holding_torque(0.0, -math.pi / 2):.4f} N m')

    def holding_torque(self, q1, q2):
        """Return what the shoulder must bear against gravity [N m]."""
        p = self.parameters
        return GRAVITY * (p['P4'] * math.cos(q1) + p['P5'] * math.cos(q1 + q2))


def main():
    rclpy.init()
    try:
        rclpy.spin(Controller())
    except (KeyboardInterrupt, ExternalShutdownException):
        pass


if __name__ == '__main__':
    main()
