"""The bridge as it is used: its own process, a virtual board in another on a real pty, and ROS in between."""

import math
import signal
import time
from pathlib import Path

import numpy as np
import pytest
import serial
import yaml

from pendubot_identification.adapters.resources import resource
from pendubot_identification.core.protocol import Status
from test.processes import Program, call, run_program, spin_until

pytestmark = pytest.mark.ros

ARMED, WATCHDOG = int(Status.ARMED), int(Status.WATCHDOG)


class Rig:
    """Both programs, a node that listens to all that the bridge says, and the board's own trace."""

    def __init__(self, folder, rate, *board_options):
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray
        from rclpy.qos import QoSProfile
        from sensor_msgs.msg import JointState
        from std_msgs.msg import Float64
        from std_srvs.srv import Trigger

        self.port = folder / 'board'
        self.trace_file = folder / 'trace.csv'
        self.rate = rate
        self.board_options = board_options
        self.programs = []
        self.samples = []
        self.diagnoses = []
        self.float64, self.trigger = Float64, Trigger
        self.node = rclpy.create_node('listener')
        self.node.create_subscription(JointState, '/joint_states', self._on_sample, QoSProfile(depth=1000))
        self.node.create_subscription(
            DiagnosticArray, '/diagnostics', lambda array: self.diagnoses.append(array.status[0]), 10
        )
        self.effort_publisher = self.node.create_publisher(Float64, '/pendubot/effort_command', 1)

    def _on_sample(self, m):
        stamp = m.header.stamp.sec * 10**9 + m.header.stamp.nanosec
        self.samples.append((time.time_ns(), stamp, *m.position, *m.velocity, *m.effort, *m.name))

    def start_board(self):
        board = Program(
            'virtual_board', '--link', self.port, '--rate', self.rate, '--trace', self.trace_file, *self.board_options
        )
        self.programs.append(board)
        board.wait_for('virtual board on')
        return board

    def start_bridge(self, *parameters):
        options = [part for p in (f'port:={self.port}', *parameters) for part in ('-p', p)]
        bridge = Program('bridge', '--ros-args', *options)
        self.programs.append(bridge)
        self.until(
            lambda: (
                self.node.count_publishers('/joint_states') and self.node.count_subscribers('/pendubot/effort_command')
            )
        )
        return bridge

    def until(self, condition, timeout=10.0):
        assert spin_until(self.node, condition, timeout), '\n'.join(p.output for p in self.programs)

    def until_samples(self, more=1):
        wanted = len(self.samples) + more
        self.until(lambda: len(self.samples) >= wanted)

    def call(self, service):
        client = self.node.create_client(self.trigger, f'/bridge/{service}')
        try:
            return call(self.node, client, self.trigger.Request())
        finally:
            self.node.destroy_client(client)

    def effort(self, torque):
        self.effort_publisher.publish(self.float64(data=torque))

    def drive_until(self, torque, condition):
        """Repeat an effort command until a condition holds, as a controller would."""

        def and_command():
            self.effort(torque)
            return condition()

        self.until(and_command)

    def trace(self):
        """The board's samples so far: t_us, enc1, enc2, torque, status."""
        lines = self.trace_file.read_text().splitlines(keepends=True)[1:]
        rows = [line.split(',') for line in lines if line.endswith('\n')]
        return np.array(rows, dtype=np.int64).reshape(-1, 5)

    def diagnosed(self, level, text):
        """Tell whether a diagnosis had this level, or worse, with this text."""
        return any(d.level >= bytes([level]) and text in d.message for d in self.diagnoses)

    def close(self):
        for program in self.programs:
            program.__exit__()
        self.node.destroy_node()


@pytest.fixture
def rig(ros, tmp_path):
    rigs = []

    def make(rate=100, *board_options):
        rigs.append(Rig(tmp_path, rate, *board_options))
        return rigs[-1]

    yield make
    for each in rigs:
        each.close()


