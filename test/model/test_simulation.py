# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Simulations: against an adaptive integrator, and many at once by the kernel and by numpy."""

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pendubot_identification.errors import ParameterError
from pendubot_identification.excitation.design import Experiment, predict
from pendubot_identification.excitation.excitation import PulseTrain
from pendubot_identification.model.parameters import PAPER, Parameters
from pendubot_identification.model.rollout import roll, sensitivities
from pendubot_identification.model.simulation import HANGING, LatePlant, Plant, quantised, simulate, substeps
from test.model.test_dynamics import both, both_paths, path
from test.virtual import C1, GEARED, STIFF, integrated


@pytest.mark.parametrize('rig', [PAPER, Parameters.from_vector(GEARED)], ids=['paper', 'geared'])
def test_simulations_agree_with_an_adaptive_integrator(rig):
    """The dry friction of the geared rig stops it within 2 ms."""
    t = np.arange(26) * 0.01
    amplitude = 0.3 if rig.P1 < 0.01 else 3.0
    tau = np.column_stack([np.random.default_rng(1).uniform(-amplitude, amplitude, 26), np.zeros(26)])
    x = integrated(rig.vector(), [*HANGING, 0.0, 0.0], tau[:-1], 0.01)
    motion = simulate(rig, t, tau)
    # A tenth of an encoder count if dry friction reverses within a step.
    count = 2 * math.pi / 4000
    np.testing.assert_allclose(motion.q[-1], x[:2], atol=0.1 * count if rig.Fc1 else 1e-6)
    np.testing.assert_allclose(motion.qd[-1], x[2:], atol=3 * count if rig.Fc1 else 1e-6)


@pytest.mark.parametrize(('rig', 'parts'), [(PAPER, 1), (replace(C1, Fs2=0.16), 2), (STIFF, 5)])
def test_coarse_steps_are_subdivided_until_friction_is_stable(rig, parts):
    step, torques = 0.005, np.array([0.1, 0.0])
    assert substeps(rig, torques, step) == parts
    tau = np.zeros((2, 100 * parts, 1))
    states = roll(rig.vector(), np.array([[-1.5], [0.02], [0.0], [0.05]]), tau, step / parts)[::parts, :, 0]
    exact = simulate(rig, np.arange(101) * step, np.zeros((101, 2)), (-1.5, 0.02), (0.0, 0.05))
    np.testing.assert_allclose(states[:, :2], exact.q, atol=5e-4)
    assert substeps(replace(rig, P2=0.0, J2=0.0), torques, step) == 20


def test_an_unphysical_rig_is_refused():
    with pytest.raises(ParameterError, match='positive definite'):
        Plant(Parameters(1e-3, 1e-3, 1e-2, 0.1, 0.1, 0, 0))


@pytest.mark.parametrize('change', [{'b1': 6592.0}, {'Fc2': 10.0}, {'P4': 2e7}])
def test_a_rig_with_wrong_units_is_refused(change):
    rig = replace(PAPER, **change)
    for simulated in (Plant, lambda rig: predict(rig, [PulseTrain()], Experiment())):
        with pytest.raises(ParameterError, match=r'steps of .* s, and 1e-06 s or more is expected.*check their units'):
            simulated(rig)


def test_encoder_counts_are_integers_relative_to_hanging():
    t = np.arange(200) * 0.01
    motion = simulate(PAPER, t, np.column_stack([np.full(200, 0.1), np.zeros(200)]))
    counts = (quantised(motion, 4000).q - HANGING) * 4000 / (2 * math.pi)
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-9)
    assert np.abs(quantised(motion, 4000).q - motion.q).max() <= math.pi / 4000 + 1e-12


@settings(max_examples=20)
@given(st.integers(0, 12), st.lists(st.floats(-0.1, 0.1), min_size=8, max_size=8), st.sampled_from([3, 5, 10]))
def test_a_delayed_plant_moves_as_under_delayed_torques(delay_ms, torques, period_ms):
    """The sampling period and the delay are independent."""
    late, plain = LatePlant(PAPER, delay_ms * 1e-3), Plant(PAPER)
    fine = [0.0] * delay_ms + [torque for torque in torques for _ in range(period_ms)]
    for k, torque in enumerate(torques):
        late.advance((torque, 0.0), period_ms * 1e-3)
        for acting in fine[k * period_ms : (k + 1) * period_ms]:
            plain.advance((acting, 0.0), 1e-3)
        np.testing.assert_allclose((*late.q, *late.qd), (*plain.q, *plain.qd), rtol=1e-6, atol=1e-8)


def motion(lanes, steps, seed=1):
    """Return random states, and random torques at both joints."""
    rng = np.random.default_rng(seed)
    return rng.normal(scale=[[1], [1], [4], [4]], size=(4, lanes)), rng.normal(size=(2, steps, lanes))


@both_paths
def test_many_parameter_vectors_give_the_same_rollouts_as_one_at_a_time(compiled):
    rigs = GEARED * np.random.default_rng(2).uniform(0.8, 1.2, size=(5, len(GEARED)))
    x, tau = motion(3, 30)
    with path(compiled):
        together = roll(rigs.T[:, :, None], x, tau, 1e-3)
        assert together.shape == (31, 4, 5, 3)
        for k, theta in enumerate(rigs):
            np.testing.assert_allclose(together[:, :, k], roll(theta, x, tau, 1e-3), rtol=1e-12, atol=1e-12)


def test_the_elementary_functions_of_the_kernel_agree_with_numpy():
    """The accelerations contain sine, cosine, hyperbolic tangent and exponential."""
    angles, speeds = [0.0, -np.pi / 2, np.pi, 1e-9, 1e3, -3e5], [0.0, 1e-12, 1e-4, 0.05, 3.0, 1e3, 1e5]
    angle, speed = np.array(list(product(angles, speeds))).T
    x, tau = np.array([angle, angle / 3, speed, -speed / 2]), np.outer([0.3, -0.1], np.ones(len(angle)))
    np.testing.assert_allclose(*both(roll, GEARED, x, tau[:, None], 1e-6), rtol=1e-12, atol=1e-15)


#: Parameters by cause of divergence.
DIVERGING = {
    'friction': GEARED * [*[1] * 5, 1e4, 1e4, *[1] * 7],
    'negative friction': GEARED[:7] * [*[1] * 5, -1e3, -1e3],
    'singular': np.array([1.0, 1.0, 1.0, *GEARED[3:7]]),
    'massless': np.zeros(14),
}


@both_paths
@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('cause', DIVERGING)
def test_a_diverging_simulation_is_not_finite_and_gives_no_warning(compiled, cause):
    theta, h = DIVERGING[cause], 0.05
    x, tau = motion(10, 100)
    x[1] = 0.0
    with path(compiled):
        states = roll(theta, x, tau, h)
        derivatives = sensitivities(theta, states, tau, h)
        together = roll(np.stack([theta, theta], axis=1)[:, :, None], x, tau, h)
    assert not np.isfinite(states[-1]).all(axis=0).any()
    assert not np.isfinite(together[-1]).all(axis=0).any()
    assert not np.isfinite(derivatives[-1]).all(axis=(0, 1)).any()
    np.testing.assert_array_equal(states[0], x)
