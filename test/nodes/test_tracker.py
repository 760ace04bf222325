# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The tracker in its own process: samples in, current parameters out."""

import numpy as np
import pytest
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

from test.changing_rig import Day, truth
from test.nodes.observer import Observer, values
from test.processes import Program
from test.virtual import recording_of_a_day

DAY = Day(payload=0.2, payload_at=15.0)
OK, WARN, ERROR = b'\x00', b'\x01', b'\x02'
NEEDED = '8 s of motion without a gap are needed; waiting'
IN_LAB1 = '--ros-args', '-r', '__ns:=/lab1'


class Rig(Observer):
    """Publishes recorded samples in /lab1 and subscribes to the tracker."""

    def __init__(self, ros):
        super().__init__(ros, '/lab1')
        self.samples = self.node.create_publisher(JointState, 'joint_states', 10_000)
        self.recorded, self.sent = recording_of_a_day(DAY, 32), 0

    def send(self, until):
        """Publish the samples up to a time [s]."""
        t, q, tau = self.recorded.t, self.recorded.q, self.recorded.tau[:, 0]
        while self.sent < len(t) and t[self.sent] < until:
            k = self.sent
            message = JointState(name=['elbow', 'shoulder'], position=q[k, ::-1].tolist(), effort=[0.0, tau[k]])
            message.header.stamp.sec, message.header.stamp.nanosec = 1000 + int(t[k]), int(t[k] % 1 * 1e9)
            self.samples.publish(message)
            self.sent += 1

    def sends_unreadable(self):
        """Return whether samples without the joints of the rig are reported at level ERROR."""
        self.samples.publish(JointState(name=['arm', 'wrist'], position=[0.0, 0.0], effort=[0.0, 0.0]))
        last = self.quality[-1:] + self.statuses[-1:]
        return len(last) == 2 and all(each.level == ERROR and 'joint_names' in each.message for each in last)

    def shows(self, true):
        """Return whether the last published parameters are accurate, with their quality published."""
        if not self.params or 'P1' not in values(self.quality[-1]):
            return False
        theta = np.array(self.params[-1].data)
        return (np.abs(theta / true - 1) < 0.02)[:5].all() and float(values(self.quality[-1])['P1']) == theta[0]


@pytest.fixture
def rig(ros):
    with Rig(ros) as rig:
        yield rig


def test_current_parameters_are_published_of_one_rig_and_unless_they_are_held(rig, stranger):
    rivals = '/lab1/joint_states has 2 publishers: /elsewhere/stranger, /lab1/listener; only one program may publish'
    with Program('tracker', *IN_LAB1) as tracker:
        tracker.wait_for(NEEDED)
        rig.until(rig.samples.get_subscription_count)
        rig.until(lambda: rig.quality and rig.quality[-1].level == WARN)
        assert not rig.params
        rig.send(14.0)
        before, after = truth(DAY, [0.0, 30.0])
        rig.until(lambda: rig.shows(before), 60.0)
        assert rig.quality[-1].level == OK, rig.quality[-1].message
        assert rig.params[-1].layout.dim[0].label == 'P1,P2,P3,P4,P5,b1,b2,Fc1,Fc2'
        assert values(rig.quality[-1])['last_change'] == 'none'
        rig.send(20.0)
        tracker.wait_for('payload on link 2', 60.0)
        rig.until(lambda: rig.shows(after), 60.0)
        assert 'payload on link 2, at 14.' in values(rig.quality[-1])['last_change']

        second = stranger.create_publisher(JointState, '/lab1/joint_states', 10)
        tracker.wait_for(rivals)
        for topic in (rig.quality, rig.statuses):
            rig.until(lambda topic=topic: topic and topic[-1].level == ERROR and rivals in topic[-1].message)
        # No sample of either publisher is used; without the second one the tracking restarts.
        rig.params.clear()
        taken = values(rig.statuses[-1])['samples']
        rig.send(21.0)
        rig.statuses.clear()
        rig.until(lambda: len(rig.statuses) > 2)
        assert values(rig.statuses[-1])['samples'] == taken
        stranger.destroy_publisher(second)
        rig.until(lambda: NEEDED in rig.quality[-1].message)

        # While held, no parameters are published; after the release they are.
        assert rig.call(SetBool, 'tracker/hold', data=True).success
        rig.send(32.0)
        rig.until(lambda: rig.statuses[-1].message == 'held; tracked', 60.0)
        assert not rig.params
        assert rig.call(SetBool, 'tracker/hold', data=False).success
        rig.until(lambda: rig.shows(after))
        assert rig.call(Trigger, 'tracker/reset').success
        rig.until(lambda: NEEDED in rig.quality[-1].message)
        assert not rig.node.count_publishers('/pendubot/params')
        rig.until(rig.sends_unreadable)
        assert tracker.stop() == 0
