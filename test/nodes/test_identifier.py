# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The identifier in its own process: latched results, running again, failing without dying."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from pendubot_identification.cli.main import main
from pendubot_identification.model.parameters import NAMES, PAPER
from pendubot_identification.nodes.messages import LATCHED
from pendubot_identification.recordings.bag_reader import read_trajectory
from pendubot_identification.recordings.joint_states import write_trajectory
from pendubot_identification.trajectories.trajectory import Trajectory
from test.processes import Program, call, parameters, spin_until
from test.virtual import recording

pytestmark = pytest.mark.ros

#: What costs little, and what else the tests change.
FAST = {'criterion': 'energy', 'model': 'viscous', 'optimizer': 'lsq', 'hold': 'zero', 'sliding': 0.0}
FAST |= {'columns': '', 'apply_remedies': False, 'validate': [''], 'output': '', 'force': False, 'start': ''}
OK, WARN, ERROR = b'\x00', b'\x01', b'\x02'


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    path = tmp_path_factory.mktemp('bags') / 'swing'
    assert main(['simulate', '--output', str(path)]) == 0
    return path


class Listener:
    """A node that joins when it is made, hears what was latched, sets parameters and calls for an identification."""

    def __init__(self, ros):

        self.node = ros.create_node('listener')
        self.params, self.status, self.progress = [], [], []
        self.node.create_subscription(Float64MultiArray, '/pendubot/params', self.params.append, LATCHED)
        self.node.create_subscription(
            DiagnosticArray, '/pendubot/identification', lambda m: self.status.extend(m.status), LATCHED
        )
        self.node.create_subscription(DiagnosticArray, '/diagnostics', lambda m: self.progress.extend(m.status), 10)

    def hears(self, condition, timeout=20.0):
        return spin_until(self.node, condition, timeout)

    def call(self, kind, name, request):
        client = self.node.create_client(kind, name)
        try:
            return call(self.node, client, request)
        finally:
            self.node.destroy_client(client)

    def set(self, **values):
        """Return the first answer that refuses, or the last."""
        request = SetParameters.Request(
            parameters=[Parameter(n, value=v).to_parameter_msg() for n, v in values.items()]
        )
        results = self.call(SetParameters, '/identifier/set_parameters', request).results
        return next((result for result in results if not result.successful), results[-1])

    def identify(self):
        return self.call(Trigger, '/identifier/identify', Trigger.Request())

    def identified(self, *bags, **values):
        """Have these bags identified; return the status, its values, and the parameters where there are any."""
        answer = self.set(**FAST | {'bags': [str(bag) for bag in bags]} | values)
        assert answer.successful, answer.reason
        self.params.clear()
        self.status.clear()
        assert self.hears(lambda: self.identify().success), 'what went before has not ended'
        assert self.hears(lambda: self.status)
        (status,) = self.status
        if status.values:
            assert self.hears(lambda: self.params)
        return status, {pair.key: pair.value for pair in status.values}, self.params


def test_while_it_computes_it_answers_and_says_how_far_it_is_and_a_result_that_cannot_be_written_is_published(
    ros, bag, tmp_path
):
    """Lines at a decent rate, one for each step and then few; a status once a second, to the end."""
    folder = tmp_path / 'gone'
    folder.mkdir()
    # Long enough to be heard of on any machine, and for its folder to go meanwhile.
    long = {'criterion': 'energy', 'model': 'viscous', 'runs': 3, 'generations': 15_000, 'spread': 0.0, 'hold': 'zero'}
    listener = Listener(ros)

    def latest():
        return next((s for s in reversed(listener.progress) if s.name == 'identifier: progress'), None)

    with Program(
        'identifier', *parameters(output=folder / 'result.yaml', **long), env={'PENDUBOT_KERNEL': 'off'}
    ) as it:
        it.wait_for('waiting: set the parameter bags')
        assert not listener.identify().success, 'no bags are named yet'
        assert listener.hears(lambda: latest() and latest().message == 'waiting for ~/identify')
        assert listener.set(bags=[str(bag)]).successful
        assert listener.identify().success
        it.wait_for('energy: MDE')
        folder.rmdir()
        answer = listener.identify()
        assert not answer.success
        assert 'under way' in answer.message
        assert listener.hears(lambda: latest().message.startswith('energy: MDE, '))
        values = {v.key: v.value for v in latest().values}
        assert values['step'] == 'energy: MDE'
        assert 0 <= int(values['done']) <= int(values['of']) == 15_000
        assert float(values['J']) > 0
        assert not listener.params
        assert listener.hears(lambda: listener.params and listener.status, 60.0)
        sentence = f'{folder}/result.yaml cannot be written (No such file or directory); choose a folder that can be'
        it.wait_for(sentence)
        assert listener.hears(lambda: (latest().level, latest().message) == (ERROR, sentence))
        assert not latest().values
        lines = [line for line in it.lines if 'energy: MDE, ' in line]
        assert 1 <= len(lines) < 30, 'of hundreds of calls'
        (status,) = listener.status
        values = {v.key: v.value for v in status.values}
        assert [float(values[name]) for name in NAMES[:7]] == list(listener.params[0].data)
        assert sentence not in status.message, 'that is no judgement of the parameters'
        assert listener.set(output='').successful
        assert listener.identify().success
        it.wait_for('energy: MDE')
        assert it.stop() == 0, 'a computation that is under way is left'
    listener.node.destroy_node()


