# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The identifier in its own process: service and action, latched results, failures that do not end it."""

import os
import re
import select
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml
from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from std_msgs.msg import String
from std_srvs.srv import Trigger

from pendubot_identification.errors import PendubotError
from pendubot_identification.model.parameters import NAMES, PAPER
from pendubot_identification.nodes.messages import LATCHED
from pendubot_identification.results.computation import Computation
from pendubot_identification.results.options import settings_of
from test.nodes.conftest import FAST
from test.nodes.observer import Observer, values
from test.processes import Program, parameters

#: Fast options, and the defaults of the options that tests change.
USUAL = FAST | {'validate': [''], 'output': '', 'force': False, 'negate': ''}
ERROR = b'\x02'
PROGRESS = 'identifier: progress'


class Client(Observer):
    """Requests identifications and waits for their end."""

    def __init__(self, ros):
        super().__init__(ros)
        self.client = self.node.create_client(Trigger, '/identifier/identify')

    def identify(self):
        """Request an identification; return the future of the answer."""
        self.until(self.client.service_is_ready)
        return self.client.call_async(Trigger.Request())

    def begin(self):
        """Request an identification; return the future of the answer after the computation has begun."""
        before = self.program.output.count('preparing')
        future = self.identify()
        self.until(lambda: self.program.output.count('preparing') > before)
        return future

    def identified(self, *bags, **given):
        """Identify these bags; return the status, its values, and the published parameters."""
        answer = self.set('/identifier', **USUAL | {'bags': [str(bag) for bag in bags]} | given)
        assert answer.successful, answer.reason
        self.params.clear()
        self.quality.clear()
        answer = self.wait(self.identify())
        self.until(lambda: self.quality)
        (status,) = self.quality
        assert (answer.success, answer.message) == (status.level != ERROR, status.message)
        if status.values:
            self.until(lambda: self.params)
        return status, values(status), self.params


def test_an_identification_that_is_canceled_at_once_is_reported_as_canceled():
    for _ in range(5):
        computation = Computation()
        computation.stop()
        with pytest.raises(PendubotError, match='the identification was canceled'):
            computation.run(['bag'], [], settings_of({}), print)


@pytest.fixture(scope='module')
def client(ros, bag):
    """A client of one identifier for all following tests."""
    with Program('identifier') as program, Client(ros) as client:
        program.wait_for('waiting: set the parameter bags')
        client.program = program
        yield client
        assert client.set('/identifier', **USUAL, bags=[str(bag)]).successful
        client.begin()
        assert program.stop() == 0, 'a signal must cancel a running computation'


def test_a_subscriber_that_joins_late_receives_the_result(ros, bag, tmp_path, client):
    output = tmp_path / 'result.yaml'
    options = {'validate': [f'{bag}@9:18'], 'output': str(output), 'criterion': 'energy,weak'}
    client.identified(f'{bag}@0:9', **options)
    with Observer(ros) as late:
        late.until(lambda: late.params and late.quality)
        (params,), (status,) = late.params, late.quality
    result = yaml.safe_load(output.read_text())
    assert params.layout.dim[0].label == 'P1,P2,P3,P4,P5,b1,b2'
    assert params.layout.dim[0].size == len(params.data) == 7
    assert list(params.data) == [result['parameters'][name]['value'] for name in NAMES[:7]]
    np.testing.assert_allclose(params.data, PAPER.vector(), rtol=0.02)
    assert status.level == bytes([{'OK': 0, 'WARN': 1, 'ERROR': 2}[result['level']]])
    published = values(status)
    assert float(published['P1']) == params.data[0]
    assert float(published['P1.std_error']) == result['parameters']['P1']['std_error']
    assert published['P1.unit'] == 'kg m^2'
    assert float(published['J.training']) == result['J']['training']
    assert published['criterion'] == result['criterion'] != 'energy'
    energy = result['criteria']['energy']
    assert float(published['criteria.energy.P1']) == energy['parameters']['P1']['value']
    assert float(published['criteria.energy.J.validation']) == energy['J']['validation']
    assert published['prediction.error'] == str(result['prediction']['error'])
    assert published['bags.0.bag'] == f'{bag}@0:9'
    assert len(published) < 175, 'matrices and single runs must be in the file alone'
    assert not [key for key in published if 'covariance' in key or 'runs' in key.split('_')]


def test_parameters_without_influence_are_named(bag, client):
    _, published, (params,) = client.identified(f'{bag}@0:9', model='geared')
    assert params.layout.dim[0].label == ','.join(NAMES)
    assert len(params.data) == len(NAMES)
    assert params.data[NAMES.index('k2')] == 0
    assert published['not_in_model.0'] == 'k2, because the effort of the elbow is always zero'
    assert not [key for key in published if key.startswith('k2')]


def test_failures_are_published_and_answered_and_no_file_is_overwritten(bag, tmp_path, client):
    output, swing = tmp_path / 'result.yaml', tmp_path / 'swing'
    output.write_text('mine')
    shutil.copytree(bag, swing)
    (file,) = swing.glob('*.mcap')
    before = file.read_bytes()
    for bags, options, sentence in (
        ('/nowhere', {'output': str(output)}, f'{output} exists already and was left as it is; choose another name or'),
        (swing, {'output': str(file), 'force': True}, f'{file} is read, so it cannot be written as well; give another'),
    ):
        status, _, params = client.identified(bags, **options)
        assert (status.level, params) == (ERROR, [])
        assert sentence in status.message
    assert output.read_text() == 'mine'
    assert file.read_bytes() == before


