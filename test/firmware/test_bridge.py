# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The bridge on the firmware, as a Linux program and as the STM32F4's in QEMU: nothing is lost or altered."""

import inspect
import os
import threading
import time

import numpy as np
import pytest

from pendubot_identification.link.protocol import Command, Hello, HelloRequest, State, Status, encode
from pendubot_identification.model.parameters import PAPER
from pendubot_identification.model.simulation import Plant
from test import processes
from test.nodes import test_bridge
from test.processes import Program, call, parameters, spin_until

from .building import made, need
from .emulator import Emulator, Line

pytestmark = pytest.mark.ros

#: How long the bridge runs at 1 kHz [s]; a minute by hand: FIRMWARE_SECONDS=60.
SECONDS = float(os.environ.get('FIRMWARE_SECONDS', '3'))
#: Of the tests of the bridge on the Python board, those that run in CI on the C board; all by hand: FIRMWARE_ALL=1.
FEW = {'test_it_is_armed_only_after_arm_and_obeys_until_disarm', 'test_diagnostics_name_every_counter'}
COUNT = 2 * np.pi / 4000


@pytest.fixture
def board(request, tmp_path):
    """The path of a board's port, at 1 kHz."""
    if request.param == 'qemu':
        with Emulator(tmp_path) as emulator:
            yield emulator.port
    else:
        need('gcc', 'gcc')
        with Program('firmware', '--link', tmp_path / 'board', '--rate', 1000) as program:
            program.wait_for('virtual board on')
            yield tmp_path / 'board'


@pytest.fixture(autouse=True)
def c_board(monkeypatch):
    """Let every program that is called a virtual board be the firmware."""
    need('gcc', 'gcc')
    made('host')
    for name in ('virtual_board', 'firmware'):
        monkeypatch.setitem(processes.MODULES, name, 'test.firmware.host_board')


both = pytest.mark.parametrize('board', ['host', 'qemu'], indirect=True)


class Listener:
    """A node that arms, commands and listens."""

    def __init__(self, ros):
        from diagnostic_msgs.msg import DiagnosticArray
        from rclpy.qos import QoSProfile
        from sensor_msgs.msg import JointState
        from std_msgs.msg import Float64

        self.node = ros.create_node('firmware_listener')
        self.samples, self.values = [], {}
        self.effort = self.node.create_publisher(Float64, '/pendubot/effort_command', 1)
        self.node.create_subscription(JointState, '/joint_states', self._on_sample, QoSProfile(depth=5000))
        self.node.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnosis, 10)
        self._float64 = Float64

    def _on_sample(self, m):
        self.samples.append((*m.position, m.effort[0]))

    def _on_diagnosis(self, array):
        self.values = {pair.key: pair.value for pair in array.status[0].values}

    def command(self, torque):
        self.effort.publish(self._float64(data=float(torque)))

    def arm(self):
        from std_srvs.srv import Trigger

        client = self.node.create_client(Trigger, '/bridge/arm')
        answer = call(self.node, client, Trigger.Request())
        assert answer.success, answer.message


@pytest.fixture
def listener(ros):
    listener = Listener(ros)
    yield listener
    listener.node.destroy_node()


@both
def test_1_khz_reaches_the_bridge_whole_and_its_watchdog_outlasts_the_bridge(board, listener, tmp_path):
    with Program('bridge', *parameters(port=board)) as bridge:
        bridge.wait_for('counts per turn', 30)
        assert spin_until(listener.node, lambda: listener.samples)
        spin_until(listener.node, lambda: False, 1.5)  # discovery is no matter of losses; what is judged begins here
        # The first bytes that are read may be the rest of a frame.
        assert spin_until(listener.node, lambda: 'damaged' in listener.values)
        before = dict(listener.values)
        listener.samples.clear()
        listener.arm()
        ended = threading.Event()
        rng = np.random.default_rng(1)

        def drive():
            while not ended.wait(0.05):
                # Gently: from one that turns over, a difference in the last digit grows to turns within a minute.
                listener.command(rng.uniform(-0.1, 0.1))

        thread = threading.Thread(target=drive)
        thread.start()
        # The board's seconds: QEMU's may be longer.
        assert spin_until(listener.node, lambda: len(listener.samples) >= 1000 * SECONDS, 3 * SECONDS)
        bridge.kill()
        killed = time.monotonic()
        ended.set()
        thread.join()
        spin_until(listener.node, lambda: False, 0.3)
        values = listener.values
    line = Line(board)
    events = [e for e in line.events(1.0) if isinstance(e, State)]
    away = time.monotonic() - killed
    line.close()

    q, torque = np.array(listener.samples)[:, :2], np.array(listener.samples)[:, 2]
    assert np.count_nonzero(np.diff(torque)) > 15 * SECONDS
    print(f'{len(q)} samples, lost {values["lost"]}, damaged {values["damaged"]}')
    assert all(values[count] == before[count] for count in ('lost', 'damaged', 'duplicates', 'flagged'))
    # The same torques move the package's own plant: a sample that was lost, doubled or altered would show.
    plant = Plant(PAPER)
    moved = [plant.q]
    for each in torque[:-1]:
        plant.advance((each, 0.0), 0.001)
        moved.append(plant.q)
    off = np.abs(q - np.round((moved - np.array([-np.pi / 2, 0])) / COUNT) * COUNT - [-np.pi / 2, 0]) / COUNT
    print(
        f'largest difference from the simulation: {off.max():.3f} counts; in {(off > 0.5).sum()} of {off.size} numbers'
    )
    assert off.max() < 1.01
    assert (off > 0.5).mean() < 1e-3
    # QEMU's time may run behind, with samples from before.
    stopped = events[next(k for k, e in enumerate(events) if e.status & Status.WATCHDOG) :]
    assert all(e.torque == 0 and e.status & Status.WATCHDOG for e in stopped), f'{away:.2f} s after the kill'
    assert len(stopped) > 100


@both
def test_the_boards_own_clock_decides_when_it_trips(board):
    line = Line(board)
    line.events(10, lambda e: isinstance(e, State))  # it has started, and hears
    line.write(encode(HelloRequest(1, 0)))
    hello = line.events(10, lambda e: isinstance(e, Hello))[-1]
    assert (hello.cpr1, hello.sample_period_us) == (4000, 1000)
    line.write(encode(Command(2, 0, 0, 100, 0)) + encode(Command(3, 0, 1, 100, 300_000)))
    events = line.events(10, lambda e: isinstance(e, State) and e.status & Status.WATCHDOG)
    states = [e for e in events if isinstance(e, State)]
    line.close()
    armed = [s.t_us for s in states if s.torque]
    assert [s.torque for s in states if s.status & Status.ARMED] == [300_000] * len(armed)
    assert armed[-1] - armed[0] == 99_000
    assert states[-1].t_us - armed[-1] == 1000
    assert np.all(np.diff([s.t_us for s in states]) == 1000)


for _name, _test in list(vars(test_bridge).items()):
    wanted = _name in FEW or (_name.startswith('test_') and os.environ.get('FIRMWARE_ALL'))
    if wanted and 'rig' in inspect.signature(_test).parameters:
        globals()[_name] = _test
