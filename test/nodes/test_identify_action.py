# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The identifier's action in real processes: feedback, result, cancellation, and failures."""

import importlib
import os
import select
from pathlib import Path

import pytest
from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from std_msgs.msg import String

from pendubot_identification.nodes.messages import LATCHED
from test.nodes.conftest import FAST
from test.nodes.observer import Observer
from test.processes import Program, parameters

pytestmark = pytest.mark.ros
pytest.importorskip('pendubot_interfaces', reason='colcon, or make .venv/.interfaces, builds it')
Identify = importlib.import_module('pendubot_interfaces.action').Identify
#: Takes minutes, in one stage of many generations.
LONG = FAST | {'optimizer': 'auto', 'generations': 10_000_000, 'spread': 0.0}


class Goals(Observer):
    """Sends goals, and collects their feedback."""

    def __init__(self, ros):
        super().__init__(ros)
        self.client = ActionClient(self.node, Identify, '/identifier/identify')
        self.feedback = []
        self.until(self.client.server_is_ready, 60.0)

    def wait(self, future, timeout=60.0):
        self.until(future.done, timeout)
        return future.result()

    def send(self, *bags):
        """Send a goal with these bags; return its handle after acceptance."""
        self.feedback.clear()
        goal = Identify.Goal(bags=[str(bag) for bag in bags])
        handle = self.wait(self.client.send_goal_async(goal, lambda m: self.feedback.append(m.feedback)))
        assert handle.accepted
        return handle

    def result(self, *bags):
        answer = self.wait(self.send(*bags).get_result_async())
        return answer.status, answer.result


def children(program):
    pid = program.process.pid
    return [int(word) for t in Path(f'/proc/{pid}/task').iterdir() for word in (t / 'children').read_text().split()]


def test_a_goal_is_identified_with_feedback_and_failures_give_a_reason(ros, bag):
    with Program('identifier', *parameters(**FAST)) as program, Goals(ros) as goals:
        program.wait_for('waiting: set the parameter bags')
        descriptions = []
        goals.node.create_subscription(String, '/pendubot/robot_description', descriptions.append, LATCHED)
        status, result = goals.result(bag)
        assert status == GoalStatus.STATUS_SUCCEEDED, result.message
        stages = list(dict.fromkeys(feedback.stage for feedback in goals.feedback))
        assert stages == ['preparing', 'checking signs, zeros and stamps']
        assert not [f for f in goals.feedback if not (0 <= f.fraction <= 1 or f.fraction != f.fraction)]
        goals.until(lambda: goals.params and goals.quality and descriptions)
        assert (bytes([result.level]), result.message) == (goals.quality[-1].level, goals.quality[-1].message)
        assert descriptions[-1].data.startswith('<?xml')
        assert '<robot name="pendubot">' in descriptions[-1].data
        status, result = goals.result('/nowhere')
        assert (status, result.level) == (GoalStatus.STATUS_ABORTED, Identify.Result.ERROR)
        assert 'there is no bag /nowhere' in result.message
        assert program.stop() == 0


def test_canceling_killing_the_node_or_killing_the_process_ends_the_computation(ros, bag):
    with Program('identifier', *parameters(**LONG)) as program, Goals(ros) as goals:

        def computing():
            """Send a goal; return its handle and the PID of the computing process."""
            handle = goals.send(bag)
            goals.until(lambda: any(f.stage == 'energy: MDE' and f.fraction >= 0 for f in goals.feedback), 60.0)
            (child,) = children(program)
            return handle, child

        handle, child = computing()
        status, result = goals.result(bag)
        assert (status, 'under way' in result.message) == (GoalStatus.STATUS_ABORTED, True)
        answer = handle.get_result_async()
        assert goals.wait(handle.cancel_goal_async()).goals_canceling
        answer = goals.wait(answer)
        assert answer.status == GoalStatus.STATUS_CANCELED
        assert answer.result.message == 'the identification was canceled'
        assert not Path(f'/proc/{child}').exists(), 'the computing process must have ended'
        assert not goals.quality, 'no result may be published'

        handle, child = computing()
        os.kill(child, 9)
        answer = goals.wait(handle.get_result_async())
        assert answer.status == GoalStatus.STATUS_ABORTED
        assert answer.result.message.startswith('the process of the identification ended with status -9')

        assert goals.set('/identifier', optimizer='lsq', generations=0).successful
        status, _ = goals.result(bag)
        assert status == GoalStatus.STATUS_SUCCEEDED
        assert goals.set('/identifier', optimizer='auto', generations=LONG['generations']).successful
        _, child = computing()
        end = os.pidfd_open(child)
        program.kill()
        assert select.select([end], [], [], 60.0)[0]
        os.close(end)
