# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Common behaviour of all nodes in real processes: invalid parameters, clocks, and signals at any time."""

import itertools
import json
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import yaml
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import Parameter as ParameterMessage
from rclpy.parameter import Parameter, get_parameter_value, parameter_dict_from_yaml_file, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rosgraph_msgs.msg import Clock

from test.conftest import ROOT, SAMPLE
from test.processes import Program, parameters, spin_until

#: Invalid settings: program, parameters, and a part of the expected message.
REFUSED = [
    ('bridge', {'prt': 1.0}, 'bridge: bridge has no parameter prt; is port meant? --help lists them all'),
    ('bridge', {'sign': '[1, 0]'}, 'sign holds a 0'),
    ('bridge', {'joint_names': '[a, a]'}, 'different names'),
    ('exciter', {'amplitude_min': 1.0, 'amplitude_max': -1.0}, 'amplitude_min 1 is not below amplitude_max -1'),
    ('exciter', {'period': 'soon'}, 'period is soon'),
    ('exciter', {'use_sim_time': 1}, "'use_sim_time' to '1' of type 'INTEGER', expecting type 'BOOL'"),
    # Integers are valid numbers, and so is 1e9, a string in YAML 1.1.
    ('exciter', {'period': 7, 'hold': '1e9'}, 'hold is 1000000000.0; a number from 0.0001 to 60 s is expected'),
    ('bridge', {'zero': '[0, 9]'}, 'zero is 9.0; a list of numbers from -7 to 7 rad is expected'),
    ('recorder', {'output': '/dev/null/bag'}, 'cannot be written'),
    ('recorder', {'topics': '["two words"]'}, 'name topics such as joint_states'),
    ('recorder', {'topics': '[""]'}, 'name at least one topic'),
    ('recorder', {'reserve': 2**60}, 'is not begun: its disk has'),
    ('identifier', {'delay': '[0.2, 0.1]'}, 'the delay is searched from 0.2 to 0.1 s'),
    ('identifier', {'bounds': '[P1]'}, "P1 '' is not understood; LOW:HIGH or one number is expected, such as P1=0:0.5"),
    ('identifier', {'joint_names': '[a]'}, 'joint_names has 1 values; 2 are expected'),
    ('tracker', {'start': '/none.yaml'}, 'there is no file /none.yaml'),
    # No shell expands a ~ after NAME:=.
    ('recorder', {'output': '~/'}, f'{Path.home()} exists already'),
    ('player', {'bag': '~/none@0:9'}, f'there is no bag {Path.home()}/none;'),
    ('player', {'bag': "''"}, 'bag is empty; give the folder of a bag'),
    ('player', {'bag': f'{SAMPLE}@50:60'}, '@50:60: the bag lasts 17.988 s; give a START within it'),
    ('player', {'bag': SAMPLE, 'topics': '[/other]'}, 'has no messages on /other; its topics are /joint_states'),
]
#: Invalid arguments of the virtual board, and a part of the expected message.
REFUSED_BY_THE_BOARD = {
    '--rate 0': '--rate is 0 Hz',
    '--duration nan': '--duration is nan s',
    '--fault rust=1': "no fault 'rust'",
    '--fault bit_flip=1.5': 'bit_flip is 1.5; a number from 0 to 1 is expected',
    '--fault reset_at=-1': 'reset_at is -1',
    '--counts 0': 'counts is 0',
    '--torque-limit nan': 'torque_limit is nan',
    '--limit heat=1': "no limit 'heat'; the limits are torque_slew, max_speed",
    '--limit stall_ms=70000': 'stall_ms is 70000',
    '--limit max_speed=1.5': "the limit 'max_speed=1.5' has no whole number; write max_speed=VALUE",
    '--ros-args --params-file /none.yaml': 'ROS refused: failed to initialize rcl',
    '--ros-args --nope': "ROS refused: ['--nope']; correct the arguments",
}
#: Runs all in one process, to start Python once; prints the status and the message of each.
RUN_ALL = """
import contextlib, importlib, io, json, sys
for program, arguments in json.loads(sys.argv[1]):
    node = importlib.import_module(f'pendubot_identification.nodes.{program}')
    sys.argv, message = [program, *arguments], io.StringIO()
    with contextlib.redirect_stderr(message):
        status = node.main()
    print(json.dumps([status, message.getvalue()]))
"""


