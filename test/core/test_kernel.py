"""Motions and sensitivities: the compiled kernel against numpy."""

import contextlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pendubot_identification.core import kernel
from pendubot_identification.core.model.parameters import MODELS
from pendubot_identification.core.model.rollout import roll, sensitivities
from test.core.virtual import GEARED

# Here and nowhere else: whoever switches the kernel off wants to see that all the rest works without it.
pytestmark = pytest.mark.skipif(kernel.library() is None, reason=kernel.description())


@contextlib.contextmanager
def without_kernel():
    before, kernel.wanted = kernel.wanted, False
    try:
        yield
    finally:
        kernel.wanted = before


def both(work):
    """Return what the kernel makes of it, and what numpy does."""
    compiled = work()
    with without_kernel():
        return compiled, work()


@pytest.mark.parametrize('lanes', [1, 90, 203])
def test_motions_do_not_depend_on_the_threads(monkeypatch, lanes):
    x, tau = random_motion(lanes, 900, 3)
    found = []
    for threads in (1, 2, 5):
        monkeypatch.setattr(kernel, 'threads', threads)
        states = roll(GEARED, x, tau, 1e-3)
        found.append((states, sensitivities(GEARED, states, tau, 1e-3)))
    for other in found[1:]:
        for a, b in zip(found[0], other, strict=True):
            np.testing.assert_array_equal(a, b)


def random_motion(lanes, steps, seed):
    rng = np.random.default_rng(seed)
    return rng.normal(scale=[[2], [2], [4], [4]], size=(4, lanes)), rng.normal(size=(2, steps, lanes))


@settings(max_examples=40)
@given(
    st.sampled_from(sorted(MODELS)), st.integers(1, 150), st.integers(0, 30), st.integers(0, 5), st.integers(0, 1000)
)
def test_motions_and_sensitivities_agree(model, lanes, steps, vectors, seed):
    x, tau = random_motion(lanes, steps, seed)
    theta = GEARED[: MODELS[model]]
    if vectors:
        theta = (theta[:, None] * np.random.default_rng(seed).uniform(0.7, 1.3, (len(theta), vectors)))[:, :, None]
    compiled, numpys = both(lambda: roll(theta, x, tau, 1e-3))
    assert compiled.shape == numpys.shape
    np.testing.assert_allclose(compiled, numpys, rtol=1e-10, atol=1e-10)
    if not vectors:
        compiled, numpys = both(lambda: sensitivities(theta, numpys, tau, 1e-3))
        assert compiled.shape == numpys.shape
        np.testing.assert_allclose(compiled, numpys, rtol=1e-9, atol=1e-9 * np.abs(numpys).max(initial=0.0))


@pytest.mark.parametrize('speed', [0.0, 1e-12, 1e-4, 0.05, 3.0, 1e3, 1e5])
@pytest.mark.parametrize('angle', [0.0, -np.pi / 2, np.pi, 1e-9, 1e3, -3e5])
def test_elementary_functions_hold_from_rest_to_absurd_speeds(speed, angle):
    """Sine, cosine, hyperbolic tangent and exponential have no way out but through the accelerations."""
    x = np.array([[angle], [angle / 3], [speed], [-speed / 2]])
    tau = np.array([[[0.3]], [[-0.1]]])
    compiled, numpys = both(lambda: roll(GEARED, x, tau, 1e-6))
    np.testing.assert_allclose(compiled, numpys, rtol=1e-12, atol=1e-15)


def test_arrays_of_any_layout_are_understood():
    x, tau = random_motion(40, 10, 1)
    compiled, numpys = both(lambda: roll(GEARED[:7].copy(), x[:, ::-2], np.asfortranarray(tau)[:, :, ::-2], 1e-3))
    np.testing.assert_allclose(compiled, numpys, rtol=1e-10, atol=1e-10)
