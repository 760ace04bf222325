# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A process that subscribes to /joint_states: ``python -m test.listener FILE.npy``.

It prints a line when it listens and at the first message. At SIGTERM it writes a row for each message: arrival and
timestamp [ns], q1, q2, effort.
"""

import gc
import signal
import sys
import time
from array import array

import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState


def main():
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    gc.disable()  # collecting many messages takes long
    # A time server may set the computer's clock during a trial.
    epoch = time.time_ns() - time.monotonic_ns()
    times, messages = array('q'), []

    def on_sample(data):
        # Raw data: the latency must not include deserialization.
        times.append(time.monotonic_ns() + epoch)
        messages.append(data)

    node = rclpy.create_node('fault_trial_listener', enable_rosout=False, start_parameter_services=False)
    node.create_subscription(JointState, '/joint_states', on_sample, QoSProfile(depth=1000), raw=True)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    ended = []
    signal.signal(signal.SIGTERM, lambda *_: ended.append(True))
    print('listening', flush=True)
    while not times and not ended:
        executor.spin_once(0.2)
    print('hearing', flush=True)
    while not ended:
        executor.spin_once(0.2)
    stamps, values = array('q'), array('d')
    for m in (deserialize_message(data, JointState) for data in messages):
        stamps.append(m.header.stamp.sec * 10**9 + m.header.stamp.nanosec)
        values.extend((*m.position[:2], *m.effort[:1]))
    with open(sys.argv[1], 'wb') as file:
        np.save(file, np.column_stack([times, stamps]).astype(np.int64))
        np.save(file, np.array(values).reshape(-1, 3))
    rclpy.try_shutdown()


if __name__ == '__main__':
    main()
