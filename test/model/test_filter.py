# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The innovations of many filters by kernel and numpy, compared with an independent Kalman filter of a linear rig."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from pendubot_identification import kernel
from pendubot_identification.model.dynamics import GRAVITY, SIGN_WIDTH
from pendubot_identification.model.filter import Samples, Term, TermKind, Vectors, innovations
from pendubot_identification.model.rollout import roll, sensitivities
from test.model.test_dynamics import both, both_paths, path
from test.model.test_simulation import motion
from test.virtual import GEARED

#: One term of each kind at each joint, with the periods per turn or the speed that the kind needs.
NUMBER = {TermKind.SINE: 7.0, TermKind.COSINE: 3.0, TermKind.CREEP: 0.3}
TERMS = tuple(Term(kind, joint, NUMBER.get(kind, 0.0)) for kind in TermKind for joint in range(2))


def samples(groups=3, steps=40, tables=2, every=4, h=0.004, seed=1):
    """Return groups of decreasing length, padded to one length, with two levels and a measurement every few steps."""
    rng = np.random.default_rng(seed)
    length = steps - every * np.arange(groups)
    row = np.full((groups, steps), -1)
    measured = [(g, k) for g in range(groups) for k in range(every - 1, length[g], every)]
    row[tuple(np.transpose(measured))] = np.arange(len(measured))
    inside = np.arange(steps) < length[:, None]
    start = rng.normal(scale=[1, 1, 3, 3], size=(groups, 4))
    tau, change = rng.normal(size=(2, tables, groups, steps, 2)) * inside[..., None]
    moved = roll(GEARED, start.T, tau[0].transpose(2, 1, 0), h)[1:, :2].transpose(2, 0, 1)
    return Samples(
        start=start + rng.normal(scale=0.01, size=(tables, groups, 4)),
        spread=np.tile([1e-6, 1e-6, 0.04, 0.04], (groups, 1)),
        level=np.arange(groups) % 2,
        length=length,
        h=np.where(inside, h * rng.uniform(0.9, 1.1, (groups, steps)), 0.0),
        elapsed=np.where(inside, np.linspace(-0.5, 0.5, steps), 0.0),
        tau=tau,
        change=change,
        y=moved + rng.normal(scale=1e-3, size=(tables, groups, steps, 2)),
        row=row,
    )


def vectors(lanes=6, tables=2, terms=TERMS, seed=1):
    """Return random parameters; each term has a coefficient in half of the lanes."""
    rng = np.random.default_rng(seed)
    return Vectors(
        theta=GEARED[:, None] * rng.uniform(0.8, 1.2, (14, lanes)),
        offset=rng.normal(scale=0.01, size=(2, lanes)),
        noise=np.array([1e-6, 1e-6, 1e-3, 1e-3])[:, None] * rng.uniform(0.5, 2, (2, 4, lanes)),
        width=rng.uniform(0.02, 0.2, (2, lanes)),
        coefficient=rng.normal(scale=0.02, size=(len(terms), lanes)) * (rng.random((len(terms), lanes)) < 0.5),
        table=rng.integers(tables, size=lanes),
    )


@pytest.mark.parametrize('lanes', [1, 21])
def test_kernel_and_numpy_agree(lanes):
    read, unknown = samples(), vectors(lanes)
    kernels, numpys = both(innovations, read, unknown, TERMS)
    assert kernels[0].shape == (read.measurements, 2, lanes)
    assert np.isfinite(kernels).all()
    for a, b in zip(kernels, numpys, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-11)


def test_each_term_changes_the_innovations():
    """Each is alone in one lane; the last lane has none."""
    coefficient = 0.02 * np.eye(len(TERMS), len(TERMS) + 1)
    same = vectors(1, terms=())
    unknown = Vectors(
        **{name: np.repeat(getattr(same, name), len(TERMS) + 1, axis=-1) for name in same.__dataclass_fields__}
        | {'coefficient': coefficient}
    )
    e, _ = innovations(samples(), unknown, TERMS)
    assert (np.abs(e[..., :-1] - e[..., -1:]).max(axis=(0, 1)) > 1e-5).all()


def test_results_do_not_depend_on_the_number_of_threads(monkeypatch):
    read, unknown, (x, tau), found = samples(groups=8, steps=200), vectors(40), motion(203, 300), []
    with path(True):
        for threads in (1, 2, 5):
            monkeypatch.setattr(kernel, 'threads', threads)
            states = roll(GEARED, x, tau, 1e-3)
            found.append((states, sensitivities(GEARED, states, tau, 1e-3), *innovations(read, unknown, TERMS)))
    for other in found[1:]:
        for a, b in zip(found[0], other, strict=True):
            np.testing.assert_array_equal(a, b)


