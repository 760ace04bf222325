# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Conditions of the balancer for starting and stopping; it never restarts by itself."""

import functools
import math
from dataclasses import replace

import pytest

from pendubot_identification.control.balancing import Balancing, Phase, Readiness
from pendubot_identification.control.controller import UPRIGHT, SafetyLimits
from pendubot_identification.control.linear_control import Loop
from pendubot_identification.control.plan import Plan
from pendubot_identification.errors import ControlError
from pendubot_identification.level import Level
from pendubot_identification.model.parameters import BALANCE, NAMES

THETA = [float(value) for value in BALANCE.vector()]
BETTER = [1.02 * value for value in THETA]
PERIOD = 0.005


def values(theta=THETA, delay='0.004'):
    return {name: str(value) for name, value in zip(NAMES, theta, strict=False)} | {'effort.delay': delay}


def informed(level=Level.OK, motor_delay=None):
    readiness = Readiness(2.0, motor_delay)
    readiness.period = PERIOD
    readiness.offer(THETA)
    readiness.assess(level, 'low quality', values())
    return readiness


@pytest.mark.parametrize(
    ('delay', 'motor_delay', 'lag'),
    [('0.004', None, 0.004), ('0.004', 0.01, 0.01), *((d, None, 0.0) for d in ('None', 'nan', '', '-0.002'))],
)
def test_readiness_gives_parameters_period_delay_and_torque_limit(delay, motor_delay, lag):
    readiness = informed(motor_delay=motor_delay)
    readiness.assess(Level.OK, '', values(delay=delay))
    assert readiness.ready(False) == (BALANCE, Loop(PERIOD, lag, 2.0))
    readiness.board_limit = 0.5
    assert readiness.ready(False)[1].limit == 0.5


def test_missing_or_poor_inputs_are_named():
    balancing = Balancing(2.0)
    assert balancing.to_prepare(False) is None
    with pytest.raises(ControlError, match='no parameters were received'):
        balancing.begin(0.0)
    balancing.readiness = informed()
    assert balancing.to_prepare(False) is None
    with pytest.raises(ControlError, match='no sample was received on joint_states'):
        balancing.begin(0.0)
    upright(balancing, 1.0)
    assert balancing.to_prepare(False)
    with pytest.raises(ControlError, match='being designed'):
        balancing.begin(1.0)
    unsampled, other, limited = Readiness(2.0), informed(), informed()
    limited.board_limit = 0.0
    unsampled.offer(THETA)
    other.offer([1.01 * value for value in THETA])
    for readiness, accept_warn, words in (
        (Readiness(2.0), True, 'no parameters were received'),
        (unsampled, False, 'the quality of the parameters'),
        (unsampled, True, 'has not reported its sample period'),
        (informed(level=Level.WARN), False, r'level WARN \(low quality\); set the parameter accept_warn'),
        (informed(level=Level.ERROR), True, r'level ERROR \(low quality\)'),
        (other, False, 'the quality of'),
        (limited, False, 'the bridge limits torques to 0 N m'),
    ):
        with pytest.raises(ControlError, match=words):
            readiness.ready(accept_warn)
    assert informed(level=Level.WARN).ready(True)


@functools.cache
def planned(parameters, loop):
    """Return a plan without a simulation."""
    return Plan.make(parameters, loop, simulate_closed_loop=False)


def prepared(bounds=None, swing_up=1.9):
    balancing = Balancing(2.0, bounds=bounds)
    balancing.readiness = informed()
    upright(balancing, 0.0)
    balancing.prepared(replace(planned(*balancing.to_prepare(False)), swing_up=swing_up))
    assert balancing.to_prepare(False) is None
    return balancing


def upright(balancing, t, now=None, effort=0.0):
    now = t if now is None else now
    return balancing.sample(t, now - t, now, (UPRIGHT + 0.01, 0.0), effort)


def running():
    balancing = prepared()
    assert upright(balancing, 1.0) is None
    balancing.begin(1.0)
    assert upright(balancing, 1.005) == 0.0, 'no torque while arming'
    balancing.armed()
    assert upright(balancing, 1.010) != 0.0
    return balancing


