# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Many simulations at once, by the kernel and by numpy; test_dynamics proves that each is right."""

import numpy as np
import pytest

from pendubot_identification import kernel
from pendubot_identification.model.parameters import MODELS
from pendubot_identification.model.rollout import roll, sensitivities
from test.model.paths import both_paths, path
from test.virtual import GEARED, vector

models = pytest.mark.parametrize('model', MODELS)
#: One lane; few; no multiple of the kernel's block size; many blocks.
LANES = (1, 3, 42, 300)


def motion(lanes, steps, seed=1):
    """Return random states, and random torques at both joints."""
    rng = np.random.default_rng(seed)
    return rng.normal(scale=[[1], [1], [4], [4]], size=(4, lanes)), rng.normal(size=(2, steps, lanes))


@both_paths
@models
@pytest.mark.parametrize('lanes', LANES)
def test_results_do_not_depend_on_the_number_of_lanes(compiled, model, lanes):
    theta, h = vector(model), 1e-3
    x, tau = motion(max(LANES), 30)
    x, tau = x[:, -lanes:], tau[:, :, -lanes:]
    with path(compiled):
        states = roll(theta, x, tau, h)
        assert states.shape == (31, 4, lanes)
        np.testing.assert_array_equal(states[0], x)
        derivatives = sensitivities(theta, states, tau, h)
        assert derivatives.shape == (31, 4, 4 + len(theta), lanes)
        np.testing.assert_array_equal(sensitivities(theta, states, tau, h, every=7), derivatives[::7])
        for lane in {0, lanes // 2, lanes - 1}:
            alone = slice(lane, lane + 1)
            single = roll(theta, x[:, alone], tau[:, :, alone], h)
            np.testing.assert_allclose(states[:, :, alone], single, rtol=1e-12, atol=1e-12)
            expected = sensitivities(theta, single, tau[:, :, alone], h)
            np.testing.assert_allclose(derivatives[..., alone], expected, rtol=1e-9, atol=1e-12)


@both_paths
@pytest.mark.parametrize('lanes', [1, 3, 40])
def test_many_parameter_vectors_give_the_same_rollouts_as_one_at_a_time(compiled, lanes):
    rigs = GEARED * np.random.default_rng(2).uniform(0.8, 1.2, size=(5, len(GEARED)))
    x, tau = motion(lanes, 30)
    with path(compiled):
        together = roll(rigs.T[:, :, None], x, tau, 1e-3)
        assert together.shape == (31, 4, 5, lanes)
        for k, theta in enumerate(rigs):
            np.testing.assert_allclose(together[:, :, k], roll(theta, x, tau, 1e-3), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize('lanes', [1, 90, 203])
def test_results_do_not_depend_on_the_number_of_threads(monkeypatch, lanes):
    x, tau = motion(lanes, 900)
    found = []
    with path(True):
        for threads in (1, 2, 5):
            monkeypatch.setattr(kernel, 'threads', threads)
            states = roll(GEARED, x, tau, 1e-3)
            found.append((states, sensitivities(GEARED, states, tau, 1e-3)))
    for other in found[1:]:
        for a, b in zip(found[0], other, strict=True):
            np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize('speed', [0.0, 1e-12, 1e-4, 0.05, 3.0, 1e3, 1e5])
@pytest.mark.parametrize('angle', [0.0, -np.pi / 2, np.pi, 1e-9, 1e3, -3e5])
def test_the_elementary_functions_of_the_kernel_agree_with_numpy_at_all_speeds(speed, angle):
    """The accelerations contain sine, cosine, hyperbolic tangent and exponential."""
    x = np.array([[angle], [angle / 3], [speed], [-speed / 2]])
    found = []
    for compiled in (True, False):
        with path(compiled):
            found.append(roll(GEARED, x, np.array([[[0.3]], [[-0.1]]]), 1e-6))
    np.testing.assert_allclose(*found, rtol=1e-12, atol=1e-15)


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
@pytest.mark.parametrize('lanes', [1, 40])
def test_a_diverging_simulation_is_not_finite_and_gives_no_warning(compiled, cause, lanes):
    theta, h = DIVERGING[cause], 0.05
    x, tau = motion(lanes, 400)
    x[1] = 0.0
    with path(compiled):
        states = roll(theta, x, tau, h)
        derivatives = sensitivities(theta, states, tau, h)
        together = roll(np.stack([theta, theta], axis=1)[:, :, None], x, tau, h)
    assert not np.isfinite(states[-1]).all(axis=0).any()
    assert not np.isfinite(together[-1]).all(axis=0).any()
    assert not np.isfinite(derivatives[-1]).all(axis=(0, 1)).any()
    np.testing.assert_array_equal(states[0], x)
