# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Rigid-body dynamics of two links in a vertical plane: the paper's equations (1), (2) and (4), and friction.

    M(q) q'' + V(q, q') q' + G(q) = tau - friction(q', tau)

q1 is measured from the horizontal, q2 relative to link 1; on a pendubot tau2 = 0. ``theta`` is the vector P1 P2 P3
P4 P5 b1 b2, continued by Fc1 Fc2 J2 Fs1 Fs2 k1 k2: D = 7, 9, 10 or 14 parameters, by the model
(:data:`.parameters.MODELS`). motion.h and rollout.c implement the same equations in C.
"""

from collections.abc import Sequence
from types import ModuleType
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from pendubot_identification.arrays import Array

#: One value for each joint: shoulder, elbow.
Pair = tuple[float, float]
#: A float, an array, or an expression.
Term = TypeVar('Term', bound=Any)

#: Standard gravity [m/s^2]. The printed G of the paper lacks this factor, which P4 and P5 as defined require.
GRAVITY = 9.81
#: The sign of a velocity v in dry friction is tanh(v / SIGN_WIDTH) [rad/s].
SIGN_WIDTH = 0.05
#: The Stribeck part of dry friction is exp(-(v / STRIBECK_SPEED)^2) times its value at rest [rad/s].
STRIBECK_SPEED = 0.5


def accelerations(
    theta: Sequence[Term | float] | Array,
    q1: Term,
    q2: Term,
    v1: Term,
    v2: Term,
    tau1: Term | float,
    tau2: Term | float,
    lib: ModuleType = np,
) -> tuple[Term, Term]:
    """Return q1'', q2'' [rad/s^2]: the equations of motion, with the inverse of M(q) written out.

    ``theta`` is a sequence of D numbers, arrays or expressions; arrays broadcast. ``lib`` has their functions: numpy,
    math for floats, which takes a tenth of the time of arrays of length one, casadi, or jax.numpy.
    """
    P1, P2, P3, P4, P5 = theta[:5]
    c2, s2 = lib.cos(q2), lib.sin(q2)
    m11, m12, m22 = P1 + P2 + 2 * P3 * c2, P2 + P3 * c2, P2 + _rotor(theta)
    f1, f2 = _friction(theta, v1, v2, tau1, tau2, lib)
    g2 = P5 * GRAVITY * lib.cos(q1 + q2)
    h1 = tau1 - f1 + P3 * s2 * (2 * v1 * v2 + v2 * v2) - P4 * GRAVITY * lib.cos(q1) - g2
    h2 = tau2 - f2 - P3 * s2 * v1 * v1 - g2
    determinant = m11 * m22 - m12 * m12
    return (m22 * h1 - m12 * h2) / determinant, (m11 * h2 - m12 * h1) / determinant


def _friction(theta: Sequence[Any] | Array, v1: Any, v2: Any, tau1: Any, tau2: Any, lib: ModuleType) -> tuple[Any, Any]:
    """Return the friction of each joint [N m]: b v + (Fc + Fs exp(-(v / 0.5)^2) + k |tau|) tanh(v / 0.05)."""
    size = len(theta)
    f1, f2 = theta[5] * v1, theta[6] * v2
    if size < 9:
        return f1, f2
    dry1, dry2 = theta[7], theta[8]
    if size >= 14:
        Fs1, Fs2, k1, k2 = theta[10:]
        dry1 = dry1 + Fs1 * lib.exp(-((v1 / STRIBECK_SPEED) ** 2)) + k1 * lib.fabs(tau1)
        dry2 = dry2 + Fs2 * lib.exp(-((v2 / STRIBECK_SPEED) ** 2)) + k2 * lib.fabs(tau2)
    return f1 + dry1 * lib.tanh(v1 / SIGN_WIDTH), f2 + dry2 * lib.tanh(v2 / SIGN_WIDTH)


def _rotor(theta: Sequence[Any] | Array) -> Any:
    return theta[9] if len(theta) >= 10 else 0.0


def acceleration_derivatives(theta: Array, q: Array, v: Array, tau: Array) -> tuple[Array, Array]:
    """Return q'', shape (2, L), and its derivatives by q1, q2, q1', q2' and each parameter, shape (2, 4 + D, L).

    ``theta`` has shape (D,); positions [rad], velocities [rad/s] and torques [N m] of L points have shape (2, L).
    """
    P1, P2, P3, P4, P5 = theta[:5]
    a1, a2 = accelerations(theta, *q, *v, *tau)
    v1, v2 = v
    c2, s2 = np.cos(q[1]), np.sin(q[1])
    slope = np.broadcast_to(theta[5:7, None], v.shape)
    # M a = h gives M da = dh - dM a: the right-hand side, by each state and each parameter.
    right = np.zeros((2, 4 + len(theta), v.shape[1]))
    one, two = right[:, 4:]
    one[0] = -a1
    one[1] = two[1] = -(a1 + a2)
    one[2] = s2 * v2 * (2 * v1 + v2) - c2 * (2 * a1 + a2)
    two[2] = -s2 * v1 * v1 - c2 * a1
    one[3] = -GRAVITY * np.cos(q[0])
    one[4] = two[4] = -GRAVITY * np.cos(q[0] + q[1])
    one[5], two[6] = -v
    if len(theta) >= 9:
        sign = np.tanh(v / SIGN_WIDTH)
        dry = theta[7:9, None]
        one[7], two[8] = -sign
        if len(theta) >= 10:
            two[9] = -a2
        if len(theta) >= 14:
            stribeck = np.exp(-((v / STRIBECK_SPEED) ** 2))
            dry = dry + theta[10:12, None] * stribeck + theta[12:14, None] * np.abs(tau)
            slope = slope - theta[10:12, None] * stribeck * sign * v * (2 / STRIBECK_SPEED**2)
            one[10], two[11] = -stribeck * sign
            one[12], two[13] = -np.abs(tau) * sign
        slope = slope + dry * (1 - sign * sign) / SIGN_WIDTH
    g12 = P5 * GRAVITY * np.sin(q[0] + q[1])
    one, two = right
    one[0] = P4 * GRAVITY * np.sin(q[0]) + g12
    one[1] = P3 * (c2 * v2 * (2 * v1 + v2) + s2 * (2 * a1 + a2)) + g12
    one[2] = 2 * P3 * s2 * v2 - slope[0]
    one[3] = 2 * P3 * s2 * (v1 + v2)
    two[0] = g12
    two[1] = P3 * (s2 * a1 - c2 * v1 * v1) + g12
    two[2] = -2 * P3 * s2 * v1
    two[3] = -slope[1]
    m11, m12, m22 = P1 + P2 + 2 * P3 * c2, P2 + P3 * c2, P2 + _rotor(theta)
    inverse = 1 / (m11 * m22 - m12 * m12)
    i11, i12, i22 = m22 * inverse, -m12 * inverse, m11 * inverse
    result = np.stack([i11, i22])[:, None] * right
    result += i12 * right[::-1]
    return np.stack([a1, a2]), result


def forward_dynamics(theta: ArrayLike, q: ArrayLike, qd: ArrayLike, tau: ArrayLike) -> Array:
    """Return the accelerations q'' [rad/s^2], shape (..., 2).

    q, qd and tau have shape (..., 2), theta (D,) or (..., D); they broadcast.
    """
    return np.stack(accelerations(_split(theta), *_split(q), *_split(qd), *_split(tau)), axis=-1)


def mass_matrix(theta: ArrayLike, q: ArrayLike) -> Array:
    """Return M(q) [kg m^2], shape (..., 2, 2).

    Positions q [rad] have shape (..., 2), theta (D,) or (..., D); they broadcast.
    """
    values = _split(theta)
    P1, P2, P3 = values[:3]
    c2 = np.cos(np.asarray(q, dtype=float)[..., 1])
    entries = np.broadcast_arrays(P1 + P2 + 2 * P3 * c2, P2 + P3 * c2, P2 + P3 * c2, P2 + _rotor(values))
    return np.stack(entries, axis=-1).reshape(*entries[0].shape, 2, 2)


def energy(theta: ArrayLike, q: ArrayLike, qd: ArrayLike) -> Array:
    """Return the total energy [J], shape (...): 1/2 q'^T M q' + P4 g sin q1 + P5 g sin(q1 + q2), with J2 in M.

    q and qd have shape (..., 2), theta (D,) or (..., D); they broadcast.
    """
    values = np.asarray(theta, dtype=float)
    rotor = _rotor(_split(values)) * np.asarray(qd, dtype=float)[..., 1] ** 2 / 2
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
