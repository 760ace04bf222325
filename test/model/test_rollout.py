"""Many simulations at once, against one at a time, the virtual rig, an adaptive integrator and finite differences."""

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from pendubot_identification.model.dynamics import forward_dynamics
from pendubot_identification.model.parameters import MODELS, Parameters
from pendubot_identification.model.rollout import roll, sensitivities
from pendubot_identification.model.simulation import simulate

#: A rig with geared motors, as heavy as an arm on a table; of it, every model has its part.
GEARED = np.array([0.06, 0.05, 0.032, 0.23, 0.16, 0.01, 0.005, 0.25, 0.19, 0.0026, 0.1, 0.05, 0.15, 0.2])
models = pytest.mark.parametrize('model', MODELS)
#: Fewer and more than there must be for arrays to pay, at either end; several times what fits into a cache.
LANES = (1, 3, 40, 1500)


def rig(model):
    return GEARED[: MODELS[model]]


def motion(lanes, steps, seed=1):
    """States and torques at random, the torques at both joints."""
    rng = np.random.default_rng(seed)
    return rng.normal(scale=[[1], [1], [4], [4]], size=(4, lanes)), rng.normal(size=(2, steps, lanes))


@models
def test_moves_as_the_virtual_rig_does(model):
    h, steps = 1e-4, 400
    x, tau = motion(2, steps)
    states = roll(rig(model), x, tau, h)
    for lane in range(2):
        t, torques = np.arange(steps + 1) * h, np.append(tau[:, :, lane].T, [[0, 0]], axis=0)
        expected = simulate(Parameters.from_vector(rig(model)), t, torques, tuple(x[:2, lane]), tuple(x[2:, lane]))
        np.testing.assert_allclose(states[:, :2, lane], expected.q, rtol=1e-10, atol=1e-10)
        np.testing.assert_allclose(states[:, 2:, lane], expected.qd, rtol=1e-10, atol=1e-10)


@models
def test_its_error_falls_with_the_fourth_power_of_the_step(model):
    theta = rig(model)
    x, coarse = motion(1, 4)
    hold = 0.01
    exact = x[:, 0]
    for k in range(4):
        exact = solve_ivp(
            lambda _, s, k=k: [*s[2:], *forward_dynamics(theta, s[:2], s[2:], coarse[:, k, 0])],
            (0, hold),
            exact,
            method='DOP853',
            rtol=1e-13,
            atol=1e-13,
        ).y[:, -1]
    errors = [
        np.abs(roll(theta, x, np.repeat(coarse, each, axis=1), hold / each)[-1, :, 0] - exact).max()
        for each in (20, 40, 80)
    ]
    assert errors[0] < 1e-4
    # From 2^4, as far as rounding allows.
    assert errors[1] < errors[0] / 12
    assert errors[2] < errors[1] / 12 + 1e-11


