# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The controller on simulated rigs: it swings up, balances, changes its parameters, and stops."""

import functools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pendubot_identification.control.closed_loop import simulate_closed_loop, sufficient_limit, swing_up_time
from pendubot_identification.control.control import UPRIGHT, Controller, Design, Limits, Loop, Mode
from pendubot_identification.control.swing_up import SwingUp
from pendubot_identification.errors import ControlError
from pendubot_identification.model.dynamics import accelerations
from pendubot_identification.model.parameters import BALANCE
from pendubot_identification.model.simulation import HANGING, LatePlant

LAG = 0.004
LOOPS = {rate: Loop(1 / rate, 1, LAG, 2.0) for rate in (200, 500)}
DESIGNS = {rate: Design.make(BALANCE, loop) for rate, loop in LOOPS.items()}
#: Link 2 identified up to a third wrong.
WRONG = replace(BALANCE, P2=1.3 * BALANCE.P2, P3=1.2 * BALANCE.P3, P5=1.15 * BALANCE.P5)


def place(start, seed):
    (q1, q2), spread = ((UPRIGHT, 0.0), 0.1) if start == 'upright' else (HANGING, 0.2)
    e1, e2 = np.random.default_rng(seed).uniform(-spread, spread, 2)
    return q1 + e1, q2 + e2


@functools.cache
def made(known, loop):
    return Design.make(known, loop)


def run(start, seed, rate=200, known=None, seconds=12.0, loop=None, **how):
    loop = loop or LOOPS[rate]
    controller = Controller(made(known or BALANCE, loop), loop)
    rig = LatePlant(how.pop('rig', BALANCE), LAG, place(start, seed))
    return simulate_closed_loop(controller, rig, loop, seconds, enough=2.0, **how)


@pytest.mark.parametrize('rate', LOOPS)
def test_from_near_upright_all_are_held(rate):
    for seed in range(4):
        closed_loop = run('upright', seed, rate)
        assert not closed_loop.stopped
        assert closed_loop.held_since() < 1.0, seed
        assert closed_loop.balancing[1:].all()


@pytest.mark.parametrize('rate', LOOPS)
def test_from_hanging_all_are_swung_up_within_the_torque_limit(rate):
    for seed in range(3):
        closed_loop = run('hanging', seed, rate)
        assert not closed_loop.stopped
        assert closed_loop.held_since() < 10.0, seed
        assert np.abs(closed_loop.motion.tau).max() <= 2.0


def test_parameters_that_are_off_still_do():
    for seed in range(2):
        assert run('upright', seed, known=WRONG).held_since() < 1.0
        assert run('hanging', seed, known=WRONG).held_since() < 10.0


def test_a_push_that_fells_it_is_followed_by_another_swing_up():
    loop = LOOPS[200]
    controller = Controller(DESIGNS[200], loop)
    rig = LatePlant(BALANCE, LAG, (UPRIGHT, 0.0))
    assert simulate_closed_loop(controller, rig, loop, 2.0).balancing[-1]
    rig.place(rig.q, (0.0, 12.0))
    # Its own time goes on; the closed-loop simulation's begins anew.
    controller._last = None
    closed_loop = simulate_closed_loop(controller, rig, loop, 12.0, enough=2.0)
    assert not closed_loop.balancing.all()
    assert closed_loop.held_since() < 10.0


MIRROR = {
    'shoulder': (lambda q: (2 * HANGING[0] - q[0], q[1]), 1.0, "the shoulder's encoder counts the wrong way"),
    'elbow': (lambda q: (q[0], -q[1]), 1.0, "the elbow's encoder counts the wrong way"),
    'motor': (lambda q: q, -1.0, 'the motor turns the wrong way'),
    'exchanged': (lambda q: (q[1] + HANGING[0], q[0] - HANGING[0]), 1.0, 'shoulder and elbow are exchanged'),
}


@pytest.mark.parametrize('rate', LOOPS)
@pytest.mark.parametrize('start', ['upright', 'hanging'])
@pytest.mark.parametrize('known', [BALANCE, WRONG], ids=['exact', 'off'])
@pytest.mark.parametrize('wrong', MIRROR)
def test_wrong_signs_and_exchanged_joints_are_named_within_a_fifth_of_a_second(rate, start, known, wrong):
    sensed, motor, words = MIRROR[wrong]
    for seed in range(2):
        closed_loop = run(start, seed, rate, known, 0.3, sensed=sensed, motor=motor)
        assert words in closed_loop.stopped
        assert closed_loop.motion.t[-1] < 0.2


@pytest.mark.parametrize('rate', LOOPS)
def test_lost_samples_are_not_taken_for_wrong_signs(rate):
    """A controller that hears two of three samples, and now and then none for 50 ms."""
    loop, rng = LOOPS[rate], np.random.default_rng(1)
    for start in ('upright', 'hanging'):
        controller, rig, torque, silent = (
            Controller(DESIGNS[rate], loop),
            LatePlant(BALANCE, LAG, place(start, 2)),
            0.0,
            0,
        )
        for k in range(round(6 / loop.period)):
            effort = torque
            silent = round(0.05 / loop.period) if k > 50 and rng.random() < 0.002 else silent - 1
            if silent <= 0 and rng.random() < 0.67:
                torque = controller.step(k * loop.period, rig.q, effort)
            rig.advance((effort, 0.0), loop.period)
        assert controller.mode is Mode.BALANCE


