# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The identifier in its own process: latched results, running again, failing without dying."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
import yaml

from pendubot_identification.cli.main import main
from pendubot_identification.model.parameters import NAMES, PAPER
from pendubot_identification.recordings.bag_reader import read_trajectory
from pendubot_identification.recordings.joint_states import write_trajectory
from test.processes import Program, call, parameters, run_program, spin_until
from test.virtual import recording

pytestmark = pytest.mark.ros

#: What costs little.
FAST = {'criterion': 'energy', 'model': 'viscous', 'optimizer': 'lsq'}


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    path = tmp_path_factory.mktemp('bags') / 'swing'
    assert main(['simulate', '--output', str(path)]) == 0
    return path


class Listener:
    """A node that joins when it is made, and hears what was latched."""

    def __init__(self, ros):
        from diagnostic_msgs.msg import DiagnosticArray
        from rclpy.qos import DurabilityPolicy, QoSProfile
        from std_msgs.msg import Float64MultiArray

        self.ros = ros
        self.node = ros.create_node('listener')
        self.params, self.status = [], []
        latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.node.create_subscription(Float64MultiArray, '/pendubot/params', self.params.append, latched)
        self.node.create_subscription(DiagnosticArray, '/pendubot/identification', self.status.append, latched)

    def hears(self, condition, timeout=20.0):
        return spin_until(self.node, lambda: condition(self), timeout)

    def call(self, kind, name, request):
        client = self.node.create_client(kind, name)
        try:
            return call(self.node, client, request)
        finally:
            self.node.destroy_client(client)

    def set(self, name, value):
        from rcl_interfaces.srv import SetParameters
        from rclpy.parameter import Parameter

        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        return self.call(SetParameters, '/identifier/set_parameters', request).results[0]

    def identify(self):
        from std_srvs.srv import Trigger

        return self.call(Trigger, '/identifier/identify', Trigger.Request())


@pytest.fixture
def listener(ros):
    listener = Listener(ros)
    yield listener
    listener.node.destroy_node()


def test_a_subscriber_that_joins_late_receives_the_result(ros, bag, tmp_path):
    output = tmp_path / 'result.yaml'
    named = parameters(bags=f"['{bag}@0:9']", validate=f"['{bag}@9:18']", output=output, model='viscous', hold='zero')
    with Program('identifier', *named) as node:
        node.wait_for('identified')
        late = Listener(ros)
        try:
            assert late.hears(lambda heard: heard.params and heard.status)
            (params,), (status,) = late.params, late.status[0].status
        finally:
            late.node.destroy_node()
        assert node.stop() == 0
    result = yaml.safe_load(output.read_text())
    assert params.layout.dim[0].label == 'P1,P2,P3,P4,P5,b1,b2'
    assert params.layout.dim[0].size == len(params.data) == 7
    assert list(params.data) == [result['parameters'][name]['value'] for name in NAMES[:7]]
    np.testing.assert_allclose(params.data, PAPER.vector(), rtol=0.02)
    values = {v.key: v.value for v in status.values}
    assert status.level == bytes([{'OK': 0, 'WARN': 1, 'ERROR': 2}[result['level']]])
    assert float(values['P1']) == params.data[0]
    assert float(values['P1.std_error']) == result['parameters']['P1']['std_error']
    assert values['P1.unit'] == 'kg m^2'
    assert float(values['J.training']) == result['J']['training']
    assert float(values['J.validation']) == result['J']['validation']
    assert values['criterion'] == result['criterion'] != 'energy'
    assert float(values['criteria.energy.P1']) == result['criteria']['energy']['parameters']['P1']['value']
    assert values['prediction.error'] == str(result['prediction']['error'])
    assert values['bags.0.bag'] == f'{bag}@0:9'
    assert len(values) < 150, 'matrices and single runs are in the file'
    assert not [key for key in values if 'covariance' in key or 'runs' in key.split('_')]