#: Invalid parameter files of a bridge, and the expected message.
FILES = [
    ({'bridge': {'torque_limt': 0.1}}, 'bridge has no parameter torque_limt; is torque_limit meant'),
    ({'/**': {'torque_limt': 0.1}}, 'bridge has no parameter torque_limt; is torque_limit meant'),
    ({'bridge': {'port': '', 'seed': 1}}, 'bridge has no parameter seed'),
    # A file for all nodes may have parameters of other nodes.
    ({'/**': {'port': '', 'seed': 1, 'max_age': 0.1}}, 'port is empty'),
    ({'recorder': {'output': 'swing'}}, 'it contains parameters of /recorder, and none of /bridge'),
]


def test_invalid_settings_are_refused_in_one_sentence(tmp_path):
    runs = [(program, parameters(**values), sentence) for program, values, sentence in REFUSED]
    runs.append(('bridge', ['--ros-args', '-r', '__ns:=/lab1/'], 'a namespace such as /lab1, without / at its end'))
    for before in ([], ['--ros-args', '-r']):
        runs.append(('bridge', [*before, 'port:=/none'], 'sets no parameter; write --ros-args -p port:=/none'))
    runs += [('virtual_board', arguments.split(), sentence) for arguments, sentence in REFUSED_BY_THE_BOARD.items()]
    for k, (content, sentence) in enumerate(FILES):
        file = tmp_path / f'{k}.yaml'
        file.write_text(yaml.safe_dump({node: {'ros__parameters': values} for node, values in content.items()}))
        runs.append(('bridge', ['--ros-args', '--params-file', str(file)], sentence))
    command = [sys.executable, '-c', RUN_ALL, json.dumps([run[:2] for run in runs])]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120)
    for line, (program, _, sentence) in zip(done.stdout.splitlines(), runs, strict=True):
        status, message = json.loads(line)
        assert status == 1, sentence
        assert message.startswith(f'{program}: ')
        assert sentence in message
        assert message.count('\n') == 1, message
    assert {file.suffix for file in tmp_path.iterdir()} == {'.yaml'}, 'a bag was begun'


def test_a_node_loads_parameters_dumped_by_ros2_and_accepts_numbers_as_typed(node, tmp_path):
    """ROS tools pass a number without a dot, 1e-09, as a string."""
    file = tmp_path / 'dump.yaml'

    def answer(future):
        assert spin_until(node, future.done)
        return future.result()

    def dump():
        """Return the parameters of the node as ``ros2 param dump`` writes them."""
        names = answer(client.list_parameters()).result.names
        values = map(parameter_value_to_python, answer(client.get_parameters(names)).values)
        return yaml.dump({'/identifier': {'ros__parameters': dict(zip(names, values, strict=True))}})

    with Program('identifier', *parameters(delay='[0.0, 1.0e-09]')):
        client = AsyncParameterClient(node, '/identifier')
        assert client.wait_for_services(20.0)
        file.write_text(dump())
        assert 'spread: 1.0e-09' in file.read_text()
        results = answer(client.load_parameter_file(str(file), True)).results
        names = parameter_dict_from_yaml_file(str(file), True)
        refused = {name for name, result in zip(names, results, strict=True) if not result.successful}
        # The first is ROS's own and read-only; the second is read at the start alone.
        assert refused <= {'start_type_description_service', 'autostart'}
        for text, accepted in (('0', True), ('1e-8', True), ('.nan', False), ('many', False), ('[1e-8]', False)):
            typed = ParameterMessage(name='spread', value=get_parameter_value(text))
            (result,) = answer(client.set_parameters([Parameter.from_parameter_msg(typed)])).results
            assert result.successful == accepted, text
        assert 'spread: 1.0e-08' in dump()


