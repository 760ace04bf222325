# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The balancer with a real bridge and the virtual board, each in its own process; the trace of the board tells."""

import signal

import numpy as np
import pytest

from pendubot_identification.model.parameters import BALANCE
from test.faults.witness import steady_machine
from test.live import ARMED, LiveRig
from test.processes import Program, parameters, run_program, spin_until

pytestmark = pytest.mark.ros

#: Timeouts that outlast what else a busy machine does, where they are not what is tested ...
PATIENT = {'watchdog_ms': 500, 'command_timeout': 1.0, 'link_timeout': 2.0}
PATIENCE = 2.0
#: ... and the longest pause [ms] of a machine on which none of the usual ones, of 0.1 s, passes unasked.
STEADY = 50


@pytest.fixture
def rig(ros, tmp_path):
    rigs = []

    def make(rate=200, *options, bridge=None, **start):
        rig = LiveRig(tmp_path, rate)
        rigs.append(rig)
        rig.start_board(*options, **start)
        rig.start_bridge(**(bridge or {}))
        return rig

    yield make
    for each in rigs:
        each.close()


def balancing(rig, **values):
    rig.publish()
    balancer = rig.start('balancer', **values)
    rig.begin()
    rig.until(lambda: rig.armed_for() > 1.0)
    return balancer


def torque_ends(rig, cut):
    """Wait until the torque of the board is 0 for good; return how long it was not, from sample ``cut`` on [s]."""
    rig.until(lambda: len(rig.trace()[0]) > cut + 100)
    t, _, tau, status = rig.trace()
    pushing = np.flatnonzero(tau[cut:])
    assert not (status[-20:] & ARMED).any()
    return float(t[cut + pushing[-1]] - t[cut]) if pushing.size else 0.0


@steady_machine(STEADY)
def test_it_holds_the_rig_and_takes_new_parameters_and_lets_go_when_told(rig):
    r = rig(200, bridge=PATIENT)
    balancer = balancing(r, max_age=PATIENCE)
    since, held = r.held(since=0.5)
    assert held > 0.4, since
    diagnosis = {pair.key: pair.value for pair in r.diagnoses[-1].values}
    assert float(diagnosis['delay margin [s]']) == pytest.approx(0.023, abs=0.001)
    r.publish([1.02 * value for value in BALANCE.vector()])
    balancer.wait_for('prepared')
    balancer.wait_for('prepared')
    r.until(lambda: r.armed_for() > 3.0)
    # Killed, the identifier is not missed: what it said was latched, and is known.
    r.node.destroy_publisher(r._params)
    r.until(lambda: r.armed_for() > 4.0)
    assert r.held(since=0.5)[1] > 3.0
    assert np.abs(r.trace()[2]).max() <= 2.0
    assert r.call('/balancer/stop').success
    r.until(lambda: not r.trace()[3][-1] & ARMED)


def test_when_it_is_killed_the_torque_ends(rig):
    r = rig(200)
    balancer = balancing(r)
    balancer.kill()
    cut = len(r.trace()[0])
    # Armed still, at torque 0, as the bridge does with every commander that falls silent.
    r.until(lambda: len(r.trace()[0]) > cut + 100)
    assert not r.trace()[2][cut + 40 :].any()
    assert r.call('/bridge/disarm').success
    r.start('balancer')
    r.publish()
    r.until(lambda: 'prepared' in r.programs['balancer'].output)
    cut = len(r.trace()[0])
    r.until(lambda: len(r.trace()[0]) > cut + 100)
    assert not (r.trace()[3][cut:] & ARMED).any(), 'another balancer does not arm on its own'


@steady_machine(STEADY)
def test_when_the_bridge_is_killed_all_stops_and_nothing_begins_again(rig):
    r = rig(200)
    balancer = balancing(r)
    r.programs['bridge'].kill()
    assert torque_ends(r, len(r.trace()[0])) < 0.2
    balancer.wait_for('stopped: no sample for')
    r.start_bridge()
    cut = len(r.trace()[0])
    r.until(lambda: len(r.trace()[0]) > cut + 200)
    assert not (r.trace()[3][cut:] & ARMED).any()
    assert r.diagnoses[-1].level == b'\x02'


def test_when_the_link_is_silent_for_a_while_all_stops_and_nothing_begins_again(rig):
    """The bridge is halted, so that neither samples nor commands pass, and goes on later."""
    r = rig(200)
    balancer = balancing(r)
    r.programs['bridge'].process.send_signal(signal.SIGSTOP)
    try:
        assert torque_ends(r, len(r.trace()[0])) < 0.2
    finally:
        r.programs['bridge'].process.send_signal(signal.SIGCONT)
    balancer.wait_for('stopped: ')
    cut = len(r.trace()[0])
    r.until(lambda: len(r.trace()[0]) > cut + 200)
    assert not (r.trace()[3][cut:] & ARMED).any()


