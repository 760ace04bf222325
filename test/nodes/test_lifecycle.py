# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The lifecycle of the nodes, through the services that ``ros2 lifecycle`` calls."""

import shutil
from contextlib import ExitStack

import numpy as np
import pytest
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from pendubot_identification.recordings.bag_reader import read_trajectory
from test.conftest import SAMPLE
from test.nodes.conftest import FAST, PULSES
from test.nodes.observer import Observer
from test.processes import Program, parameters
from test.rig import ARMED, PATIENT, WATCHDOG

MANAGED = 'bridge', 'recorder', 'identifier', 'tracker'
ROUND = 'configure', 'activate', 'deactivate', 'cleanup'
STATES = dict(zip(ROUND, ('inactive', 'active', 'inactive', 'unconfigured'), strict=True))
IMPOSSIBLE = {'inactive': 'configure', 'active': 'activate', 'unconfigured': 'deactivate'}


class Manager(Observer):
    def state(self, node):
        return self.call(GetState, f'/{node}/get_state').current_state.label

    def change(self, node, label):
        """Request a transition; return whether the state changed, also if the first answer was lost."""
        before = self.state(node)
        success = self.call(ChangeState, f'/{node}/change_state', transition=Transition(label=label)).success
        return success or self.state(node) != before

    def end(self, node, program):
        """Request the shutdown of a node whose state was changed; return its exit status. The answer may be lost."""
        request = ChangeState.Request(transition=Transition(label='shutdown'))
        self._clients[f'/{node}/change_state'].call_async(request)
        return program.process.wait(30)


@pytest.fixture
def manager(ros):
    with Manager(ros) as manager:
        yield manager


def test_every_node_can_be_configured_again_and_refuses_invalid_transitions(manager, tmp_path):
    own = {'bridge': {'port': tmp_path / 'board'}, 'recorder': {'output': tmp_path / 'bag'}}
    with ExitStack() as stack:
        programs = {
            name: stack.enter_context(Program(name, *parameters(autostart='false', **own.get(name, {}))))
            for name in MANAGED
        }
        for name, program in programs.items():
            program.wait_for(f'waiting: ros2 lifecycle set /{name} configure')
            assert 'read-only' in manager.set(f'/{name}', autostart=True).reason
            for label in (*ROUND, *ROUND[:2]):
                if label == 'configure':
                    shutil.rmtree(tmp_path / 'bag', ignore_errors=True)
                assert manager.change(name, label), program.output
                assert not manager.change(name, IMPOSSIBLE[STATES[label]])
                assert manager.state(name) == STATES[label]
            assert manager.end(name, program) == 0, program.output


def test_a_failed_configuration_gives_the_reason_and_leaves_the_node_unconfigured(manager, tmp_path):
    with Program('recorder', *parameters(autostart='false', output=tmp_path)) as program:
        assert not manager.change('recorder', 'configure')
        program.wait_for(f'{tmp_path} exists already')
        assert manager.state('recorder') == 'unconfigured'
        assert manager.set('/recorder', output=str(tmp_path / 'bag')).successful
        assert manager.change('recorder', 'configure'), program.output
        refused = manager.set('/recorder', output=str(tmp_path / 'other'))
        assert refused.reason.startswith('output is read when the node is configured; before you set it call ros2')
        assert program.stop() == 0
    assert (tmp_path / 'bag' / 'metadata.yaml').exists()