def test_what_a_rig_cannot_have_keeps_its_place_with_a_zero_and_is_named(bag, listener):
    with Program('identifier', *parameters(bags=f"['{bag}@0:9']", criterion='weak', model='geared', hold='zero')):
        assert listener.hears(lambda heard: heard.params and heard.status)
    (params,), (status,) = listener.params, listener.status[0].status
    assert params.layout.dim[0].label == ','.join(NAMES)
    assert len(params.data) == len(NAMES)
    assert params.data[NAMES.index('k2')] == 0
    values = {v.key: v.value for v in status.values}
    assert values['not_in_model.0'] == 'k2, for the effort of the elbow is zero throughout'
    assert not [key for key in values if key.startswith('k2')]


def test_how_far_it_is_comes_as_log_lines_and_on_diagnostics(ros, bag):
    """Lines at a decent rate, one for each step and then few; a status once a second, to the end."""
    from diagnostic_msgs.msg import DiagnosticArray

    node, heard = ros.create_node('watcher'), []
    node.create_subscription(DiagnosticArray, '/diagnostics', lambda m: heard.extend(m.status), 10)

    def latest():
        own = [status for status in heard if status.name == 'identifier: progress']
        return own[-1] if own else None

    # No more than a terminal would show, and long enough to be heard of on any machine.
    long = FAST | {'optimizer': 'mde', 'runs': 3, 'generations': 30_000, 'spread': 0.0, 'hold': 'zero'}
    try:
        with Program('identifier', *parameters(**long), env={'PENDUBOT_KERNEL': 'off'}) as program:
            assert spin_until(node, lambda: latest() and latest().message == 'waiting for ~/identify')
            listener = Listener(ros)
            try:
                assert listener.set('bags', [str(bag)]).successful
                assert listener.identify().success
            finally:
                listener.node.destroy_node()
            assert spin_until(node, lambda: latest().message.startswith('energy: MDE, '), 30.0)
            values = {v.key: v.value for v in latest().values}
            assert values['step'] == 'energy: MDE'
            assert 0 <= int(values['done']) <= int(values['of']) == 30_000
            assert float(values['J']) > 0
            assert spin_until(node, lambda: latest().message == 'identified' or latest().level != b'\x00', 60.0)
            assert not latest().values
            program.stop()
            lines = [line for line in program.lines if 'energy: MDE, ' in line]
            assert 1 <= len(lines) < 30, 'of 600 calls'
    finally:
        node.destroy_node()


def test_the_label_names_what_the_model_has(listener, bag):
    with Program('identifier', *parameters(bags=f"['{bag}@0:9']", **FAST | {'model': 'rotor'})):
        assert listener.hears(lambda heard: heard.params and heard.status)
    (params,), (status,) = listener.params, listener.status[0].status
    assert params.layout.dim[0].label == 'P1,P2,P3,P4,P5,b1,b2,Fc1,Fc2,J2'
    assert params.layout.dim[0].size == len(params.data) == 10
    values = {v.key: v.value for v in status.values}
    assert float(values['J2']) == params.data[9]
    assert values['warnings.0'] in status.message


def test_identifies_again_with_the_parameters_of_the_moment(listener, bag):
    with Program('identifier', *parameters(**FAST)) as node:
        node.wait_for('waiting: set the parameter bags')
        assert not listener.identify().success, 'no bags are named yet'
        assert listener.set('bags', [f'{bag}@0:9']).successful
        assert listener.identify().success
        assert listener.hears(lambda heard: len(heard.params) == 1)
        assert listener.set('sliding', 0.5).successful
        assert listener.identify().success
        assert listener.hears(lambda heard: len(heard.params) == len(heard.status) == 2), node.output
        levels = [status.status[0].level for status in listener.status]
        assert levels == [b'\x01', b'\x00'], 'the second time another level'
        assert list(listener.params[0].data) != list(listener.params[1].data)


def test_answers_while_it_computes(listener, bag):
    endless = {'criterion': 'energy', 'model': 'viscous', 'generations': 10_000_000, 'spread': 0.0}
    with Program('identifier', *parameters(bags=f"['{bag}']", **endless)) as node:
        node.wait_for('energy: MDE')
        answer = listener.identify()
        assert not answer.success
        assert 'under way' in answer.message
        assert not listener.params
        assert node.stop() == 0