@pytest.mark.parametrize(
    ('spoil', 'words'),
    [
        (lambda b: (upright(b, 1.015, now=1.1), upright(b, 1.02, now=1.13)), r'a sample is 0\.110 s old'),
        (lambda b: upright(b, 1.015, now=math.nan), 'a sample is nan s old'),
        # Clock set back, or use_sim_time without /clock: no sample would ever be old.
        (lambda b: upright(b, 1.2, now=1.015), r'a sample is -0\.185 s old; .* check the clocks and use_sim_time'),
        (lambda b: upright(b, 1.115, now=1.06), 'time between two samples'),
        (lambda b: b.silence(1.2), r'no sample for 0\.190 s'),
        (lambda b: upright(b, 1.015, now=1.2), r'no sample for 0\.190 s'),
    ],
)
def test_late_old_or_missing_samples_stop_the_balancer_for_good(spoil, words):
    balancing = running()
    with pytest.raises(ControlError, match=words) as raised:
        spoil(balancing)
    balancing.stop(str(raised.value))
    assert upright(balancing, 2.0) is None
    level, message, _ = balancing.diagnosis()
    assert level is Level.ERROR
    assert message == f'stopped: {balancing.stopped}'


def test_arming_needs_samples_and_times_out_if_the_bridge_does_not_answer():
    balancing = prepared()
    upright(balancing, 1.0)
    with pytest.raises(ControlError, match=r'no sample for 0\.500 s'):
        balancing.begin(1.5)
    balancing.begin(1.0)
    assert upright(balancing, 1.005) == 0.0
    balancing.silence(3.9)
    with pytest.raises(ControlError, match='did not answer within 3 s'):
        balancing.silence(4.1)


@pytest.mark.parametrize(
    'end',
    [
        lambda b, plan: (b.prepared(plan), upright(b, 1.015), b.stop()),
        lambda b, plan: (b.prepared(plan), b.stop()),
        lambda b, plan: (b.stop(), b.prepared(plan)),
        lambda b, plan: (b.not_prepared((plan.design.parameters, plan.design.loop), 'too slow'), b.stop()),
    ],
    ids=['adopted', 'prepared', 'prepared after the stop', 'refused'],
)
def test_parameters_received_while_moving_are_prepared_again_before_the_next_start(end):
    balancing = running()
    balancing.readiness.offer(BETTER)
    assert balancing.to_prepare(False) is None, 'parameters without a quality must not be used'
    balancing.readiness.assess(Level.OK, '', values(BETTER))
    wanted = balancing.to_prepare(False)
    end(balancing, planned(*wanted))
    assert balancing.to_prepare(False) == wanted
    if balancing.plan is None:
        with pytest.raises(ControlError, match='being designed'):
            balancing.begin(1.015)
    assert balancing.plan is None or balancing.plan.swing_up == 1.9, 'it must not start with an unsimulated plan'
    balancing.prepared(replace(planned(*wanted), swing_up=math.inf))
    balancing.sample(1.02, 0.0, 1.02, (-UPRIGHT, 0.0), 0.0)
    with pytest.raises(ControlError, match='do not swing this rig up'):
        balancing.begin(1.02)


def test_a_plan_prepared_while_arming_does_not_replace_the_simulated_one():
    balancing = prepared()
    simulated = balancing.plan
    upright(balancing, 1.0)
    balancing.begin(1.0)
    with pytest.raises(ControlError, match='it is arming already'):
        balancing.begin(1.0)
    balancing.prepared(planned(simulated.design.parameters, simulated.design.loop))
    balancing.armed()
    assert balancing.plan is simulated


def test_a_rig_that_cannot_be_swung_up_may_start_upright():
    for balancing, words in (
        (prepared(swing_up=math.inf), 'do not swing this rig up in simulation'),
        (prepared(SafetyLimits(swing_up=0.0)), 'swing_up_time is 0'),
    ):
        balancing.sample(1.0, 0.0, 1.0, (-UPRIGHT, 0.0), 0.0)
        with pytest.raises(ControlError, match=words):
            balancing.begin(1.0)
        upright(balancing, 1.005)
        balancing.begin(1.005)
        assert balancing.phase is Phase.ARMING


def test_a_failed_plan_is_not_repeated_until_an_input_changes():
    balancing = Balancing(2.0)
    balancing.readiness = informed()
    upright(balancing, 0.0)
    wanted = balancing.to_prepare(False)
    balancing.not_prepared(wanted, 'too slow')
    assert balancing.to_prepare(False) is None
    assert balancing.diagnosis()[:2] == (Level.WARN, 'waiting: too slow')
    balancing.readiness.board_limit = 1.0
    assert balancing.to_prepare(False) is not None


def test_parameters_refused_while_moving_are_not_prepared_again_if_the_torque_limit_changes():
    balancing = running()
    balancing.readiness.board_limit = 1.0
    balancing.readiness.offer(BETTER)
    balancing.readiness.assess(Level.OK, '', values(BETTER))
    wanted = balancing.to_prepare(False)
    assert wanted[1].limit == 2.0, 'the loop is constant during a motion'
    balancing.not_prepared(wanted, 'too slow')
    assert balancing.to_prepare(False) is None
    assert balancing.obstacle == 'too slow'
