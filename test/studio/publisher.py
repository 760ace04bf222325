# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Publishes joint states at 200 Hz and a tracker's parameters until a signal, in place of a rig."""

import math
import time
from contextlib import suppress

import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException
from sensor_msgs.msg import JointState

from pendubot_identification.level import Level
from pendubot_identification.nodes.messages import Identification


def main():
    rclpy.init()
    node = rclpy.create_node('rig')
    joints, theta = node.create_publisher(JointState, '/joint_states', 100), np.linspace(0.001, 0.007, 7)
    names = ('P1', 'P2', 'P3', 'P4', 'P5', 'b1', 'b2')
    values = {f'{n}.interval': (0.98 * x, 1.02 * x) for n, x in zip(names, theta.tolist(), strict=True)}
    values |= {f'{name}.unit': 'kg m^2' for name in names[:3]}
    Identification(node).publish(Level.WARN, 'b2 is poorly determined', values, theta)

    def sample():
        t = time.monotonic()
        # In the order of joint_state_broadcaster.
        message = JointState(name=['elbow', 'shoulder'], position=[0.5, math.sin(t)], effort=[0.0, 0.25])
        message.header.stamp = node.get_clock().now().to_msg()
        joints.publish(message)

    node.create_timer(0.005, sample)
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)


if __name__ == '__main__':
    main()
