# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The bytes that the bridge publishes, read by ROS itself."""

import pytest
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from pendubot_identification.nodes.messages import JointStateBytes

pytestmark = pytest.mark.ros


@pytest.mark.parametrize('names', [['shoulder', 'elbow'], ['a', 'joint with a long name']])
def test_the_bytes_that_are_published_are_the_message(names):
    """Two joints, and the measured current as the effort of an entry of its own; nothing of earlier samples is left."""
    message = JointStateBytes(names)
    message.fill(1, (9.0, 9.0), (9.0, 9.0), 9.0, 9.0)
    data = message.fill(1_700_000_000_123_456_789, (-1.5, 2.5), (3.5, -4.5), 0.25, -1.75)
    expected = JointState(
        name=[*names, f'{names[0]}_current'],
        position=[-1.5, 2.5, 0.0],
        velocity=[3.5, -4.5, 0.0],
        effort=[0.25, 0.0, -1.75],
    )
    expected.header.stamp.sec, expected.header.stamp.nanosec = 1_700_000_000, 123_456_789
    assert deserialize_message(data, JointState) == expected
