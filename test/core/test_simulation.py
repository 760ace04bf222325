import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from pendubot_identification.core.dynamics import energy, forward_dynamics
from pendubot_identification.core.errors import ParameterError
from pendubot_identification.core.parameters import PAPER, Parameters
from pendubot_identification.core.simulation import HANGING, Plant, quantised, simulate
from test.core.strategies import physical_parameters


@settings(max_examples=20)
@given(physical_parameters(), st.floats(-3, 3), st.floats(-3, 3))
def test_energy_is_constant_without_torque_and_friction(parameters, q1, q2):
    free = Parameters.from_vector([*parameters.vector()[:5], 0, 0])
    plant = Plant(free, (q1, q2))
    theta = free.vector()
    before = energy(theta, plant.q, plant.qd)
    for _ in range(50):
        plant.advance((0.0, 0.0), 0.01)
    swing = 9.81 * (free.P4 + free.P5)
    assert energy(theta, plant.q, plant.qd) == pytest.approx(before, abs=1e-5 * swing)


@settings(max_examples=20)
@given(physical_parameters(), st.floats(-1, 1))
def test_friction_only_takes_energy(parameters, q2):
    plant = Plant(parameters, (0.0, q2))
    theta = parameters.vector()
    energies = []
    for _ in range(30):
        energies.append(float(energy(theta, plant.q, plant.qd)))
        plant.advance((0.0, 0.0), 0.01)
    assert np.diff(energies).max() <= 1e-6 * 9.81 * (parameters.P4 + parameters.P5)


def test_agrees_with_an_adaptive_integrator():
    t, theta = np.arange(51) * 0.01, PAPER.vector()
    tau = np.column_stack([np.random.default_rng(1).uniform(-0.3, 0.3, 51), np.zeros(51)])
    x = np.array([*HANGING, 0.0, 0.0])
    for k in range(50):
        solution = solve_ivp(
            lambda _, s, k=k: [*s[2:], *forward_dynamics(theta, s[:2], s[2:], tau[k])],
            (t[k], t[k + 1]),
            x,
            rtol=1e-10,
            atol=1e-12,
        )
        x = solution.y[:, -1]
    motion = simulate(PAPER, t, tau)
    np.testing.assert_allclose([*motion.q[-1], *motion.qd[-1]], x, atol=1e-6)


def test_hanging_at_rest_stays_so():
    plant = Plant(PAPER)
    plant.advance((0.0, 0.0), 1.0)
    np.testing.assert_allclose([*plant.q, *plant.qd], [*HANGING, 0, 0], atol=1e-12)


def test_a_rig_that_cannot_be_is_refused():
    with pytest.raises(ParameterError, match='positive definite'):
        Plant(Parameters(1e-3, 1e-3, 1e-2, 0.1, 0.1, 0, 0))


def test_encoders_read_whole_counts_from_hanging():
    t = np.arange(200) * 0.01
    motion = simulate(PAPER, t, np.column_stack([np.full(200, 0.1), np.zeros(200)]))
    counts = (quantised(motion, 4000).q - HANGING) * 4000 / (2 * math.pi)
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-9)
    assert np.abs(quantised(motion, 4000).q - motion.q).max() <= math.pi / 4000 + 1e-12