def test_deactivating_the_bridge_disarms_and_only_an_active_bridge_is_armed(rig, manager):
    r = rig()
    r.start_board()
    bridge = r.start_bridge(*PATIENT)
    r.until_samples()
    assert r.call('arm').success
    r.drive_until(0.2, lambda: r.samples[-1][6] == 0.2)
    assert manager.change('bridge', 'deactivate')
    r.until(lambda: r.trace()[-1, 3:].tolist() == [0, 0])
    assert not (r.trace()[:, 4] & WATCHDOG).any(), 'disarmed by the watchdog instead of by command'
    answer = r.call('arm')
    assert not answer.success
    assert 'the bridge is inactive; call ros2 lifecycle set /bridge activate' in answer.message
    r.until(lambda: r.diagnoses and r.diagnoses[-1].message.startswith('inactive; '))
    rows = len(r.trace())
    r.drive_until(0.2, lambda: len(r.trace()) > rows + 100)
    received = len(r.samples)  # including samples in transit
    r.drive_until(0.2, lambda: len(r.trace()) > rows + 200)
    assert len(r.samples) == received, 'an inactive bridge must publish no joint states'
    assert not (r.trace()[rows:, 4] & ARMED).any()
    assert manager.change('bridge', 'activate')
    r.until_samples()
    rows = len(r.trace())
    r.drive_until(0.2, lambda: len(r.trace()) > rows + 50)
    assert not r.trace()[rows:, 3].any(), 'no torque before the motor is armed again'
    assert r.call('arm').success
    r.drive_until(0.2, lambda: r.samples[-1][6] == 0.2)
    assert manager.change('bridge', 'shutdown')
    assert bridge.process.wait(10) == 0
    r.until(lambda: not r.trace()[-1, 4] & ARMED)
    assert not (r.trace()[:, 4] & WATCHDOG).any()


def test_the_exciter_moves_the_rig_only_while_an_active_recorder_writes_one_bag(manager, rig, tmp_path):
    r = rig()
    r.start_board()
    r.start_bridge(*PATIENT)
    recorder = r.start('recorder', *parameters(output=tmp_path / 'bag'))

    def reported(name):
        return float(manager.reported('recorder').get(f'/joint_states {name}', 0.0))

    manager.until(lambda: reported('messages') > 100)
    assert manager.change('recorder', 'deactivate')
    manager.until(lambda: reported('rate [Hz]') == 0 and manager.status('recorder').message.startswith('inactive; '))
    exciter = r.start('exciter', *parameters(arm='true', recorded='true', **PULSES))
    exciter.wait_for('waiting for a recorder of /joint_states')
    assert not (r.trace()[:, 4] & ARMED).any()
    assert r.call('arm').success
    rows = len(r.trace())
    r.until(lambda: len(r.trace()) > rows + 100)
    assert not r.trace()[:, 3].any()
    assert manager.change('recorder', 'activate')
    exciter.wait_for('exciting')
    r.until(lambda: read_trajectory(tmp_path / 'bag').trajectory.tau.any())
    assert reported('lost') == 0, 'messages during the pause must not count as lost'
    recorder.kill()
    exciter.wait_for('stopped: nothing was recorded for 5 s; check the recorder')
    assert exciter.process.wait(10) == 1
    r.until(lambda: not r.trace()[-1, 4] & ARMED)
    recorded = read_trajectory(tmp_path / 'bag').trajectory
    (pause,) = np.flatnonzero(np.diff(recorded.t) > 0.5)
    assert not recorded.tau[: pause + 2].any(), 'the rig moved before it was recorded'


def test_inactive_identifiers_and_trackers_are_idle(manager):
    with Program('identifier', *parameters(bags=f'[{SAMPLE}]', autostart='false', **FAST)) as program:
        assert manager.change('identifier', 'configure')
        answer = manager.call(Trigger, '/identifier/identify')
        assert (answer.success, 'the identifier is inactive' in answer.message) == (False, True)
        assert not manager.params
        assert manager.change('identifier', 'activate')
        manager.until(lambda: manager.params, 60.0)
        assert program.stop() == 0
    publisher = manager.node.create_publisher(JointState, '/joint_states', 10)
    message = JointState(name=['shoulder', 'elbow'], position=[0.0, 0.0], effort=[0.0, 0.0])

    def samples():
        """Publish a sample; return the number of samples that the tracker has used."""
        message.header.stamp = manager.node.get_clock().now().to_msg()
        publisher.publish(message)
        return int(manager.reported('tracker').get('samples', 0))

    with Program('tracker') as program:
        manager.until(samples)
        assert manager.change('tracker', 'deactivate')
        manager.until(lambda: manager.status('tracker').message.startswith('inactive; '))
        before = samples()
        manager.statuses.clear()
        manager.until(lambda: samples() and len([s for s in manager.statuses if s.name == 'tracker']) > 1)
        assert samples() == before
        assert program.stop() == 0
