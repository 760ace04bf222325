# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Rigid-body dynamics of two links in a vertical plane: the paper's equations (1), (2) and (4), and friction.

    M(q) q'' + V(q, q') q' + G(q) = tau - friction(q', tau)

q1 is measured from the horizontal, q2 relative to link 1; on a pendubot tau2 = 0. ``theta`` is the vector P1 P2 P3
P4 P5 b1 b2, continued by Fc1 Fc2 J2 Fs1 Fs2 k1 k2: D = 7, 9, 10 or 14 parameters, by the model
(:data:`.parameters.MODELS`). motion.h and rollout.c implement the same equations in C.
"""

from collections.abc import Callable, Iterator, Sequence
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from pendubot_identification.arrays import Array

from . import MODELS

#: One value for each joint: shoulder, elbow.
Pair = tuple[float, float]

#: Standard gravity [m/s^2]. The printed G of the paper lacks this factor, which P4 and P5 as defined require.
GRAVITY = 9.81
#: The sign of a velocity v in dry friction is tanh(v / SIGN_WIDTH) [rad/s].
SIGN_WIDTH = 0.05
#: The Stribeck part of dry friction is exp(-(v / STRIBECK_SPEED)^2) times its value at rest [rad/s].
STRIBECK_SPEED = 0.5
#: No torques of both joints, and none of their derivatives.
NO_TERMS = np.zeros((3, 2))


def accelerations(
    theta: Sequence[Any] | Array,
    x: Any,
    tau: Any,
    lib: ModuleType = np,
    more: Any = (0.0, 0.0),
    width: Any = (SIGN_WIDTH, SIGN_WIDTH),
) -> tuple[Any, Any]:
    """Return q1'', q2'' [rad/s^2] by the equations of motion, with the closed-form inverse of M(q).

    ``theta``, the state x = (q1, q2, q1', q2') and both torques are sequences of numbers or arrays, which broadcast.
    ``more`` are torques [N m] that cause no friction under load; ``width`` [rad/s] replaces :data:`SIGN_WIDTH`. With
    ``lib=math`` all values are floats, which takes a tenth of the time of arrays of length one.
    """
    (q1, q2, v1, v2), (P3, P4, P5) = x, theta[2:5]
    c2, s2 = lib.cos(q2), lib.sin(q2)
    m11, m12, m22 = _inertia(theta, c2)
    f1, f2 = _friction(theta, v1, v2, tau, lib, width)
    g2 = P5 * GRAVITY * lib.cos(q1 + q2)
    h1 = tau[0] + more[0] - f1 + P3 * s2 * (2 * v1 * v2 + v2 * v2) - P4 * GRAVITY * lib.cos(q1) - g2
    h2 = tau[1] + more[1] - f2 - P3 * s2 * v1 * v1 - g2
    determinant = m11 * m22 - m12 * m12
    return (m22 * h1 - m12 * h2) / determinant, (m11 * h2 - m12 * h1) / determinant


def _inertia(theta: Sequence[Any] | Array, c2: Any) -> tuple[Any, Any, Any]:
    """Return the entries m11, m12, m22 of M(q) [kg m^2], where c2 is cos q2."""
    P1, P2, P3 = theta[:3]
    return P1 + P2 + 2 * P3 * c2, P2 + P3 * c2, P2 + (theta[9] if len(theta) >= 10 else 0.0)


def _friction(theta: Sequence[Any] | Array, v1: Any, v2: Any, tau: Any, lib: ModuleType, width: Any) -> tuple[Any, Any]:
    """Return the friction of each joint [N m]: b v + (Fc + Fs exp(-(v / 0.5)^2) + k |tau|) tanh(v / width)."""
    size = len(theta)
    f1, f2 = theta[5] * v1, theta[6] * v2
    if size < 9:
        return f1, f2
    dry1, dry2 = theta[7], theta[8]
    if size >= 14:
        Fs1, Fs2, k1, k2 = theta[10:]
        dry1 = dry1 + Fs1 * lib.exp(-((v1 / STRIBECK_SPEED) ** 2)) + k1 * lib.fabs(tau[0])
        dry2 = dry2 + Fs2 * lib.exp(-((v2 / STRIBECK_SPEED) ** 2)) + k2 * lib.fabs(tau[1])
    return f1 + dry1 * lib.tanh(v1 / width[0]), f2 + dry2 * lib.tanh(v2 / width[1])


def padded(theta: Array) -> Array:
    """Return the parameters of the largest model, shape (14, ...), of shape (D, ...); missing ones are 0."""
    return np.concatenate([theta, np.zeros((MODELS['geared'] - len(theta), *theta.shape[1:]))])


class Linearised(NamedTuple):
    """The equations of motion at states x = (q1, q2, q1', q2'): M da = slopes dx."""

    a: Array  #: q'' [rad/s^2], shape (2, ...).
    M: Array  #: M(q) [kg m^2], shape (2, 2, ...).
    slopes: Array  #: of the torques by the state, shape (2, 4, ...).

    @property
    def inverse(self) -> Array:
        """M(q)^-1, shape (2, 2, ...)."""
        (m11, m12), (_, m22) = self.M
        return np.asarray(np.array([[m22, -m12], [-m12, m11]]) / (m11 * m22 - m12 * m12))

    @property
    def by_state(self) -> Array:
        """The derivatives of q'' by the state, shape (2, 4, ...)."""
        return product(self.inverse, self.slopes)


def product(A: Array, B: Array) -> Array:
    """Return the matrix products over the first two axes."""
    return np.asarray(np.einsum('ij...,jk...->ik...', A, B))


def linearised(theta: Array, x: Any, tau: Any, width: Any = SIGN_WIDTH, terms: Any = NO_TERMS) -> Linearised:
    """Linearise the equations of motion at L states x, shape (4, ...), under torques [N m], shape (2, ...).

    ``theta``: the 14 parameters, each a number or an array that broadcasts with the states. ``width`` [rad/s] of both
    joints: see :func:`accelerations`. ``terms``: further torques, and their derivatives by angle and speed of their
    joint, of shape (3, 2, ...).
    """
    _, _, P3, P4, P5, *_ = theta
    (q1, q2, v1, v2), (more, by_q, by_v), width = x, terms, np.broadcast_to(width, np.shape(x[2:]))
    a = a1, a2 = accelerations(theta, x, tau, np, more, width)
    c2, s2 = np.cos(q2), np.sin(q2)
    m11, m12, m22 = np.broadcast_arrays(*_inertia(theta, c2))
    slope = []
    for j, v in enumerate((v1, v2)):
        sign, stribeck = np.tanh(v / width[j]), theta[10 + j] * np.exp(-((v / STRIBECK_SPEED) ** 2))
        dry = theta[7 + j] + stribeck + theta[12 + j] * np.abs(tau[j])
        change = dry * (1 - sign * sign) / width[j] - stribeck * sign * v * (2 / STRIBECK_SPEED**2)
        slope.append(theta[5 + j] + change - by_v[j])
    g12 = P5 * GRAVITY * np.sin(q1 + q2)
    slopes = [
        [
            P4 * GRAVITY * np.sin(q1) + g12 + by_q[0],
            P3 * (c2 * v2 * (2 * v1 + v2) + s2 * (2 * a1 + a2)) + g12,
            2 * P3 * s2 * v2 - slope[0],
            2 * P3 * s2 * (v1 + v2),
        ],
        [g12, P3 * (s2 * a1 - c2 * v1 * v1) + g12 + by_q[1], -2 * P3 * s2 * v1, -slope[1]],
    ]
    return Linearised(np.array(a), np.array([[m11, m12], [m12, m22]]), np.array(slopes))


def regressor(a: Array, x: Any, tau: Any) -> Array:
    """Return Phi, shape (2, 14, L), of the inverse dynamics tau = Phi theta; q'' and tau are (2, L), x is (4, L)."""
    (a1, a2), (q1, q2, v1, v2) = a, x
    c2, s2 = np.cos(q2), np.sin(q2)
    rows = np.zeros((2, MODELS['geared'], len(q1)))
    rows[0, 0], rows[:, 1] = a1, a1 + a2
    rows[:, 2] = c2 * (2 * a1 + a2) - s2 * v2 * (2 * v1 + v2), s2 * v1 * v1 + c2 * a1
    rows[0, 3], rows[:, 4] = GRAVITY * np.cos(q1), GRAVITY * np.cos(q1 + q2)
    rows[0, 5], rows[1, 6], rows[1, 9] = v1, v2, a2
    dry = dry_friction_terms(np.transpose([v1, v2]), np.transpose(tau))
    rows[0, [7, 10, 12]], rows[1, [8, 11, 13]] = dry.transpose(1, 2, 0)
    return rows


def runge_kutta(accelerated: Callable[..., Any], x: Any, h: Any, first: Any = None) -> tuple[Any, ...]:
    """Return the state one classic Runge-Kutta step of h [s] after the state x = (q1, q2, q1', q2').

    ``accelerated(x)`` returns q1'' and q2'', ``first`` are these at x if they are known; all are numbers or arrays.
    """
    q1, q2, v1, v2 = x
    half, sixth = h / 2, h / 6
    k1, l1 = accelerated((q1, q2, v1, v2)) if first is None else first
    u1, u2 = v1 + half * k1, v2 + half * l1
    k2, l2 = accelerated((q1 + half * v1, q2 + half * v2, u1, u2))
    w1, w2 = v1 + half * k2, v2 + half * l2
    k3, l3 = accelerated((q1 + half * u1, q2 + half * u2, w1, w2))
    k4, l4 = accelerated((q1 + h * w1, q2 + h * w2, v1 + h * k3, v2 + h * l3))
    return (
        q1 + h * (v1 + sixth * (k1 + k2 + k3)),
        q2 + h * (v2 + sixth * (l1 + l2 + l3)),
        v1 + sixth * (k1 + 2 * (k2 + k3) + k4),
        v2 + sixth * (l1 + 2 * (l2 + l3) + l4),
    )


def stages(tau: Array, change: Array) -> Iterator[Array]:
    """Yield the torque of each stage of a Runge-Kutta step, from its mean and half of its change."""
    yield from (tau - change, tau, tau, tau + change)


def advance(
    theta: Sequence[Any] | Array, x: Sequence[Any], tau: Any, h: float, lib: ModuleType = np
) -> tuple[Any, ...]:
    """Return the state one step of h [s] after the state x under torques of both joints [N m], on arrays or floats."""
    return runge_kutta(lambda at: accelerations(theta, at, tau, lib), x, h)


def forward_dynamics(theta: ArrayLike, q: ArrayLike, qd: ArrayLike, tau: ArrayLike) -> Array:
    """Return the accelerations q'' [rad/s^2], shape (..., 2).

    q, qd and tau have shape (..., 2), theta (D,) or (..., D); they broadcast.
    """
    return np.stack(accelerations(_split(theta), (*_split(q), *_split(qd)), _split(tau)), axis=-1)


def mass_matrix(theta: ArrayLike, q: ArrayLike) -> Array:
    """Return M(q) [kg m^2], shape (..., 2, 2).

    Positions q [rad] have shape (..., 2), theta (D,) or (..., D); they broadcast.
    """
    m11, m12, m22 = np.broadcast_arrays(*_inertia(_split(theta), np.cos(np.asarray(q, dtype=float)[..., 1])))
    return np.stack([m11, m12, m12, m22], axis=-1).reshape(*m11.shape, 2, 2)


def energy(theta: ArrayLike, q: ArrayLike, qd: ArrayLike) -> Array:
    """Return the total energy [J], shape (...): 1/2 q'^T M q' + P4 g sin q1 + P5 g sin(q1 + q2), with J2 in M.

    q and qd have shape (..., 2), theta (D,) or (..., D); they broadcast.
    """
    values = np.asarray(theta, dtype=float)
    J2 = values[..., 9] if values.shape[-1] >= 10 else 0.0
    rotor = J2 * np.asarray(qd, dtype=float)[..., 1] ** 2 / 2
    return np.asarray((energy_terms(q, qd) * values[..., :5]).sum(axis=-1) + rotor)


def energy_terms(q: ArrayLike, qd: ArrayLike) -> Array:
    """Return the factors of P1 .. P5 in the energy, shape (..., 5); q and qd have shape (..., 2)."""
    q1, q2 = _split(q)
    v1, v2 = _split(qd)
    v12 = v1 + v2
    kinetic = v1**2 / 2, v12**2 / 2, v1 * v12 * np.cos(q2)
    return np.stack(np.broadcast_arrays(*kinetic, GRAVITY * np.sin(q1), GRAVITY * np.sin(q1 + q2)), axis=-1)


def dry_friction_terms(qd: ArrayLike, tau: ArrayLike) -> Array:
    """Return the factors of Fc, Fs and k in the friction of both joints, shape (..., 2, 3); qd and tau are (..., 2)."""
    v = np.asarray(qd, dtype=float)
    sign = np.tanh(v / SIGN_WIDTH)
    return np.stack([sign, np.exp(-((v / STRIBECK_SPEED) ** 2)) * sign, np.abs(tau) * sign], axis=-1)


def _split(values: ArrayLike) -> tuple[Any, ...]:
    return tuple(np.moveaxis(np.asarray(values, dtype=float), -1, 0))
