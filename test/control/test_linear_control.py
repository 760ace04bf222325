# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Linearisation against the equations of motion, gains against their optimality, margins against the closed loop."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pendubot_identification.control.controller import Controller, Design, Loop, SafetyLimits
from pendubot_identification.control.linear_control import (
    ANGLE,
    TORQUE,
    closed_loop,
    design,
    linearise,
    margins,
    sampled,
)
from pendubot_identification.control.plan import HELD, deviation, simulate_closed_loop
from pendubot_identification.errors import ControlError
from pendubot_identification.model.dynamics import forward_dynamics
from pendubot_identification.model.parameters import BALANCE, PAPER
from pendubot_identification.model.simulation import LatePlant

LAG = 0.004


@pytest.mark.parametrize('rig', [PAPER, BALANCE])
def test_upright_nothing_moves_and_the_slope_is_that_of_the_equations_of_motion(rig):
    def rates(x):
        return np.concatenate([x[2:4], forward_dynamics(rig.vector(), x[:2], x[2:4], x[4:])])

    rest, h = np.array([math.pi / 2, 0, 0, 0, 0, 0]), 1e-6
    np.testing.assert_allclose(rates(rest), 0.0, atol=1e-9)
    slopes = np.array([(rates(rest + h * e) - rates(rest - h * e)) / (2 * h) for e in np.eye(6)]).T
    np.testing.assert_allclose(np.hstack(linearise(rig)), slopes, rtol=1e-5, atol=1e-4)


def test_a_sampled_model_is_the_integral_of_the_continuous_one():
    A, B = linearise(BALANCE)
    x = np.array([0.01, -0.02, 0.1, 0.3])
    exact = solve_ivp(lambda _, y: A @ y + 0.3 * B[:, 0], (0, 0.02), x, rtol=1e-10, atol=1e-12).y[:, -1]
    Phi, Gamma = sampled(A, B, 0.02)
    np.testing.assert_allclose(Phi @ x + 0.3 * Gamma[:, 0], exact, rtol=1e-7)


def test_no_other_gain_costs_less():
    """The cost of a start under K, summed sample by sample, is x' S x, and grows whichever way K is changed."""
    r = design(BALANCE, 0.005, 0.005)
    Phi, Gamma = sampled(r.A, r.B, r.period)
    weight = (BALANCE.P4 + BALANCE.P5) * 9.81

    def cost(K):
        x, total = np.array([0.02, -0.01, 0.1, 0.0]), 0.0
        for _ in range(3000):
            u = -K @ x
            total += (x[:2] ** 2).sum() / ANGLE**2 + (u / (TORQUE * weight)) ** 2
            x = Phi @ x + Gamma[:, 0] * u
        return total

    best = cost(r.K)
    x = np.array([0.02, -0.01, 0.1, 0.0])
    assert best == pytest.approx(x @ r.S @ x, rel=1e-6)
    for k in range(4):
        for factor in (0.97, 1.03):
            assert cost(r.K * np.where(np.arange(4) == k, factor, 1.0)) > best


@pytest.mark.parametrize(('rate', 'lag'), [(200, 0.0013), (500, 0.011)])
def test_margins_are_where_the_closed_loop_ceases_to_be_stable(rate, lag):
    r = design(BALANCE, 1 / rate, 1 / rate + lag)
    m = margins(r)

    def radius(gain=1.0, delay=None):
        fixed, moved = closed_loop(r, delay)
        return abs(np.linalg.eigvals(fixed + gain * moved)).max()

    assert radius() < 1
    for inside, outside in (
        ({'gain': 0.99 * m.gain_up}, {'gain': 1.01 * m.gain_up}),
        ({'gain': 1.01 * m.gain_down}, {'gain': 0.99 * m.gain_down}),
        ({'gain': np.exp(-0.99j * m.phase)}, {'gain': np.exp(-1.01j * m.phase)}),
        ({'delay': r.delay + 0.99 * m.delay}, {'delay': r.delay + 1.01 * m.delay}),
    ):
        assert radius(**inside) < 1 < radius(**outside)


def test_the_simulated_rig_falls_at_the_computed_margins():
    """Within 20 %, with encoder counts, the torque's limit and all that is not linear."""
    loop = Loop(1 / 200, LAG, 2.0)
    plan = Design.make(BALANCE, loop)

    def falls(more=0.0, gain=1.0):
        rig = LatePlant(BALANCE, LAG + more, (math.pi / 2 + 0.01, 0.0))
        run = simulate_closed_loop(Controller(plan, loop, SafetyLimits(swing_up=0.0)), rig, loop, 3.0, motor=gain)
        return bool(run.stopped) or bool(deviation(run.motion.q).max() > HELD)

    m = plan.margins
    assert not falls(more=0.8 * m.delay)
    assert falls(more=1.2 * m.delay)
    assert not falls(gain=1.2 * m.gain_down)
    assert falls(gain=0.8 * m.gain_down)


def test_what_is_too_slow_to_balance_is_said():
    with pytest.raises(ControlError, match='too slow to hold this rig upright'):
        margins(design(BALANCE, 0.05, 3.0))
