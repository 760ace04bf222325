# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The time from a command of torque to the first joint state that has it, on each of the bridge's two topics."""

import tempfile
import time
from pathlib import Path

import numpy as np

STEPS = 1000


def latency():
    """Return a table; both topics have the same board, bridge and subscriber, one after the other."""
    import rclpy
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64

    from test.processes import spin_until
    from test.rig import PATIENT, Rig

    rows = ['| topic | median [ms] | 99th percentile [ms] |', '|---|---|---|']
    rclpy.init()
    with tempfile.TemporaryDirectory() as folder:
        rig = Rig(Path(folder), 1000)
        try:
            rig.start_board()
            rig.start_bridge(*PATIENT)
            rig.until_samples()
            for topic, kind in (('effort_command', Float64), ('joint_commands', JointState)):
                publisher = rig.node.create_publisher(kind, f'/pendubot/{topic}', 1)
                rig.until(lambda publisher=publisher: publisher.get_subscription_count() == 1)
                assert rig.call('arm').success
                spent = []
                for k in range(STEPS):
                    torque = 0.01 * (1 + k % 2)
                    names = ['shoulder', 'elbow']
                    message = kind(data=torque) if kind is Float64 else kind(name=names, effort=[torque])
                    begin = time.perf_counter()
                    publisher.publish(message)
                    assert spin_until(rig.node, lambda torque=torque: rig.samples[-1][6] == torque)
                    spent.append(1e3 * (time.perf_counter() - begin))
                assert rig.call('disarm').success
                rig.node.destroy_publisher(publisher)
                rows.append(f'| `{topic}` | {np.median(spent):.2f} | {np.percentile(spent, 99):.2f} |')
        finally:
            rig.close()
            rclpy.try_shutdown()
    return '\n'.join(rows)
