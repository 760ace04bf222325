# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Linearisation, compared with the equations of motion, and margins, compared with the closed loop."""

import math

import numpy as np
import pytest

from pendubot_identification.control.linear_control import Design, Loop, closed_loop, linearise, margins
from pendubot_identification.errors import ControlError
from pendubot_identification.model.dynamics import forward_dynamics
from pendubot_identification.model.parameters import BALANCE, PAPER


@pytest.mark.parametrize('rig', [PAPER, BALANCE])
def test_the_linearisation_is_the_jacobian_of_the_equations_of_motion_at_the_upright_equilibrium(rig):
    def rates(x):
        return np.concatenate([x[2:4], forward_dynamics(rig.vector(), x[:2], x[2:4], x[4:])])

    rest, h = np.array([math.pi / 2, 0, 0, 0, 0, 0]), 1e-6
    np.testing.assert_allclose(rates(rest), 0.0, atol=1e-9)
    slopes = np.array([(rates(rest + h * e) - rates(rest - h * e)) / (2 * h) for e in np.eye(6)]).T
    np.testing.assert_allclose(np.hstack(linearise(rig)), slopes, rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize(('rate', 'lag'), [(200, 0.0013), (500, 0.011)])
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


def test_a_loop_too_slow_to_balance_is_refused():
    with pytest.raises(ControlError, match='too slow to hold this rig upright'):
        margins(Design.make(BALANCE, Loop(0.05, 2.95)))