@pytest.fixture(scope='module')
def listener(ros):
    """One that is served by an identifier which lives through all these tests."""
    with Program('identifier') as program:
        program.wait_for('waiting: set the parameter bags')
        listener = Listener(ros)
        yield listener
        listener.node.destroy_node()
        assert program.stop() == 0, program.output


def test_a_subscriber_that_joins_late_receives_the_result(ros, bag, tmp_path, listener):
    output = tmp_path / 'result.yaml'
    named = {'validate': [f'{bag}@9:18'], 'output': str(output), 'criterion': 'energy,weak,likelihood'}
    listener.identified(f'{bag}@0:9', **named)
    late = Listener(ros)
    try:
        assert late.hears(lambda: late.params and late.status)
        (params,), (status,) = late.params, late.status
    finally:
        late.node.destroy_node()
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
    assert float(values['criteria.energy.J.validation']) == result['criteria']['energy']['J']['validation']
    assert values['criterion'] == result['criterion'] != 'energy'
    assert float(values['criteria.energy.P1']) == result['criteria']['energy']['parameters']['P1']['value']
    assert values['prediction.error'] == str(result['prediction']['error'])
    assert values['bags.0.bag'] == f'{bag}@0:9'
    assert len(values) < 170, 'matrices and single runs are in the file'
    assert not [key for key in values if 'covariance' in key or 'runs' in key.split('_')]


def test_what_a_rig_cannot_have_keeps_its_place_with_a_zero_and_is_named(bag, listener):
    _, values, (params,) = listener.identified(f'{bag}@0:9', criterion='weak', model='geared')
    assert params.layout.dim[0].label == ','.join(NAMES)
    assert len(params.data) == len(NAMES)
    assert params.data[NAMES.index('k2')] == 0
    assert values['not_in_model.0'] == 'k2, for the effort of the elbow is zero throughout'
    assert not [key for key in values if key.startswith('k2')]


def test_identifies_again_with_the_parameters_of_the_moment(bag, listener):
    status, values, (params,) = listener.identified(f'{bag}@0:9', model='rotor')
    assert params.layout.dim[0].label == 'P1,P2,P3,P4,P5,b1,b2,Fc1,Fc2,J2'
    assert float(values['J2']) == params.data[9]
    assert status.level == OK
    status, values, _ = listener.identified(f'{bag}@0:9', model='viscous', criterion='energy')
    assert status.level == WARN
    assert values['warnings.0'] in status.message


def test_a_file_with_columns_is_identified_and_remedies_are_applied(bag, tmp_path, listener):
    motion = read_trajectory(bag).trajectory
    rows = np.column_stack([1000 * motion.t, motion.q[:, 0], -motion.q[:, 1], motion.tau[:, 0]])
    np.savetxt(tmp_path / 'run.csv', rows, delimiter=',', header='time,q1,q2,tau1', comments='', fmt='%.17g')
    _, plain, _ = listener.identified(bag, criterion='weak')
    as_it_is, *_ = listener.identified(tmp_path / 'run.csv', criterion='weak', columns='t=time')
    assert as_it_is.message.endswith('add --time-unit ms')
    _, values, _ = listener.identified(tmp_path / 'run.csv', criterion='weak', columns='t=time', apply_remedies=True)
    assert [values[f'made_by.applied.{k}'] for k in (0, 1)] == ['--time-unit ms', '--negate q2']
    for name in NAMES[:7]:
        assert float(values[name]) == pytest.approx(float(plain[name]), rel=1e-6)