def test_1_khz_for_10_s_arrives_whole_unaltered_and_with_the_boards_time(rig):
    r = rig(1000)
    r.start_board()
    bridge = r.start_bridge()
    r.until_samples(100)
    assert r.call('arm').success
    begun = time.monotonic()
    pulse = begun
    while time.monotonic() - begun < 10:
        if time.monotonic() > pulse:
            pulse += 0.05
            r.effort(0.4 if int((pulse - begun) / 0.25) % 4 == 0 else 0.0)
        r.until_samples()
    assert bridge.stop() == 0
    spin_until(r.node, lambda: not r.node.count_publishers('/joint_states'))

    assert {sample[-2:] for sample in r.samples} == {('shoulder', 'elbow')}
    received = np.array([sample[:-2] for sample in r.samples], dtype=object)
    stamps = received[:, 1].astype(np.int64)
    values = received[:, 2:].astype(float)
    counts = np.round((values[:, :2] - [-math.pi / 2, 0]) * 4000 / (2 * math.pi)).astype(int)
    heard = np.column_stack([counts, np.round(values[:, 4] * 1e6).astype(int)])
    trace = r.trace()
    truth = trace[:, 1:4]
    # Where in the board's life the first sample was: the only place at which all that was heard fits.
    n = len(heard)
    assert n > 10_000
    starts = [k for k in range(len(truth) - n + 1) if (truth[k : k + n] == heard).all()]
    assert len(starts) == 1, 'lost or altered'
    assert len({tuple(row) for row in truth[starts[0] : starts[0] + n]}) > 1000, 'nothing moved'
    exact = counts * (2 * math.pi / 4000) + [-math.pi / 2, 0]
    assert np.abs(values[:, :2] - exact).max() < 1e-9
    assert (values[:, 5] == 0).all()

    board_ns = trace[starts[0] : starts[0] + n, 0] * 1000
    # The smallest delay takes some samples to be seen: the clock is judged from the hundredth on.
    offset = (stamps - board_ns)[100:]
    error = np.abs(offset - int(np.median(offset)))
    latency = (received[:, 0] - stamps).astype(float) / 1e6
    print(
        f'{n} samples, stamp error [us]: p99 {np.percentile(error, 99) / 1e3:.0f}, max {error.max() / 1e3:.0f}; '
        f'latency [ms]: median {np.median(latency):.2f}, p99 {np.percentile(latency, 99):.2f}'
    )
    assert (np.diff(stamps) > 0).all()
    assert error.max() < 200_000


def test_it_is_armed_only_after_arm_and_obeys_until_disarm(rig):
    r = rig(100, '--torque-limit', '0.5')
    r.start_board()
    r.start_bridge()
    r.until_samples()
    end = len(r.samples) + 20
    r.drive_until(0.3, lambda: len(r.samples) > end)
    assert not r.trace()[:, 3].any()
    assert not (r.trace()[:, 4] & ARMED).any()
    answer = r.call('arm')
    assert (answer.success, answer.message) == (True, 'armed')
    r.drive_until(0.3, lambda: r.samples[-1][6] == 0.3)
    # Ten times the limit: the smaller limit, the board's, is what the motor gets.
    r.drive_until(5.0, lambda: r.samples[-1][6] == 0.5)
    assert r.trace()[:, 3].max() == 500_000
    # The commander stops: torque 0, still armed, reported.
    r.until(lambda: r.samples[-1][6] == 0.0)
    r.until(lambda: r.diagnosed(1, 'no effort command'))
    assert r.trace()[-1, 4] == ARMED
    assert r.call('disarm').success
    r.until(lambda: r.trace()[-1, 4] == 0)


def test_a_torque_that_is_no_number_disarms_and_is_reported(rig):
    r = rig()
    r.start_board()
    bridge = r.start_bridge()
    r.until_samples()
    assert r.call('arm').success
    r.drive_until(0.2, lambda: r.samples[-1][6] == 0.2)
    r.effort(math.nan)
    r.until(lambda: r.trace()[-1, 4] == 0)
    r.until(lambda: r.diagnosed(2, 'finite'))
    bridge.wait_for('finite')
    assert set(r.trace()[:, 3]) == {0, 200_000}
    end = len(r.samples) + 20
    r.drive_until(0.2, lambda: len(r.samples) > end)
    assert r.trace()[-1, 3] == 0
    assert r.call('arm').success


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_disarms_and_ends_with_0(rig, number):
    r = rig()
    r.start_board()
    bridge = r.start_bridge()
    r.until_samples()
    assert r.call('arm').success
    r.drive_until(0.2, lambda: r.samples[-1][6] == 0.2)
    assert bridge.stop(number) == 0
    r.until(lambda: not r.trace()[-1, 4] & ARMED)
    # By command, not by the watchdog.
    assert not (r.trace()[:, 4] & WATCHDOG).any()
    assert r.trace()[-1, 3] == 0
    assert 'Traceback' not in bridge.output


def test_nobody_arms_it_again_while_it_ends(rig):
    r = rig(1000)
    r.start_board()
    bridge = r.start_bridge()
    r.until_samples()
    assert r.call('arm').success
    client = r.node.create_client(r.trigger, '/bridge/arm')
    assert client.wait_for_service(10)
    bridge.process.send_signal(signal.SIGTERM)
    r.until(lambda: client.call_async(r.trigger.Request()) and bridge.process.poll() is not None)
    assert bridge.process.returncode == 0
    r.until(lambda: not r.trace()[-1, 4] & ARMED)
    assert not (r.trace()[:, 4] & WATCHDOG).any()