def test_new_parameters_come_in_without_a_jump():
    loop = LOOPS[200]
    new = Design.make(replace(BALANCE, P1=0.9 * BALANCE.P1, P4=1.1 * BALANCE.P4, P5=1.1 * BALANCE.P5), loop)
    taus = {}
    for changed in (False, True):
        controller, rig, torque, taus[changed] = Controller(DESIGNS[200], loop), LatePlant(BALANCE, LAG), 0.0, []
        rig.place((UPRIGHT + 0.05, 0.02), (0.0, 0.0))
        for k in range(400):
            if changed and k == 60:
                controller.adopt(new)
                assert controller.design is new
            effort, torque = torque, controller.step(k * loop.period, rig.q, torque)
            rig.advance((effort, 0.0), loop.period)
            taus[changed].append(torque)
        assert controller.mode is Mode.BALANCE
    before, after = np.array(taus[False]), np.array(taus[True])
    np.testing.assert_array_equal(before[:60], after[:60])
    # At the change the torque is what it would have been; then, little by little, it is another one.
    largest = np.abs(np.diff(before[40:80])).max()
    assert abs(after[60] - before[60]) < largest
    assert np.abs(np.diff(after[55:80])).max() < 2 * largest
    assert np.abs(after[61:100] - before[61:100]).max() > 1e-3


@pytest.mark.parametrize(
    ('bounds', 'start', 'words'),
    [
        (Limits(shoulder=1.0), 'hanging', r'link 1 is 3\.\d+ rad from upright; at most 1 rad'),
        (Limits(elbow=0.5), 'hanging', 'the elbow has turned by'),
        (Limits(speed=3.0), 'hanging', 'a joint moves at'),
        (Limits(swing_up=0.0), 'hanging', 'not near enough to upright'),
        (Limits(swing_up=0.4), 'hanging', r'not upright after 0\.4 s'),
    ],
)
def test_it_stops_at_its_bounds(bounds, start, words):
    closed_loop = simulate_closed_loop(
        Controller(DESIGNS[200], LOOPS[200], bounds), LatePlant(BALANCE, LAG, place(start, 1)), LOOPS[200], 5.0
    )
    with pytest.raises(ControlError, match=words):
        raise ControlError(closed_loop.stopped)


@pytest.mark.parametrize(
    ('t', 'q', 'effort', 'words'),
    [
        (0.2, HANGING, 0.0, r'0\.195 s passed'),
        (0.005, HANGING, 0.0, r'0\.000 s passed'),
        (0.01, (math.nan, 0.0), 0.0, 'finite'),
        (0.01, HANGING, math.inf, 'finite'),
    ],
)
def test_it_stops_at_samples_that_make_no_sense(t, q, effort, words):
    controller = Controller(DESIGNS[200], LOOPS[200])
    controller.step(0.0, HANGING, 0.0)
    controller.step(0.005, HANGING, 0.0)
    with pytest.raises(ControlError, match=words):
        controller.step(t, q, effort)


@given(st.lists(st.floats(-30.0, 30.0), min_size=4, max_size=4), st.floats(-0.9, 0.9))
def test_the_swing_up_moves_link_1_as_it_wants(state, scale):
    """Partial feedback linearisation: under the torque, the shoulder accelerates as the law says, anywhere."""
    rig = replace(BALANCE, P3=BALANCE.P3 * (1 + scale / 2))
    q1, q2, v1, v2 = state
    torque = SwingUp(rig).torque((q1, q2, v1, v2))
    reached, _ = accelerations(tuple(rig.vector()), q1, q2, v1, v2, torque, 0.0, math)
    w = math.sqrt(rig.P5 * 9.81 / rig.P2)
    draw = 0.28 * (q1 - math.pi / 2) + 2 * 0.82 * math.sqrt(0.28) * v1 / w
    assert abs(reached / w**2 + draw) <= 0.8 + 1e-6


def test_too_small_a_motor_is_known_beforehand():
    weak = replace(LOOPS[200], limit=0.3)
    assert swing_up_time(Design.make(BALANCE, weak), weak) == math.inf
    enough = sufficient_limit(Design.make(BALANCE, weak), weak)
    assert 0.3 < enough < 2.0
    assert run('hanging', 1, loop=replace(weak, limit=enough)).held_since() < 10.0


@pytest.mark.parametrize(
    ('rig', 'words'),
    [
        (replace(BALANCE, P3=0.01), 'M\\(q\\) is not positive definite'),
        (replace(BALANCE, b1=-0.1), 'friction b1'),
        (replace(BALANCE, P5=-0.01), 'centre of mass at the elbow'),
    ],
)
def test_rigs_that_cannot_be_balanced_are_refused(rig, words):
    with pytest.raises(ControlError, match=words):
        Design.make(rig, Loop(0.02, 1, 0.02, 2.0))