def test_a_failure_is_published_and_the_node_lives_on(listener, bag):
    with Program('identifier', *parameters(bags="['/nowhere']", **FAST)) as node:
        node.wait_for('there is no bag /nowhere')
        assert listener.hears(lambda heard: heard.status)
        (status,) = listener.status[0].status
        assert status.level == b'\x02'
        assert 'there is no bag /nowhere' in status.message
        assert not listener.params
        assert listener.set('bags', [str(bag)]).successful
        assert listener.identify().success
        assert listener.hears(lambda heard: heard.params)


def test_what_is_read_is_never_written_over(listener, bag, tmp_path):
    swing, judge, start = (tmp_path / name for name in ('swing', 'judge', 'start.yaml'))
    shutil.copytree(bag, swing)
    shutil.copytree(bag, judge)
    start.write_text(yaml.safe_dump({'schema': 1, 'parameters': {name: {'value': 0.5} for name in NAMES[:7]}}))
    (file,) = swing.glob('*.mcap')
    read = {path: path.read_bytes() for path in (file, judge / 'metadata.yaml', start)}
    named = {'bags': f"['{swing}@0:9']", 'validate': f"['{judge}@9:18']", 'start': start, 'output': file}
    with Program('identifier', *parameters(force='true', **named, **FAST)):
        for k, path in enumerate(read):
            if k:
                assert listener.set('output', str(path)).successful
                assert listener.identify().success
            assert listener.hears(lambda heard, k=k: len(heard.status) > k)
            (status,) = listener.status[k].status
            assert status.message == f'{path} is read, so it cannot be written as well; give another name'
    assert {path: path.read_bytes() for path in read} == read


def test_an_existing_result_is_left_as_it_is_and_the_parameter_that_overwrites_it_is_named(listener, tmp_path):
    output = tmp_path / 'result.yaml'
    output.write_text('mine')
    with Program('identifier', *parameters(bags="['/nowhere']", output=output, **FAST)):
        assert listener.hears(lambda heard: heard.status)
    (status,) = listener.status[0].status
    assert status.message == (f'{output} exists already and was left as it is; choose another name or add force:=true')
    assert output.read_text() == 'mine'


def test_an_output_that_cannot_be_written_is_noticed_before_anything_is_read(listener, tmp_path):
    output = tmp_path / 'nowhere' / 'result.yaml'
    with Program('identifier', *parameters(bags="['/nowhere']", output=output, **FAST)):
        assert listener.hears(lambda heard: heard.status)
    (status,) = listener.status[0].status
    sentence = f'{output} cannot be written (No such file or directory); choose a folder that can be'
    assert (status.level, status.message) == (b'\x02', sentence)


def test_a_result_that_cannot_be_written_in_the_end_is_published_all_the_same(listener, bag, tmp_path):
    from diagnostic_msgs.msg import DiagnosticArray

    folder, heard = tmp_path / 'gone', []
    folder.mkdir()
    listener.node.create_subscription(DiagnosticArray, '/diagnostics', lambda m: heard.extend(m.status), 10)
    # Long enough for its folder to go meanwhile.
    long = FAST | {'optimizer': 'mde', 'runs': 3, 'generations': 30_000, 'spread': 0.0, 'hold': 'zero'}
    named = parameters(bags=f"['{bag}']", output=folder / 'result.yaml', **long)
    with Program('identifier', *named, env={'PENDUBOT_KERNEL': 'off'}) as program:
        program.wait_for('energy: MDE')
        folder.rmdir()
        assert listener.hears(lambda heard: heard.params and heard.status, 60.0)
        sentence = f'{folder}/result.yaml cannot be written (No such file or directory); choose a folder that can be'
        program.wait_for(sentence)
        assert spin_until(listener.node, lambda: heard and (heard[-1].level, heard[-1].message) == (b'\x02', sentence))
    ((status,),) = [message.status for message in listener.status]
    values = {v.key: v.value for v in status.values}
    assert [float(values[name]) for name in NAMES[:7]] == list(listener.params[0].data)
    assert sentence not in status.message, 'that is no judgement of the parameters'