def test_when_the_board_is_gone_it_stops_and_does_not_arm_the_next_one(rig):
    r = rig(200)
    balancer = balancing(r)
    r.programs['virtual_board'].kill()
    balancer.wait_for('stopped: ')
    r.start_board(seed=2)
    r.until(lambda: len(r.trace()[0]) > 300)
    assert not (r.trace()[3] & ARMED).any()


def test_parameters_that_no_rig_has_stop_it_while_it_balances(rig):
    r = rig(200, bridge=PATIENT)
    balancer = balancing(r, max_age=PATIENCE)
    r.publish([*BALANCE.vector()[:2], 0.02, *BALANCE.vector()[3:]])
    balancer.wait_for('stopped: no rig has the parameters that came')
    r.until(lambda: not r.trace()[3][-1] & ARMED)


@steady_machine(STEADY)
def test_wrong_signs_stop_it_within_a_fifth_of_a_second(ros, tmp_path):
    r = LiveRig(tmp_path, 200)
    try:
        r.start_board()
        r.start_bridge(sign='[1, -1]')
        r.publish()
        balancer = r.start('balancer')
        r.begin()
        balancer.wait_for("stopped: the elbow's encoder counts the wrong way")
        r.until(lambda: not r.trace()[3][-1] & ARMED)
        t, _, _, status = r.trace()
        armed = np.flatnonzero(status & ARMED)
        assert t[armed[-1]] - t[armed[0]] < 0.5, 'noticed within 0.2 s by its own clock, and a service call'
    finally:
        r.close()


def test_it_says_what_it_waits_for_and_what_it_refuses(rig):
    r = rig(200, '--torque-limit', '0.3', start='hanging', spread=0.0)
    balancer = r.start('balancer')
    balancer.wait_for('waiting: no parameters have come on pendubot/params')
    r.until(lambda: 'no parameters' in r.call('/balancer/start').message)  # before, it had not met the bridge
    r.publish(level=2, message='useless')
    balancer.wait_for('level ERROR (useless)')
    r.publish(level=1, message='doubtful')
    balancer.wait_for('level WARN (doubtful); set the parameter accept_warn')
    assert not r.call('/balancer/start').success
    r.publish()
    balancer.wait_for('0.3 N m do not swing this rig up', 60.0)
    refused = r.call('/balancer/start')
    assert not refused.success
    assert 'N m would do; hold it upright and start again' in refused.message
    assert not spin_until(r.node, lambda: (r.trace()[3] & ARMED).any(), 0.5)


GENTLE = {'arm': 'true', 'duration': 0.0, 'width': 1.0, 'amplitude_min': 0.05, 'amplitude_max': 0.15}


def test_it_refuses_to_start_where_an_exciter_drives(rig):
    r = rig(200, bridge=PATIENT, start='hanging', spread=0.0)
    exciter = r.start('exciter', **GENTLE)
    exciter.wait_for('exciting')
    balancer = r.start('balancer')
    r.publish()
    balancer.wait_for('prepared', 60.0)
    refused = r.call('/balancer/start')
    assert not refused.success
    assert '/exciter drives this rig, or is about to; end it' in refused.message
    cut = len(r.trace()[0])
    r.until(lambda: len(r.trace()[0]) > cut + 200)
    assert exciter.process.poll() is None, 'beside an idle balancer it goes on'
    torques = r.trace()[2][cut:]
    assert torques.min() >= 0.05
    assert torques.max() <= 0.15
    assert exciter.stop() == 0
    r.begin()


def test_an_exciter_that_was_not_found_leaves_the_rig_to_it(rig):
    r = rig(200, bridge=PATIENT, start='hanging', spread=0.0)
    # Of a name that is no exciter's: to the balancer, one that has not been discovered.
    exciter = r.programs['exciter'] = Program('exciter', *parameters(**GENTLE), '-r', '__node:=pulses')
    exciter.wait_for('exciting')
    r.start('balancer', max_age=PATIENCE)
    r.publish()
    r.begin()
    exciter.wait_for('/balancer drives this rig, too')
    assert exciter.process.wait(10) == 1
    r.until(lambda: r.held()[1] > 0.5, 60.0)
    armed = r.trace()[3] & ARMED
    assert armed[np.argmax(armed) :].all(), 'armed once, and ever since'


@pytest.mark.parametrize(
    ('values', 'sentence'),
    [
        ({'torque_limit': -1.0}, 'torque_limit'),
        ({'max_age': 0.0}, 'max_age'),
        ({'joint_names': '[a, a]'}, 'two different names'),
    ],
)
def test_settings_without_sense_are_refused_in_a_sentence(values, sentence):
    refused = run_program('balancer', *parameters(**values))
    assert refused.returncode == 1
    assert sentence in refused.stderr
    assert refused.stderr.count('\n') == 1