def test_what_is_read_is_never_written_over(bag, tmp_path, listener):
    swing, judge, start = (tmp_path / name for name in ('swing', 'judge', 'start.yaml'))
    shutil.copytree(bag, swing)
    shutil.copytree(bag, judge)
    start.write_text(yaml.safe_dump({'schema': 1, 'parameters': {name: {'value': 0.5} for name in NAMES[:7]}}))
    (file,) = swing.glob('*.mcap')
    read = {path: path.read_bytes() for path in (file, judge / 'metadata.yaml', start)}
    for path in read:
        named = {'validate': [f'{judge}@9:18'], 'start': str(start), 'output': str(path), 'force': True}
        status, *_ = listener.identified(f'{swing}@0:9', **named)
        assert status.message == f'{path} is read, so it cannot be written as well; give another name'
    assert {path: path.read_bytes() for path in read} == read


def test_what_fails_is_published_before_anything_is_read(tmp_path, listener):
    output = tmp_path / 'result.yaml'
    output.write_text('mine')
    for bad, sentence in (
        ('', 'there is no bag /nowhere'),
        (output, f'{output} exists already and was left as it is; choose another name or add force:=true'),
        (
            tmp_path / 'no' / 'file',
            f'{tmp_path}/no/file cannot be written (No such file or directory); choose a folder that can be',
        ),
    ):
        status, _, params = listener.identified('/nowhere', output=str(bad))
        assert (status.level, params) == (ERROR, [])
        assert status.message.startswith(sentence)
    assert output.read_text() == 'mine'


def test_a_recording_that_is_too_long_is_refused_with_what_names_its_windows(tmp_path, listener):
    t = np.arange(6020) / 10
    write_trajectory(tmp_path / 'day', Trajectory(t, np.sin(np.column_stack([t, 2 * t])), np.zeros((len(t), 2))))
    status, _, params = listener.identified(tmp_path / 'day')
    assert (status.level, params) == (b'\x02', [])
    assert 'it lasts 602 s, and at most 600 s are taken at once; take windows of it, such as' in status.message
    assert status.message.endswith(f'pendubot track {tmp_path / "day"} names good ones')


def test_an_unphysical_result_is_published_at_level_error(bag, tmp_path, listener):
    t = read_trajectory(bag).trajectory
    write_trajectory(tmp_path / 'wrong_sign', replace(t, tau=-t.tau))
    status, values, (_,) = listener.identified(tmp_path / 'wrong_sign')
    assert status.level == ERROR
    assert status.message.startswith('the effort has the wrong sign')
    assert 'not physical: P1 = 0 is not positive' in values.values()


def test_a_level_of_ok_says_what_it_does_not_cover(tmp_path, listener):
    write_trajectory(tmp_path / 'dry', recording(rig=replace(PAPER, b1=0.0, b2=0.0, Fc1=0.02, Fc2=0.0005), seed=3))
    status, values, _ = listener.identified(tmp_path / 'dry', criterion='weak', model='coulomb')
    assert status.level == OK
    assert status.message.startswith('identified: the 95 % intervals hold, given ')
    assert '; do not rely on ' in status.message
    assert 'b1 (on its bound), b2 (on its bound)' in status.message
    assert (values['not_covered.b1'], values['not_covered.b2']) == ('on its bound', 'on its bound')


@pytest.mark.parametrize(
    ('name', 'value', 'reason'),
    [
        ('criterion', 'energy,magic', 'criterion is magic; one of energy, weak, likelihood'),
        ('model', 'magic', 'one of auto, viscous'),
        ('hold', 'magic', 'one of auto, zero, linear'),
        ('delay_min', 0.2, 'the delay is searched from 0.2 to 0.1 s'),
        ('start', '/nowhere.yaml', '/nowhere.yaml cannot be read'),
        ('link_length', -1.0, '-1.0'),
        ('population', 4, 'population is 4; a whole number from 5'),
        ('upper_bounds', [-1.0] * 14, 'bounds of P1 are inverted'),
        ('upper_bounds', [1.0] * 7, '14 lower and 7 upper bounds were given'),
        ('joint_names', ['a'], 'two are expected'),
    ],
)
def test_settings_without_sense_are_refused_with_a_reason(listener, name, value, reason):
    answer = listener.set(**{name: value})
    assert not answer.successful
    assert reason in answer.reason