def test_an_unphysical_result_is_published_at_level_error(listener, tmp_path, bag):
    t = read_trajectory(bag).trajectory
    write_trajectory(tmp_path / 'wrong_sign', replace(t, tau=-t.tau))
    with Program('identifier', *parameters(bags=f"['{tmp_path / 'wrong_sign'}']", **FAST)):
        assert listener.hears(lambda heard: heard.params and heard.status)
    (status,) = listener.status[0].status
    assert status.level == b'\x02'
    assert status.message.startswith('the effort has the wrong sign')
    assert 'not physical: P1 = 0 is not positive' in [pair.value for pair in status.values]


def test_a_level_of_ok_says_what_it_does_not_cover(listener, tmp_path):
    write_trajectory(tmp_path / 'dry', recording(rig=replace(PAPER, b1=0.0, b2=0.0, Fc1=0.02, Fc2=0.0005), seed=3))
    dry = {'criterion': 'weak', 'model': 'coulomb', 'optimizer': 'lsq', 'hold': 'zero'}
    with Program('identifier', *parameters(bags=f"['{tmp_path / 'dry'}']", **dry)):
        assert listener.hears(lambda heard: heard.params and heard.status)
    (status,) = listener.status[0].status
    assert status.level == b'\x00'
    said = 'use these parameters, but do not rely on b1 (on its bound), b2 (on its bound)'
    assert status.message == f'identified: {said}'
    values = {pair.key: pair.value for pair in status.values}
    assert (values['not_covered.b1'], values['not_covered.b2']) == ('on its bound', 'on its bound')


def test_parameters_of_level_error_move_no_balancer(ros, listener, tmp_path, bag):
    """They are published, and named; with accept_warn, too, the balancer refuses them."""
    from std_srvs.srv import Trigger

    t = read_trajectory(bag).trajectory
    write_trajectory(tmp_path / 'turned', replace(t, q=t.q + np.radians([5.0, 0.0]), qd=None))
    fast = {'criterion': 'weak', 'model': 'viscous', 'optimizer': 'lsq', 'hold': 'zero'}
    with Program('balancer', *parameters(accept_warn='true')) as balancer:
        balancer.wait_for('no parameters have come')
        with Program('identifier', *parameters(bags=f"['{tmp_path / 'turned'}']", **fast)):
            assert listener.hears(lambda heard: heard.params and heard.status)
            assert listener.status[0].status[0].level == b'\x02'
            balancer.wait_for("the parameters are of level ERROR (q1's zero is off by 5.0")
        answer = listener.call(Trigger, '/balancer/start', Trigger.Request())
        assert not answer.success


NONSENSE = (
    ('criterion', 'energy,magic', 'criterion is magic; one of energy, weak, trajectory'),
    ('model', 'magic', 'one of auto, viscous'),
    ('hold', 'magic', 'one of auto, zero, linear'),
    ('delay_min', 0.2, 'the delay is searched from 0.2 to 0.1 s'),
    ('start', '/nowhere.yaml', '/nowhere.yaml cannot be read'),
    ('link_length', -1.0, '-1.0'),
    ('population', 4, 'population is 4; a whole number from 5'),
    ('runs', -1, '-1'),
    ('smoothing', -1.0, '-1.0'),
    ('upper_bounds', [0.0] * 14, 'bounds of P1 are inverted or empty'),
    ('upper_bounds', [1.0] * 7, '14 lower and 7 upper bounds were given'),
    ('joint_names', ['a'], 'two are expected'),
)


def test_settings_without_sense_are_refused_with_a_reason(listener):
    with Program('identifier'):
        for name, value, reason in NONSENSE:
            answer = listener.set(name, value)
            assert not answer.successful, name
            assert reason in answer.reason


@pytest.mark.parametrize(('name', 'value', 'reason'), NONSENSE[::4])
def test_a_node_that_is_started_with_them_says_so_in_a_sentence_and_ends(name, value, reason):
    refused = run_program('identifier', *parameters(**{name: value}))
    assert refused.returncode == 1
    assert refused.stderr.count('\n') == 1
    assert reason in refused.stderr
