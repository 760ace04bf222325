"""What every node shares, in real processes: parameters that there are not, and signals at every moment."""

import signal
import subprocess
import sys
from contextlib import suppress

import pytest

from test.conftest import ROOT
from test.processes import Program, parameters, run_program

pytestmark = pytest.mark.ros
#: As the console scripts start a node, said when it is about to import ROS.
STARTED = """
import sys
from pendubot_identification import programs
class Tell:
    def find_spec(self, name, *_):
        if name == 'rclpy':
            print('importing', flush=True)
sys.meta_path.insert(0, Tell())
sys.exit(programs.bridge())
"""


@pytest.mark.parametrize(
    ('program', 'name', 'meant'),
    [('bridge', 'prt', 'port'), ('exciter', 'amplitude_maximum', 'amplitude_max'), ('recorder', 'quite_else', None)],
)
def test_a_parameter_that_there_is_not_is_refused_and_the_one_that_is_meant_is_named(program, name, meant):
    ended = run_program(program, *parameters(**{name: 1.0}))
    assert ended.returncode == 1
    (sentence,) = ended.stderr.splitlines()
    asked = f'is {meant} meant' if meant else 'which is meant'
    assert sentence == f'{program}: {program} has no parameter {name}; {asked}? --help lists them all'


def test_degrees_are_no_radians():
    ended = run_program('bridge', *parameters(zero='[-90.0, 0.0]'))
    assert ended.returncode == 1
    assert ended.stderr == (
        'bridge: zero is -90.0; a list of numbers with decimal points from -7 to 7 rad is expected\n'
    )


def test_the_same_in_a_parameter_file(tmp_path):
    file = tmp_path / 'mine.yaml'
    file.write_text('bridge:\n  ros__parameters:\n    torque_limt: 0.1\n')
    ended = run_program('bridge', '--ros-args', '--params-file', file)
    assert ended.returncode == 1
    assert 'has no parameter torque_limt; is torque_limit meant' in ended.stderr


def test_parameters_that_ros_itself_knows_are_none_of_these(tmp_path):
    with Program('bridge', *parameters(port=tmp_path / 'board', use_sim_time='false')) as bridge:
        bridge.wait_for('missing')
        assert bridge.stop() == 0


@pytest.mark.parametrize('second', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_more_signals_than_one_change_no_exit_status(tmp_path, second):
    with Program('bridge', *parameters(port=tmp_path / 'board')) as bridge:
        bridge.wait_for('missing')
        bridge.process.send_signal(signal.SIGINT)
        while bridge.process.poll() is None:
            with suppress(subprocess.TimeoutExpired):
                bridge.process.wait(0.003)
            bridge.process.send_signal(second)
        assert bridge.process.returncode == 0
        assert 'Traceback' not in bridge.output


def test_a_closed_terminal_is_nothing_to_who_was_started_by_nohup(tmp_path):
    options = parameters(port=tmp_path / 'board')
    with Program('bridge', *options, before=('nohup',)) as bridge:
        bridge.wait_for('missing')
        bridge.process.send_signal(signal.SIGHUP)
        with pytest.raises(subprocess.TimeoutExpired):
            bridge.process.wait(1.0)
        assert bridge.stop(signal.SIGTERM) == 0


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_it_starts_is_no_failure(number):
    process = subprocess.Popen(
        [sys.executable, '-c', STARTED], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == 'importing\n'
    process.send_signal(number)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 0
    assert said == ''