def test_a_result_that_cannot_be_written_is_published(bag, tmp_path, client):
    folder = tmp_path / 'gone'
    folder.mkdir()
    given = {'bags': [str(bag)], 'output': str(folder / 'result.yaml'), 'criterion': 'energy'}
    assert client.set('/identifier', **USUAL | given).successful
    client.params.clear()
    client.quality.clear()
    ending = client.begin()
    folder.rmdir()
    answer = client.wait(ending)
    sentence = f'{folder}/result.yaml cannot be written (No such file or directory); choose another folder'
    assert (answer.success, answer.message) == (False, sentence)
    client.until(lambda: (client.status(PROGRESS).level, client.status(PROGRESS).message) == (ERROR, sentence))
    (status,), (params,) = client.quality, client.params
    assert [float(values(status)[name]) for name in NAMES[:7]] == list(params.data)
    assert sentence not in status.message, 'the quality of the parameters does not depend on the file'


def test_an_unphysical_result_is_published_at_level_error(bag, client):
    status, published, (params,) = client.identified(f'{bag}@0:9', negate='tau1', criterion='energy')
    assert status.level == ERROR
    assert len(params.data) == 7, 'with the present settings'
    assert status.message.startswith('the effort has the wrong sign')
    assert 'not physical: P1 = 0 is not positive' in published.values()


class Goals:
    """Sends goals, and collects their feedback; skips the test without the action's package."""

    def __init__(self, observer):
        actions = pytest.importorskip('pendubot_interfaces.action', reason='make .venv/.interfaces builds it')
        self.action, self.observer, self.feedback = actions.Identify, observer, []
        self.client = ActionClient(observer.node, self.action, 'identifier/identify')
        observer.until(self.client.server_is_ready, 60.0)

    def send(self, bag):
        """Send a goal with this bag; return its handle after acceptance."""
        self.feedback.clear()
        goal = self.action.Goal(bags=[str(bag)])
        handle = self.observer.wait(self.client.send_goal_async(goal, lambda m: self.feedback.append(m.feedback)))
        assert handle.accepted
        return handle

    def result(self, bag):
        answer = self.observer.wait(self.send(bag).get_result_async())
        return answer.status, answer.result


def test_a_goal_is_identified_with_feedback_and_failures_give_a_reason(bag, client):
    goals, descriptions = Goals(client), []
    assert client.set('/identifier', **USUAL).successful
    client.node.create_subscription(String, '/pendubot/robot_description', descriptions.append, LATCHED)
    for received in (client.params, client.quality):
        received.clear()
    status, result = goals.result(bag)
    assert status == GoalStatus.STATUS_SUCCEEDED, result.message
    stages = list(dict.fromkeys(feedback.stage for feedback in goals.feedback))
    assert stages == ['preparing', 'checking signs, zeros and stamps']
    assert not [f for f in goals.feedback if not (0 <= f.fraction <= 1 or f.fraction != f.fraction)]
    client.until(lambda: client.params and client.quality and descriptions)
    assert (bytes([result.level]), result.message) == (client.quality[-1].level, client.quality[-1].message)
    assert '<robot name="pendubot">' in descriptions[-1].data
    status, result = goals.result('/nowhere')
    assert (status, result.level) == (GoalStatus.STATUS_ABORTED, result.ERROR)
    assert 'there is no bag /nowhere' in result.message


def test_a_computation_reports_progress_and_ends_if_it_is_canceled_or_a_process_is_killed(ros, bag):
    # It lasts minutes, in one stage of many generations; in a namespace beside the other identifier.
    minutes = FAST | {'criterion': 'energy', 'optimizer': 'auto', 'generations': 10_000_000, 'spread': 0.0}
    program = Program('identifier', *parameters(**minutes, topic='/joint_states'), '-r', '__ns:=/lab1')
    with program, Observer(ros, '/lab1') as observer:
        goals = Goals(observer)

        def shows(progress):
            """Wait for a message on the progress."""
            observer.until(lambda: re.fullmatch(progress, getattr(observer.status(f'lab1/{PROGRESS}'), 'message', '')))

        def refusal():
            answer = observer.call(Trigger, 'identifier/identify')
            return '' if answer.success else answer.message

        shows('waiting for ~/identify')
        assert 'no bags are named' in refusal()

        def computing():
            """Send a goal; return its handle and the PID of the computing process."""
            handle = goals.send(f'{bag}@0:3')
            observer.until(lambda: any(f.stage == 'energy: MDE' and f.fraction >= 0 for f in goals.feedback), 60.0)
            (child,) = program.children()
            return handle, child

        handle, child = computing()
        shows(r'energy: MDE, \d+ of 10000000, J = \S+')
        assert 'under way' in refusal()
        assert sum('energy: MDE, ' in line for line in program.lines) == 1, 'the log must have one line per stage'
        answer = handle.get_result_async()
        assert observer.wait(handle.cancel_goal_async()).goals_canceling
        answer = observer.wait(answer)
        assert answer.status == GoalStatus.STATUS_CANCELED
        assert answer.result.message == 'the identification was canceled'
        assert not Path(f'/proc/{child}').exists(), 'the computing process must have ended'
        assert not observer.quality, 'no result may be published'

        handle, child = computing()
        os.kill(child, 9)
        answer = observer.wait(handle.get_result_async())
        assert answer.status == GoalStatus.STATUS_ABORTED
        assert answer.result.message.startswith('the process of the identification ended with status -9')

        _, child = computing()
        end = os.pidfd_open(child)
        program.kill()
        assert select.select([end], [], [], 60.0)[0]
        os.close(end)
