# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The bridge in its own process, with a virtual board on a real pty, observed through ROS."""

import signal

import pytest

from benchmarks.faults.bridge import running_rig
from test.nodes.conftest import PULSES
from test.nodes.observer import Observer
from test.processes import Program, parameters
from test.rig import ARMED, ENDLESS, PATIENT, WATCHDOG


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


def test_disarmed_is_answered_only_after_the_board_confirms_it(tmp_path, ros):
    with running_rig(tmp_path / 'rig', bridge=PATIENT, tapped=True) as r:
        r.until(lambda: r.call('disarm').message == 'disarmed')
        r.tap.cut.add('to_board')
        answer = r.call('disarm')
        assert not answer.success
        assert answer.message.startswith('the board does not confirm that it is disarmed: press the emergency stop')
        r.tap.cut.clear()
        r.disarm()
        r.tap.cut.add('to_host')
        r.until(lambda: r.diagnosed(2, 'no valid sample arrives from the board'))
        assert r.call('disarm').message == 'no board to disarm: no valid sample arrives from the board'


def test_an_exciter_that_ends_says_that_the_board_does_not_confirm_the_disarming(tmp_path, ros):
    patient = *PATIENT, 'watchdog_ms:=5000'
    with running_rig(tmp_path / 'rig', *ENDLESS, bridge=patient, tapped=True) as r:
        exciter = r.start('exciter', *parameters(arm='true', **PULSES))
        exciter.wait_for('exciting')
        r.tap.cut.add('to_board')
        assert exciter.stop() == 0
        exciter.wait_for('/bridge: the board does not confirm that it is disarmed: press the emergency stop')


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


def test_an_unexpected_exception_disarms_and_ends_the_bridge_with_status_1(rig, tmp_path):
    r = rig()
    r.start_board()
    program = tmp_path / 'broken_bridge.py'
    client = r.node.create_client(r.trigger, '/bridge/arm')
    for place in ('Host.poll', 'Health.diagnose'):
        program.write_text(BROKEN.format(place=place, port=r.port))
        r.programs.append(bridge := Program(program))
        begun = len(r.trace())
        r.until_samples()
        assert client.wait_for_service(10)
        r.until(lambda bridge=bridge: client.call_async(r.trigger.Request()) and bridge.process.poll() is not None)
        assert bridge.process.returncode == 1
        bridge.wait_for('AttributeError: this is broken; run again with --debug to see where')
        r.until(lambda begun=begun: (r.trace()[begun:, 4] & ARMED).any() and not r.trace()[-1, 4] & ARMED)
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
    # On a busy machine a second may be an ERROR, or have the samples of the second before.
    r.until(lambda: r.diagnoses[-1].level == b'\x01' and 100 < float(r.values()['rate [Hz]']) <= 205)
    r.until(lambda: r.values()['link'] == 'up')


#: A bridge on a computer that had started a day ago with an unset clock.
LATER = """
import sys
from pendubot_identification.nodes.bridge import Bridge, main

opened = Bridge._open

def opens(self, settings):
    opened(self, settings)
    self._epoch_ns -= 86_400 * 10**9

Bridge._open = opens
sys.exit(main())
"""


def test_setting_the_computers_clock_is_reported_once_and_stays_in_the_diagnosis(ros, tmp_path):
    program = tmp_path / 'later_bridge.py'
    program.write_text(LATER)
    with Observer(ros) as observer, Program(program) as bridge:
        observer.until(lambda: sum('set by +86400.00 s' in each.message for each in observer.statuses) >= 2)
        assert bridge.output.count("computer's clock") == 1
