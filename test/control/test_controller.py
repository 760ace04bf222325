# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The controller on simulated rigs: linearisation, prediction, swing-up, balancing, and safety stops."""

import functools
import math
from dataclasses import replace

import numpy as np
import pytest

from pendubot_identification.control.controller import UPRIGHT, Controller, SafetyLimits
from pendubot_identification.control.estimator import CommandMonitor, Estimator
from pendubot_identification.control.linear_control import Design, Loop, closed_loop, linearise, margins
from pendubot_identification.control.plan import Plan, held_since, simulate_closed_loop
from pendubot_identification.control.sign_check import SignCheck
from pendubot_identification.errors import ControlError
from pendubot_identification.model.dynamics import forward_dynamics
from pendubot_identification.model.parameters import BALANCE, PAPER, Parameters
from pendubot_identification.model.simulation import HANGING, LatePlant

LAG = 0.004
LOOPS = {rate: Loop(1 / rate, LAG, 2.0) for rate in (200, 500)}
#: Parameters of link 2 with errors of up to 30 %.
WRONG = replace(BALANCE, P2=1.3 * BALANCE.P2, P3=1.2 * BALANCE.P3, P5=1.15 * BALANCE.P5)


@functools.cache
def designed(known=BALANCE, rate=200):
    return Design.make(known, LOOPS[rate])


def place(start, seed):
    (q1, q2), spread = ((UPRIGHT, 0.0), 0.1) if start == 'upright' else (HANGING, 0.2)
    e1, e2 = np.random.default_rng(seed).uniform(-spread, spread, 2)
    return q1 + e1, q2 + e2


def run(start, seed, rate, seconds=12.0, **how):
    """Simulate a controller with inexact parameters."""
    rig = LatePlant(BALANCE, LAG, place(start, seed))
    return simulate_closed_loop(Controller(designed(WRONG, rate)), rig, seconds, enough=1.0, **how)


@pytest.mark.parametrize(('start', 'rate', 'within'), [('upright', 500, 1.0), ('hanging', 200, 10.0)])
def test_the_rig_is_swung_up_and_held_within_the_torque_limit_with_inexact_parameters(start, rate, within):
    closed_loop = run(start, 1, rate)
    assert not closed_loop.stopped
    assert held_since(closed_loop.motion) < within
    assert np.abs(closed_loop.motion.tau).max() <= 2.0
    assert start == 'hanging' or closed_loop.balancing[1:].all()


def test_the_rig_swings_up_again_after_a_push_makes_it_fall():
    controller = Controller(designed())
    rig = LatePlant(BALANCE, LAG, (UPRIGHT, 0.0))
    assert simulate_closed_loop(controller, rig, 0.5).balancing[-1]
    rig.place(rig.q, (0.0, 12.0))
    controller._last = None  # the time of the second simulation begins at 0 again
    closed_loop = simulate_closed_loop(controller, rig, 12.0, enough=1.0)
    assert not closed_loop.balancing.all()
    assert held_since(closed_loop.motion) < 10.0


@pytest.mark.parametrize(('start', 'rate'), [('upright', 200), ('hanging', 500)])
@pytest.mark.parametrize(
    ('wrong', 'words'),
    [
        ({'sensed': lambda q: (2 * HANGING[0] - q[0], q[1])}, "the shoulder's encoder counts the wrong way"),
        ({'sensed': lambda q: (q[0], -q[1])}, "the elbow's encoder counts the wrong way"),
        ({'motor': -1.0}, 'the motor turns the wrong way'),
        ({'sensed': lambda q: (q[1] + HANGING[0], q[0] - HANGING[0])}, 'shoulder and elbow are exchanged'),
    ],
)
def test_wrong_signs_and_exchanged_joints_are_named_within_a_fifth_of_a_second(start, rate, wrong, words):
    closed_loop = run(start, 0, rate, 0.3, **wrong)
    assert words in closed_loop.stopped
    assert closed_loop.motion.t[-1] < 0.2


def test_a_hand_that_holds_the_rig_is_not_mistaken_for_wrong_signs_and_wrong_signs_are_named_after_it():
    controller, held, torque = Controller(designed()), (UPRIGHT + 0.1, 0.0), 0.0
    for k in range(-200, 0):
        torque = controller.step(0.005 * k, held, torque)
    closed_loop = simulate_closed_loop(controller, LatePlant(BALANCE, LAG, held), 0.5, motor=-1.0)
    assert 'the motor turns the wrong way' in closed_loop.stopped