def test_with_use_sim_time_diagnostics_are_stamped_by_the_clock_topic_once_it_is_published(node, tmp_path):
    stamps = []
    node.create_subscription(DiagnosticArray, '/diagnostics', lambda array: stamps.append(array.header.stamp.sec), 10)
    clock, message, begin = node.create_publisher(Clock, '/clock', 1), Clock(), int(time.time())
    message.clock.sec = 1000
    with Program('bridge', *parameters(use_sim_time='true', port=tmp_path / 'board')):
        assert spin_until(node, lambda: stamps)
        assert stamps[-1] >= begin
        assert spin_until(node, lambda: clock.publish(message) or stamps[-1] == 1000), stamps


#: A node that computes at the end of the program, mostly in C++ code of scipy.
COMPUTING = """
import sys, threading
import numpy as np
from scipy.signal import detrend
from pendubot_identification.nodes.runtime import SettingsNode, run

def compute():
    while True:
        detrend(np.ones((9, 2)), axis=0)
        begun.set()

class Computing(SettingsNode):
    PROGRAM, SETTINGS = 'computing', ()

    def _open(self, s):
        self.compute(compute)
        begun.wait()
        self.end(3)

begun = threading.Event()
sys.exit(run(Computing))
"""


def test_a_computation_does_not_abort_the_end_of_the_program():
    done = subprocess.run([sys.executable, '-c', COMPUTING], cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (3, '')


def test_repeated_signals_do_not_change_the_exit_status(tmp_path):
    with Program('bridge', *parameters(port=tmp_path / 'board')) as bridge:
        bridge.wait_for('missing')
        for number in itertools.cycle((signal.SIGINT, signal.SIGHUP)):
            bridge.process.send_signal(number)
            with suppress(subprocess.TimeoutExpired):
                bridge.process.wait(0.003)
                break
        assert bridge.process.returncode == 0
        assert 'Traceback' not in bridge.output


#: Starts a node like a console script, and prints when it is about to import ROS.
STARTED = """
import sys
from pendubot_identification import programs
class Announce:
    def find_spec(self, name, *_):
        if name == 'rclpy':
            print('importing', flush=True)
sys.meta_path.insert(0, Announce())
sys.exit(programs.bridge())
"""


def test_a_signal_during_startup_is_no_failure():
    process = subprocess.Popen(
        [sys.executable, '-c', STARTED], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == 'importing\n'
    process.send_signal(signal.SIGTERM)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 0
    assert errors == ''


#: The handler runs in the interrupted thread, so a lock that both acquire would hang.
AT_EVERY_STEP = """
import signal, sys, threading
from pendubot_identification.nodes.shutdown import Shutdown, at_signal

step, remaining = 0, 0
while remaining <= 0:
    step += 1
    remaining = step

    def trace(frame, event, _):
        global remaining
        frame.f_trace_opcodes = True
        remaining -= 1
        if remaining == 0:
            signal.raise_signal(signal.SIGTERM)
        return trace

    both = Shutdown()
    at_signal(both.set)
    sys.settrace(trace)
    both.wait(0.0), both.set()
    sys.settrace(None)
    assert both.is_set() and both.wait(), step
assert step > 5

# The signal goes to another thread while the main thread sleeps.
woken = Shutdown()
at_signal(woken.set)
threading.Timer(0.1, lambda: signal.pthread_kill(threading.get_ident(), signal.SIGINT)).start()
assert woken.wait()
"""


def test_a_signal_at_any_step_and_to_any_thread_ends_the_wait():
    subprocess.run([sys.executable, '-c', AT_EVERY_STEP], cwd=ROOT, check=True, timeout=60)
