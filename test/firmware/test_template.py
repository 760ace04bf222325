# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The template for new boards compiles in C and C++, and the Arduino sketch obeys a host."""

import subprocess

import pytest

from pendubot_identification.link.protocol import Arm, Command, Decoder, Hello, State, Status, encode
from test.conftest import ROOT

from .building import FIRMWARE, compiled

TEMPLATE, STAND_IN = FIRMWARE / 'template', ROOT / 'test/firmware/arduino'
SHOULDER_A, SHOULDER_B, ELBOW_A, ELBOW_B, STOP, CURRENT, SUPPLY = 2, 3, 4, 5, 6, 14, 15
SESSION = 9


@pytest.fixture(scope='module')
def objects(tmp_path_factory):
    """The objects against which a port links, compiled as C."""
    folder = tmp_path_factory.mktemp('objects')
    names = 'pendubot_link', 'firmware'
    return [compiled(folder / f'{name}.o', FIRMWARE / f'{name}.c', options=['-c']) for name in names]


@pytest.mark.parametrize('language', ['c', 'c++'])
def test_the_template_compiles_links_and_runs(objects, tmp_path, language):
    port = compiled(tmp_path / 'port.o', TEMPLATE / 'board.c', options=['-c'], language=language)
    board = compiled(tmp_path / 'board', *objects, port, language=language)
    assert subprocess.run([board], timeout=10).returncode == 0


class Sketch:
    """The sketch with 24 V and the emergency stop closed, and a host on its line."""

    def __init__(self, program):
        self._process = subprocess.Popen([program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self._decoder, self._seq = Decoder(), 0
        self.control(f'analog {CURRENT} 2048', f'analog {SUPPLY} 2708', f'pin {STOP} 0', 'setup')

    def control(self, *lines):
        self._process.stdin.write('\n'.join(lines) + '\n')
        self._process.stdin.flush()

    def wait(self, milliseconds):
        """Advance the time; return the board's events, and duty and direction at the end."""
        self.control(f'wait {1000 * milliseconds}')
        duty, direction, *data = map(int, self._process.stdout.readline().split())
        return self._decoder.feed(bytes(data)), (duty, direction)

    def state(self):
        events, pwm = self.wait(4)
        return [event for event in events if isinstance(event, State)][-1], pwm

    def send(self, message):
        self.control(*(f'hear {byte}' for byte in encode(message)))

    def command(self, torque, mode=1):
        self.send(Command(5, 0, mode, 50, torque, session=SESSION))

    def close(self):
        self._process.communicate()
        assert self._process.returncode == 0


@pytest.fixture(scope='module')
def program(objects, tmp_path_factory):
    folders, target = ('-I', STAND_IN, '-I', TEMPLATE / 'arduino/pendubot'), tmp_path_factory.mktemp('sketch')
    return compiled(target / 'sketch', *objects, STAND_IN / 'sketch_probe.cpp', options=folders, language='c++')


@pytest.fixture
def sketch(program):
    sketch = Sketch(program)
    yield sketch
    sketch.close()


def test_the_sketch_sends_hello_counts_both_encoders_and_detects_a_missed_edge(sketch):
    events, pwm = sketch.wait(20)
    hello, *states = [event for event in events if isinstance(event, (Hello, State))]
    assert (hello.firmware, hello.sample_period_us, hello.limits.max_speed) == ('arduino 2', 2000, 60_000)
    assert [s.t_us for s in states[:3]] == [0, 2000, 4000]
    assert (states[-1].status, states[-1].vbus, pwm[0]) == (0, 2399, 0)
    for a, b in (1, 0), (1, 1), (0, 1), (0, 0), (1, 0):
        sketch.control(f'pin {SHOULDER_A} {a}', f'pin {SHOULDER_B} {b}')
        sketch.control(f'pin {ELBOW_A} {b}', f'pin {ELBOW_B} {a}')
    state, _ = sketch.state()
    assert (state.enc1, state.enc2, state.status) == (-5, 5, 0)
    sketch.control(f'quietly {ELBOW_A} 1', f'pin {ELBOW_B} 0', f'quietly {ELBOW_A} 0', f'pin {ELBOW_B} 1')
    assert sketch.wait(2)[0][-1].status & Status.ENCODER_2


@pytest.mark.parametrize(
    ('fault', 'line', 'within_ms'),
    [
        (Status.EMERGENCY_STOP, f'pin {STOP} 1', 4),
        (Status.OVER_CURRENT, f'analog {CURRENT} 4000', 4),
        (Status.UNDERVOLTAGE, f'analog {SUPPLY} 1000', 4),
        (Status.OVERVOLTAGE, f'analog {SUPPLY} 4000', 4),
        (Status.WATCHDOG, '', 60),
    ],
)
def test_the_sketch_drives_the_armed_motor_until_a_fault_or_the_watchdog(sketch, fault, line, within_ms):
    hello = sketch.wait(20)[0][0]
    sketch.command(300_000)
    assert sketch.state()[0].refused == 1
    sketch.send(Arm(2, 0, hello.boot_id, SESSION, 1, 50))
    for torque, direction in (-300_000, 0), (300_000, 1):
        sketch.command(torque)
        state, pwm = sketch.state()
        # 3 V of 23.99 V in 4095 steps.
        assert (state.status, state.torque, pwm) == (Status.ARMED, torque, (512, direction))
    sketch.control(line)
    sketch.wait(within_ms)
    state, pwm = sketch.state()
    assert (state.status, state.torque, pwm[0]) == (fault, 0, 0)