@pytest.mark.parametrize('inertia', [(1e-9, 1e-9, 9e-10), (0.0, 0.0, 0.0)])
def test_parameters_with_which_a_simulation_diverges_are_refused(inertia):
    check = SignCheck((*inertia, 1.0, 1.0, 0.0, 0.0), period=0.01, lag=0.0)
    with pytest.raises(ControlError, match='a simulation of the rig diverges'):
        any(check.update((0.1 * k, -0.1 * k), 1.0) for k in range(20))


def test_the_rig_is_swung_up_although_samples_are_lost():
    """The controller receives two of three samples, and occasionally none for 50 ms."""
    rng, torque, silent = np.random.default_rng(1), 0.0, 0
    controller, rig = Controller(designed()), LatePlant(BALANCE, LAG, place('hanging', 2))
    for k in range(800):
        effort = torque
        silent = 10 if k > 50 and rng.random() < 0.01 else silent - 1
        if silent <= 0 and rng.random() < 0.67:
            torque = controller.step(0.005 * k, rig.q, effort)
        rig.advance((effort, 0.0), 0.005)
    assert controller.balancing


def torques_with(change, new):
    """Return 100 torques that balance the rig; with ``change``, the design changes at sample 60."""
    controller, rig = Controller(designed()), LatePlant(BALANCE, LAG, (UPRIGHT + 0.05, 0.02))
    torques = [0.0]
    for k in range(100):
        if change and k == 60:
            controller.adopt(new)
        torques.append(controller.step(k * 0.005, rig.q, torques[-1]))
        rig.advance((torques[-2], 0.0), 0.005)
    assert controller.balancing
    return np.array(torques[1:])


def test_new_parameters_change_the_torque_continuously():
    new = replace(BALANCE, P1=0.9 * BALANCE.P1, P4=1.1 * BALANCE.P4, P5=1.1 * BALANCE.P5)
    before, after = (torques_with(change, Design.make(new, LOOPS[200])) for change in (False, True))
    np.testing.assert_array_equal(before[:60], after[:60])
    # The torque is continuous at the change; then it changes gradually.
    largest = np.abs(np.diff(before[40:80])).max()
    assert abs(after[60] - before[60]) < largest
    assert np.abs(np.diff(after[55:80])).max() < 2 * largest
    assert np.abs(after[61:100] - before[61:100]).max() > 1e-3


@pytest.mark.parametrize(
    ('bounds', 'words'),
    [
        ({'shoulder': 1.0}, 'rad from upright; at most 1 rad'),
        ({'elbow': 0.5}, 'the elbow has turned by'),
        ({'speed': 3.0}, 'a joint moves at'),
        ({'swing_up': 0.0}, 'too far from upright'),
        ({'swing_up': 0.4}, 'not upright after 0.4 s'),
    ],
)
def test_the_controller_stops_at_its_safety_limits(bounds, words):
    controller = Controller(designed(), SafetyLimits(**bounds))
    rig = LatePlant(BALANCE, LAG, place('hanging', 1))
    assert words in simulate_closed_loop(controller, rig, 5.0).stopped


@pytest.mark.parametrize(
    ('t', 'q', 'effort', 'words'),
    [
        (0.2, HANGING, 0.0, r'two samples is 0\.195 s'),
        (0.005, HANGING, 0.0, r'two samples is 0\.000 s'),
        (0.01, (math.nan, 0.0), 0.0, 'finite'),
        (0.01, HANGING, math.inf, 'finite'),
    ],
)
def test_the_controller_stops_at_invalid_samples(t, q, effort, words):
    controller = Controller(designed())
    controller.step(0.0, HANGING, 0.0)
    controller.step(0.005, HANGING, 0.0)
    with pytest.raises(ControlError, match=words):
        controller.step(t, q, effort)


def test_a_rig_with_much_friction_at_the_elbow_is_swung_up():
    assert Plan.make(replace(BALANCE, b2=0.001, Fc2=0.005), LOOPS[200]).swing_up < 5.0


def test_the_plan_finds_the_torque_limit_too_small_and_gives_a_sufficient_one():
    plan = Plan.make(BALANCE, Loop(0.01, 0.0, 0.8))
    assert plan.swing_up == math.inf
    assert 0.8 < plan.sufficient < 1.1


def test_the_gain_is_proportional_to_the_mass_also_of_a_small_rig():
    rig = np.array([4.375e-5, 1.933e-5, 2.305e-5, 1.233e-3, 4.896e-4, 2.5e-5, 1.1e-6])  # links of 5 cm
    gain, lighter = (Design.make(Parameters.from_vector(mass * rig), Loop(0.002)).K for mass in (1.0, 0.05))
    np.testing.assert_allclose(lighter, 0.05 * gain, rtol=1e-6)