@models
@pytest.mark.parametrize('lanes', LANES)
def test_any_number_of_lanes_gives_the_same_numbers(model, lanes):
    theta, h = rig(model), 1e-3
    x, tau = motion(max(LANES), 30)
    x, tau = x[:, -lanes:], tau[:, :, -lanes:]
    states = roll(theta, x, tau, h)
    assert states.shape == (31, 4, lanes)
    np.testing.assert_array_equal(states[0], x)
    derivatives = sensitivities(theta, states, tau, h)
    assert derivatives.shape == (30, 4, 4 + len(theta), lanes)
    for lane in {0, lanes // 2, lanes - 1}:
        alone = slice(lane, lane + 1)
        single = roll(theta, x[:, alone], tau[:, :, alone], h)
        np.testing.assert_allclose(states[:, :, alone], single, rtol=1e-12, atol=1e-12)
        expected = sensitivities(theta, single, tau[:, :, alone], h)
        np.testing.assert_allclose(derivatives[..., alone], expected, rtol=1e-9, atol=1e-12)


@models
@pytest.mark.parametrize('lanes', [1, 3, 40])
def test_many_parameter_vectors_at_once_give_the_same_numbers_as_one_at_a_time(model, lanes):
    rng = np.random.default_rng(2)
    rigs = rig(model) * rng.uniform(0.8, 1.2, size=(5, MODELS[model]))
    x, tau = motion(lanes, 30)
    together = roll(rigs.T[:, :, None], x, tau, 1e-3)
    assert together.shape == (31, 4, 5, lanes)
    for k, theta in enumerate(rigs):
        np.testing.assert_allclose(together[:, :, k], roll(theta, x, tau, 1e-3), rtol=1e-12, atol=1e-12)


@settings(max_examples=20)
@given(st.sampled_from(list(MODELS)), st.sampled_from([1, 3, 40]), st.integers(0, 2**32 - 1))
def test_sensitivities_are_the_slopes_of_what_is_simulated(model, lanes, seed):
    rng = np.random.default_rng(seed)
    theta = rig(model) * rng.uniform(0.8, 1.2, MODELS[model])
    h, steps = 1e-3, 20
    x, tau = motion(lanes, steps, seed)
    derivatives = sensitivities(theta, roll(theta, x, tau, h), tau, h)

    def slope(move, size):
        return (roll(*move(size), tau, h)[1:] - roll(*move(-size), tau, h)[1:]) / (2 * size)

    for k in range(4 + len(theta)):
        if k < 4:
            size, move = 1e-6, lambda d, k=k: (theta, x + d * np.eye(4)[:, [k]])
        else:
            size, move = 1e-6 * theta[k - 4], lambda d, k=k - 4: (theta + d * np.eye(len(theta))[k], x)
        expected = slope(move, size)
        scale = np.abs(expected).max(axis=0)
        assert (np.abs(derivatives[:, :, k] - expected) <= 1e-4 * scale + 1e-6).all(), k


@models
def test_sensitivities_of_a_part_are_those_of_the_whole(model):
    theta, h, steps = rig(model), 1e-3, 2500
    x, tau = motion(1, steps)
    tau *= 0.3
    states = roll(theta, x, tau, h)
    whole = sensitivities(theta, states, tau, h)
    part = sensitivities(theta, states[:101], tau[:, :100], h)
    np.testing.assert_allclose(whole[:100], part, rtol=1e-9)
    # Behind the seams between what is computed together: a step's own derivative carries the one before it on.
    for k in (1023, 1024, 2048, 2499):
        step = sensitivities(theta, states[k : k + 2], tau[:, k : k + 1], h)[0, :, :, 0]
        before = whole[k - 1, :, :, 0]
        carried = step[:, :4] @ before
        carried[:, 4:] += step[:, 4:]
        np.testing.assert_allclose(whole[k, :, :, 0], carried, rtol=1e-9, atol=1e-9 * np.abs(carried).max())


#: Too long a step for its friction; a mass matrix that is singular at the start; one with no inverse anywhere.
UNFOLLOWABLE = {
    'friction': GEARED * [*[1] * 5, 1e4, 1e4, *[1] * 7],
    'energy out of nothing': GEARED[:7] * [*[1] * 5, -1e3, -1e3],
    'singular': np.array([1.0, 1.0, 1.0, *GEARED[3:7]]),
    'massless': np.zeros(14),
}


@pytest.mark.parametrize('what', UNFOLLOWABLE)
@pytest.mark.parametrize('lanes', [1, 40])
def test_a_motion_that_cannot_be_followed_becomes_nan_or_infinite_in_silence(what, lanes):
    theta, h = UNFOLLOWABLE[what], 0.05
    x, tau = motion(lanes, 400)
    x[1] = 0.0
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        states = roll(theta, x, tau, h)
        derivatives = sensitivities(theta, states, tau, h)
        together = roll(np.stack([theta, theta], axis=1)[:, :, None], x, tau, h)
    assert not np.isfinite(states[-1]).all(axis=0).any()
    assert not np.isfinite(together[-1]).all(axis=0).any()
    assert not np.isfinite(derivatives[-1]).all(axis=(0, 1)).any()
    np.testing.assert_array_equal(states[0], x)


@pytest.mark.parametrize('lanes', [3, 40])
def test_a_motion_that_cannot_be_followed_leaves_the_others_alone(lanes):
    x, tau = motion(lanes, 30)
    expected = roll(GEARED, x, tau, 1e-3)
    broken = x.copy()
    broken[2, 1] = 1e200
    states = roll(GEARED, broken, tau, 1e-3)
    derivatives = sensitivities(GEARED, states, tau, 1e-3)
    others = np.arange(lanes) != 1
    np.testing.assert_array_equal(states[..., others], expected[..., others])
    assert not np.isfinite(states[-1, :, 1]).all()
    assert np.isfinite(derivatives[..., others]).all()


def test_no_step_is_no_motion():
    for lanes in (1, 40):
        x, tau = motion(lanes, 0)
        states = roll(GEARED, x, tau, 1e-3)
        np.testing.assert_array_equal(states, x[None])
        assert sensitivities(GEARED, states, tau, 1e-3).shape == (0, 4, 18, lanes)