def test_when_the_bridge_is_killed_the_boards_watchdog_stops_the_torque(rig):
    r = rig()
    r.start_board()
    bridge = r.start_bridge('watchdog_ms:=100')
    r.until_samples()
    assert r.call('arm').success
    r.drive_until(0.2, lambda: r.samples[-1][6] == 0.2)
    bridge.kill()
    killed = len(r.trace())
    r.until(lambda: (r.trace()[killed:, 4] & WATCHDOG).any())
    # 100 ms are ten samples; two more until it is said, one for the reading of the trace.
    assert np.count_nonzero(r.trace()[killed:, 3]) <= 13
    # The next bridge finds the port free, and the board disarmed.
    r.start_bridge()
    r.until_samples(10)
    assert not r.trace()[-1, 4] & ARMED
    assert r.call('arm').success


def test_a_missing_port_is_waited_for_and_found_again_when_lost(rig):
    r = rig()
    bridge = r.start_bridge()
    bridge.wait_for('missing')
    answer = r.call('arm')
    assert not answer.success
    assert 'missing' in answer.message
    r.until(lambda: r.diagnosed(2, 'missing'))
    board = r.start_board()
    r.until_samples(10)
    assert r.call('arm').success
    board.kill()
    bridge.wait_for('was lost')
    r.until(lambda: r.diagnosed(2, 'was lost'))
    r.trace_file.unlink()
    r.start_board()
    r.until_samples(10)
    assert not (r.trace()[:, 4] & ARMED).any()
    assert r.call('arm').success
    assert bridge.output.count('is missing') == 2, 'said once, and once as the reason why arming failed'
    assert bridge.stop() == 0


def test_a_busy_port_is_waited_for(rig):
    r = rig()
    r.start_board()
    with serial.Serial(str(r.port), exclusive=True):
        bridge = r.start_bridge()
        bridge.wait_for('busy')
        r.until(lambda: r.diagnosed(2, 'busy'))
    r.until_samples(10)
    assert bridge.output.count('is busy') == 1
    assert bridge.stop() == 0


def test_diagnostics_name_every_counter(rig):
    r = rig(200, '--fault', 'bit_flip=0.05', '--fault', 'glitch=0.02', '--fault', 'duplicate_frame=0.05')
    r.start_board()
    r.start_bridge()
    r.until(lambda: len(r.diagnoses) >= 3)
    values = {pair.key: pair.value for pair in r.diagnoses[-1].values}
    assert r.diagnoses[-1].level == b'\x01'
    assert all(int(values[name]) > 0 for name in ('published', 'lost', 'damaged', 'duplicates', 'flagged'))
    assert 100 < float(values['rate [Hz]']) <= 205
    assert values['link'] == 'up'


@pytest.mark.parametrize(
    ('parameter', 'text'),
    [
        ('sign:=[1, 0]', 'sign holds a 0'),
        ('zero:=[0.0]', 'zero has 1 values'),
        ('torque_limit:=-1.0', 'torque_limit'),
        ('watchdog_ms:=3', 'watchdog_ms'),
        ('port:=""', 'port is empty'),
        ('joint_names:=[a, a]', 'two different names'),
    ],
)
def test_settings_that_make_no_sense_end_it_in_a_sentence(parameter, text):
    done = run_program('bridge', '--ros-args', '-p', parameter)
    assert done.returncode == 1
    assert text in done.stderr
    assert 'Traceback' not in done.stderr


def test_the_configuration_file_holds_every_default_and_loads(rig):
    from pendubot_identification.nodes.bridge import Bridge

    path = resource('config/bridge.yaml')
    configured = yaml.safe_load(Path(path).read_text())['bridge']['ros__parameters']
    assert configured == {s.name: s.default for s in Bridge.SETTINGS}
    r = rig()
    r.start_board()
    r.programs.append(Program('bridge', '--ros-args', '--params-file', path, '-p', f'port:={r.port}'))
    r.until_samples()


def test_help_is_worth_reading():
    done = run_program('bridge', '--help')
    assert done.returncode == 0
    assert all(word in done.stdout for word in ('port', 'command_timeout', 'rad/s', '/joint_states'))


@pytest.mark.parametrize(
    ('options', 'status', 'text'),
    [
        (['--help'], 0, 'bit_flip'),
        (['--duration', '0.1', '--ros-args', '-r', '__node:=x'], 0, 'virtual board on /dev/pts/'),
        (['--nonsense'], 2, 'unrecognized'),
        (['--rate', '0'], 1, '--rate is 0 Hz'),
        (['--fault', 'rust=1'], 1, "no fault 'rust'"),
        (['--fault', 'bit_flip=often'], 1, 'has no number'),
        (['--link', __file__], 1, 'no link to a pty'),
    ],
)
def test_the_virtual_board_explains_itself(options, status, text):
    done = run_program('virtual_board', *options)
    assert done.returncode == status
    assert text in done.stdout + done.stderr
    assert 'Traceback' not in done.stderr