@pytest.mark.parametrize(
    ('rig', 'loop', 'words'),
    [
        (replace(BALANCE, P5=-0.01), LOOPS[200], 'centre of mass of link 2 is at the elbow'),
        (BALANCE, Loop(0.05, 2.95), 'too slow to hold this rig upright'),
        # With the paper's values link 1 would be 3 cm long.
        (PAPER, Loop(0.01, 0.004, 2.0), r'margins are too small: gain factors of 0\.7. to 1\.1. and'),
    ],
)
def test_rigs_and_loops_that_cannot_be_balanced_are_refused(rig, loop, words):
    with pytest.raises(ControlError, match=words):
        Plan.make(rig, loop)


@pytest.mark.parametrize(('period', 'transport', 'lag'), [(0.005, 1, 0.0), (0.005, 2, 0.0065), (0.002, 1, 0.004)])
def test_the_prediction_is_the_true_state_at_the_time_when_the_torque_acts(period, transport, lag):
    delay, fine = transport * period + lag, 10
    estimator = Estimator(BALANCE, period, lag, Design.make(BALANCE, Loop(period, lag)).L)
    rig, rng = LatePlant(BALANCE, lag, (HANGING[0] + 0.2, 0.1)), np.random.default_rng(1)
    torques, states, predictions = [0.0] * transport, [], []
    for k in range(round(1 / period)):
        estimator.update(rig.q, torques[k])
        predictions.append(estimator.predict(torques[k + 1 :]))
        torques.append(rng.uniform(-0.5, 0.5))
        for _ in range(fine):
            states.append((*rig.q, *rig.qd))
            rig.advance((torques[k], 0.0), period / fine)
    true = np.array(states[round(delay / period * fine) :: fine])
    settled = slice(len(true) // 4, len(true))
    error = np.abs(np.array(predictions)[settled] - true[settled])
    assert error[:, :2].max() < 1e-4
    assert error[:, 2:].max() < 1e-2


def test_after_a_gap_the_speed_is_at_most_distance_over_time():
    estimator = Estimator(BALANCE, 0.005, 0.004, Design.make(BALANCE, Loop(0.005, 0.004)).L)
    estimator.update(HANGING, 0.0)
    estimator.update((HANGING[0] + 1.0, 1.0), 0.0, 20)
    assert max(map(abs, estimator.state[2:])) < 20


@pytest.mark.parametrize('transport', [1, 2, 5])
def test_the_latency_of_commands_is_measured_and_ignored_commands_are_detected_within_a_tenth_of_a_second(transport):
    monitor, rng, torques = CommandMonitor(0.005), np.random.default_rng(2), [0.0] * transport
    for k in range(200):
        assert monitor.obeyed(torques[k])
        torques.append(float(rng.uniform(-1, 1)))
        monitor.command(torques[-1])
    assert monitor.transport == transport
    assert monitor.pending() == torques[len(torques) + 1 - transport :]
    assert any(not monitor.obeyed(0.0) for _ in range(21))


@pytest.mark.parametrize('rig', [PAPER, BALANCE])
def test_the_linearisation_is_the_jacobian_of_the_equations_of_motion_at_the_upright_equilibrium(rig):
    def rates(x):
        return np.concatenate([x[2:4], forward_dynamics(rig.vector(), x[:2], x[2:4], x[4:])])

    rest, h = np.array([math.pi / 2, 0, 0, 0, 0, 0]), 1e-6
    np.testing.assert_allclose(rates(rest), 0.0, atol=1e-9)
    slopes = np.array([(rates(rest + h * e) - rates(rest - h * e)) / (2 * h) for e in np.eye(6)]).T
    np.testing.assert_allclose(np.hstack(linearise(rig)), slopes, rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize(('rate', 'lag'), [(200, 0.0013), (200, 0.011)])
def test_the_closed_loop_is_unstable_exactly_beyond_the_margins(rate, lag):
    design = Design.make(BALANCE, Loop(1 / rate, lag))
    m = margins(design)

    def radius(gain=1.0, delay=None):
        fixed, moved = closed_loop(design, delay)
        return abs(np.linalg.eigvals(fixed + gain * moved)).max()

    assert radius() < 1
    for inside, outside in (
        ({'gain': 0.99 * m.gain_up}, {'gain': 1.01 * m.gain_up}),
        ({'gain': 1.01 * m.gain_down}, {'gain': 0.99 * m.gain_down}),
        ({'gain': np.exp(-0.99j * m.phase)}, {'gain': np.exp(-1.01j * m.phase)}),
        ({'delay': design.loop.delay + 0.99 * m.delay}, {'delay': design.loop.delay + 1.01 * m.delay}),
    ):
        assert radius(**inside) < 1 < radius(**outside)
