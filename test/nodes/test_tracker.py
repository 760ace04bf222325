# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The tracker in its own process: it hears samples alone, and says what is true now."""

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool, Trigger

from pendubot_identification.nodes.messages import LATCHED
from pendubot_identification.nodes.topics import quality
from test.changing_rig import Day, record, truth
from test.processes import Program, call, parameters, run_program, spin_until

pytestmark = pytest.mark.ros
DAY = Day(payload=0.2, payload_at=20.0)
OK, WARN, ERROR = b'\x00', b'\x01', b'\x02'


class Listener:
    """A rig in /lab1 whose samples come as fast as they are taken, and a node that hears what is said of it."""

    def __init__(self, ros):
        self.node = ros.create_node('listener', namespace='/lab1')
        self.params, self.status, self.sent = [], [], 0
        self.samples = self.node.create_publisher(JointState, 'joint_states', quality(10_000, True, False))
        self.node.create_subscription(Float64MultiArray, 'pendubot/params', self.params.append, LATCHED)
        self.node.create_subscription(
            DiagnosticArray, 'pendubot/identification', lambda m: self.status.extend(m.status), LATCHED
        )
        t, q, tau = record([4], [DAY], seconds=32.0)
        self.recorded = t, q[0], tau[0]

    def send(self, until):
        """Publish the samples up to a time [s]."""
        t, q, tau = self.recorded
        while self.sent < len(t) and t[self.sent] < until:
            k = self.sent
            message = JointState(name=['elbow', 'shoulder'], position=q[k, ::-1].tolist(), effort=[0.0, tau[k]])
            message.header.stamp.sec, message.header.stamp.nanosec = 1000 + int(t[k]), int(t[k] % 1 * 1e9)
            self.samples.publish(message)
            self.sent += 1

    def hears(self, condition, timeout=60.0):
        assert spin_until(self.node, condition, timeout), (self.status[-1:], self.params[-1:])

    def serve(self, kind, name, request):
        client = self.node.create_client(kind, name)
        try:
            return call(self.node, client, request)
        finally:
            self.node.destroy_client(client)

    def values(self):
        return {pair.key: pair.value for pair in self.status[-1].values}


def test_what_is_true_now_is_published_in_its_namespace(ros):
    listener = Listener(ros)
    with Program('tracker', '--ros-args', '-r', '__ns:=/lab1') as tracker:
        tracker.wait_for('8 s of motion without a gap are needed; waiting')
        listener.hears(lambda: listener.samples.get_subscription_count())
        listener.hears(lambda: listener.status and listener.status[-1].level == WARN)
        assert not listener.params
        listener.send(19.0)
        before, after = truth(DAY, [0.0, 30.0])

        def shows(true):
            """Tell whether the parameters last published are true, and judged."""
            if not listener.params or listener.values().get('P1') is None:
                return False
            theta = np.array(listener.params[-1].data)
            return (np.abs(theta / true - 1) < 0.02)[:5].all() and float(listener.values()['P1']) == theta[0]

        listener.hears(lambda: shows(before))
        assert listener.status[-1].level == OK, listener.status[-1].message
        assert listener.params[-1].layout.dim[0].label == 'P1,P2,P3,P4,P5,b1,b2,Fc1,Fc2'
        assert listener.values()['last_change'] == 'none'
        listener.send(25.0)
        tracker.wait_for('payload on link 2', 60.0)
        listener.hears(lambda: shows(after))
        assert 'payload on link 2, at 19.' in listener.values()['last_change']
        # What is held is not published, and comes when it is let go.
        assert listener.serve(SetBool, 'tracker/hold', SetBool.Request(data=True)).success
        assert listener.serve(Trigger, 'tracker/reset', Trigger.Request()).success
        listener.status.clear()
        assert listener.serve(SetBool, 'tracker/hold', SetBool.Request(data=False)).success
        listener.hears(lambda: listener.status and '8 s of motion without' in listener.status[-1].message)
        assert not listener.node.count_publishers('/pendubot/params')
        assert tracker.stop() == 0
    listener.node.destroy_node()


def test_samples_of_two_publishers_are_refused_and_it_begins_anew_with_the_one_that_is_left(ros):
    listener, stranger = Listener(ros), ros.create_node('stranger', namespace='/elsewhere')
    said = []
    listener.node.create_subscription(DiagnosticArray, '/diagnostics', lambda m: said.extend(m.status), 10)
    rivals = '/lab1/joint_states has 2 publishers: /elsewhere/stranger, /lab1/listener; only one program may publish'
    with Program('tracker', '--ros-args', '-r', '__ns:=/lab1') as tracker:
        listener.hears(lambda: listener.samples.get_subscription_count())
        listener.send(15.0)
        listener.hears(lambda: listener.params)
        second = stranger.create_publisher(JointState, '/lab1/joint_states', quality(10, True, False))
        tracker.wait_for(rivals)
        listener.hears(lambda: listener.status[-1].level == ERROR and rivals in listener.status[-1].message)
        listener.hears(lambda: said and said[-1].level == ERROR and rivals in said[-1].message)
        # Whoever publishes them: none is learned from.
        listener.params.clear()
        taken = {pair.key: pair.value for pair in said[-1].values}['samples']
        listener.send(28.0)
        said.clear()
        listener.hears(lambda: len(said) > 2)
        assert {pair.key: pair.value for pair in said[-1].values}['samples'] == taken
        stranger.destroy_publisher(second)
        listener.hears(lambda: '8 s of motion without a gap are needed; waiting' in listener.status[-1].message)
        assert not listener.params
        listener.hears(lambda: said[-1].level == WARN)
    listener.node.destroy_node()
    stranger.destroy_node()


def test_a_start_that_cannot_be_read_is_refused(tmp_path):
    done = run_program('tracker', *parameters(start=tmp_path / 'none.yaml'))
    assert done.returncode == 1
    assert 'cannot be read' in done.stderr
    assert 'Traceback' not in done.stderr
