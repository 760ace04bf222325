# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The bridge in its own process, with a virtual board on a real pty, observed through ROS."""

import signal

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient

from pendubot_identification.nodes.bridge import Bridge
from pendubot_identification.nodes.runtime import running
from pendubot_identification.nodes.shutdown import Shutdown
from test.processes import Program, spin_until
from test.rig import ARMED, PATIENT, WATCHDOG

pytestmark = pytest.mark.ros


@pytest.mark.parametrize('each_board', ['c'], indirect=True)
def test_samples_have_the_current_and_a_signal_disarms_the_bridge_for_good(rig, each_board):
    """Arming, clamping and the command timeout: test_lifecycle.py, test/link and the fault trial watchdog."""
    r = rig(200)
    r.start_board()
    # Long timeouts, so that a busy machine trips no watchdog.
    bridge = r.start_bridge('watchdog_ms:=1000', 'link_timeout:=2.0')
    r.until_samples()
    answer = r.call('arm')
    assert (answer.success, answer.message) == (True, 'armed')
    r.drive_until(0.3, lambda: r.message.effort[2] == 3.0)  # torque constant 0.1 N m/A
    assert r.samples[-1][6] == 0.3
    assert r.message.name == ['shoulder', 'elbow', 'shoulder_current']
    assert {len(r.message.position), len(r.message.velocity), len(r.message.effort)} == {3}
    # A call to arm during shutdown has no effect.
    client = r.node.create_client(r.trigger, '/bridge/arm')
    assert client.wait_for_service(10)
    bridge.process.send_signal(signal.SIGTERM)
    r.until(lambda: client.call_async(r.trigger.Request()) and bridge.process.poll() is not None)
    assert bridge.process.returncode == 0
    r.until(lambda: not r.trace()[-1, 4] & ARMED)
    assert not (r.trace()[:, 4] & WATCHDOG).any(), 'disarmed by the watchdog instead of by command'
    assert r.trace()[-1, 3] == 0
    assert 'Traceback' not in bridge.output


def test_the_torque_limit_may_be_lowered_while_it_runs_and_raised_only_while_disarmed(rig):
    r = rig()
    r.start_board()
    r.start_bridge(*PATIENT, 'torque_limit:=0.5')
    r.until_samples()
    client = AsyncParameterClient(r.node, '/bridge')
    assert client.wait_for_services(20.0)

    def limited(value):
        future = client.set_parameters([Parameter('torque_limit', value=value)])
        r.drive_until(1.0, future.done)
        return future.result().results[0]

    assert r.call('arm').success
    r.drive_until(1.0, lambda: r.samples[-1][6] == 0.5)
    assert limited(0.2).successful
    r.drive_until(1.0, lambda: r.samples[-1][6] == 0.2)
    assert 'is not raised while the motor is armed; call ~/disarm first' in limited(0.3).reason
    assert r.call('disarm').success
    assert limited(0.3).successful
    assert r.call('arm').success
    r.drive_until(1.0, lambda: r.samples[-1][6] == 0.3)
    assert set(r.trace()[:, 3]) == {0, 200_000, 300_000, 500_000}


#: A bridge in which a method fails as soon as the motor is armed.
BROKEN = """
import sys
from pendubot_identification.link.health import Health
from pendubot_identification.link.host import Host
from pendubot_identification.nodes import bridge

original = {place}

def broken(*args):
    if next(each for each in args if isinstance(each, Host)).armed:
        raise AttributeError('this is broken')
    return original(*args)

{place} = broken
sys.argv += ['--ros-args', '-p', 'port:={port}', '-p', 'watchdog_ms:=5000', '-p', 'confirm_zeros:=false']
sys.exit(bridge.main())
"""


@pytest.mark.parametrize('place', ['Host.poll', 'Health.diagnose'])
def test_an_unexpected_exception_disarms_and_ends_the_bridge_with_status_1(rig, tmp_path, place):
    r = rig()
    r.start_board()
    program = tmp_path / 'broken_bridge.py'
    program.write_text(BROKEN.format(place=place, port=r.port))
    bridge = Program(program)
    r.programs.append(bridge)
    r.until_samples()
    client = r.node.create_client(r.trigger, '/bridge/arm')
    assert client.wait_for_service(10)
    r.until(lambda: client.call_async(r.trigger.Request()) and bridge.process.poll() is not None)
    assert bridge.process.returncode == 1
    bridge.wait_for('AttributeError: this is broken; run again with --debug to see where')
    r.until(lambda: (r.trace()[:, 4] & ARMED).any() and not r.trace()[-1, 4] & ARMED)
    assert not (r.trace()[:, 4] & WATCHDOG).any(), 'disarmed by the watchdog instead of by command'


def test_the_bridge_waits_for_a_missing_port_and_diagnostics_contain_every_counter(rig):
    # Glitches that follow each other closely are a speed, too: no speed limit.
    faults = ('bit_flip=0.05', 'glitch=0.02')
    r = rig(200, '--limit', 'max_speed=0', *(word for fault in faults for word in ('--fault', fault)))
    r.start_bridge()
    answer = r.call('arm')
    assert not answer.success
    assert 'missing' in answer.message
    r.until(lambda: r.diagnosed(2, 'missing'))
    r.start_board()
    r.until_samples(10)
    counters = 'published', 'lost', 'damaged', 'flagged'
    r.until(lambda: all(int(r.values()[name]) > 0 for name in counters), 30.0)
    r.until(lambda: r.diagnoses[-1].level == b'\x01')  # on a busy machine a second may be an ERROR
    values = r.fresh_values()
    assert 100 < float(values['rate [Hz]']) <= 205
    assert values['link'] == 'up'


def test_setting_the_computers_clock_is_reported_once_and_stays_in_the_diagnosis(ros, capfd):
    bridge, node = Bridge(Shutdown()), rclpy.create_node('clock_listener')
    texts = []
    node.create_subscription(DiagnosticArray, '/diagnostics', lambda array: texts.append(array.status[0].message), 10)
    with running(bridge):
        # As if the computer had started a day ago with an unset clock.
        bridge._epoch_ns -= 86_400 * 10**9
        assert spin_until(node, lambda: sum('set by +86400.00 s' in text for text in texts) >= 2)
        assert capfd.readouterr().err.count("computer's clock") == 1
        bridges = node.get_node_names().count('bridge')  # one that a test killed may still be known
        bridge.end()
        bridge._close()
    assert spin_until(node, lambda: node.get_node_names().count('bridge') < bridges)
    node.destroy_node()