def test_results_do_not_depend_on_the_processor(monkeypatch):
    read, unknown, found = samples(groups=8, steps=200), vectors(21), []
    for name in ('_kernel', '_kernel_avx512'):
        if (library := kernel.opened(name)) is None:
            pytest.skip(f'{name} does not run here')
        monkeypatch.setattr(kernel, 'library', lambda library=library: library)
        found.append(innovations(read, unknown, TERMS))
    np.testing.assert_array_equal(*found)


def test_a_linear_rig_has_the_innovations_of_a_kalman_filter():
    """Two uncoupled pendulums near their lowest point, discretised by Van Loan's method."""
    theta = np.zeros(14)
    theta[[0, 1, 3, 5, 6]] = 0.05, 0.03, 0.2, 0.02, 0.01
    theta[9] = 0.02
    read = samples(groups=1, steps=400, every=2, tables=1, h=0.002, seed=3)
    tiny = 1e-4  # scale of the angles [rad], so that the sine is linear
    h = 0.002
    read = replace(
        read,
        start=np.array([[[-np.pi / 2, 0, 0, 0]]]) + tiny * np.array([[[1, -2, 3, 1]]]),
        spread=np.array([[1.0, 2.0, 3.0, 4.0]]) * tiny**2,
        h=np.full((1, 400), h),
        tau=tiny * read.tau,
        change=tiny * read.change,
        y=np.array([-np.pi / 2, 0]) + tiny * np.random.default_rng(4).normal(size=(1, 1, 400, 2)),
    )
    noise = np.array([1.0, 2.0, 3e-3, 4e-3]) * tiny**2
    none, noises = np.zeros((2, 1)), np.tile(noise[:, None], (2, 1, 1))
    unknown = Vectors(theta[:, None], none, noises, none + SIGN_WIDTH, none[:0], np.array([0]))
    found = both(innovations, read, unknown)

    M = np.array([[theta[0] + theta[1], theta[1]], [theta[1], theta[1] + theta[9]]])
    A, B = np.zeros((4, 4)), np.zeros((4, 2))
    A[:2, 2:] = np.eye(2)
    A[2:, :2] = -np.linalg.solve(M, np.diag([theta[3] * GRAVITY, 0.0]))
    A[2:, 2:] = -np.linalg.solve(M, np.diag(theta[5:7]))
    B[2:] = np.linalg.inv(M)
    ramp = np.block([[A, B, np.zeros((4, 2))], [np.zeros((2, 6)), np.eye(2)], [np.zeros((2, 8))]])
    F, G, G_rate = np.split(expm(h * ramp)[:4], [4, 6], axis=1)
    loan = expm(h * np.block([[-A, B @ np.diag(noise[2:]) @ B.T], [np.zeros((4, 4)), A.T]]))
    Q = loan[4:, 4:].T @ loan[:4, 4:]
    rest = np.array([-np.pi / 2, 0, 0, 0])
    x, P, R, H = read.start[0, 0] - rest, np.diag(read.spread[0]), np.diag(noise[:2]), np.eye(2, 4)
    expected = []
    for k in range(400):
        tau, change = read.tau[0, 0, k], read.change[0, 0, k]
        x, P = F @ x + G @ (tau - change) + G_rate @ (2 * change / h), F @ P @ F.T + Q
        if read.row[0, k] >= 0:
            S, innovation = H @ P @ H.T + R, read.y[0, 0, k] - rest[:2] - x[:2]
            lower = np.linalg.cholesky(S)
            expected.append((np.linalg.solve(lower, innovation) * np.diag(lower), np.diag(lower) ** 2))
            gain = P @ H.T @ np.linalg.inv(S)
            x, P = x + gain @ innovation, P - gain @ H @ P
    for e, s in found:
        np.testing.assert_allclose(e[:, :, 0], np.array(expected)[:, 0], rtol=2e-3, atol=1e-4 * tiny)
        np.testing.assert_allclose(s[:, :, 0], np.array(expected)[:, 1], rtol=1e-3)


@both_paths
@pytest.mark.filterwarnings('error')
def test_a_diverging_filter_is_not_finite_and_affects_no_other(compiled):
    read, unknown = samples(), vectors(5)
    theta = unknown.theta.copy()
    theta[5:7, 2] = 1e6  # too much friction for the step
    theta[2, 4] = np.sqrt(theta[0, 4] * theta[1, 4]) * 50  # M(q) is not positive definite
    with path(compiled):
        good = innovations(read, unknown, TERMS)
        bad = innovations(read, replace(unknown, theta=theta), TERMS)
    for a, b in zip(good, bad, strict=True):
        np.testing.assert_array_equal(a[:, :, [0, 1, 3]], b[:, :, [0, 1, 3]])
    assert not np.isfinite(bad[0][-1, :, 2]).any()
