"""Rigid-body dynamics of two links in a vertical plane: the paper's equations (1), (2) and (4).

    M(q) q'' + V(q, q') q' + G(q) = [tau1 - b1 q1', tau2 - b2 q2']

q1 is measured from the horizontal, q2 relative to link 1; on a pendubot tau2 = 0. ``theta`` is the vector P1 P2 P3
P4 P5 b1 b2. Every function takes q, qd, tau of shape (..., 2) and theta of shape (7,) or (..., 7) to broadcast.
"""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

#: Standard gravity as the paper's model needs it [m/s^2].
GRAVITY = 9.81


def mass_matrix(theta: ArrayLike, q: ArrayLike) -> Array:
    """Return M(q) [kg m^2], shape (..., 2, 2)."""
    P1, P2, P3, *_ = _split(theta)
    c2 = np.cos(np.asarray(q, dtype=float)[..., 1])
    m12 = P2 + P3 * c2
    return _matrix(P1 + P2 + 2 * P3 * c2, m12, m12, P2 + 0 * c2)


def coriolis_matrix(theta: ArrayLike, q: ArrayLike, qd: ArrayLike) -> Array:
    """Return V(q, q') [N m s/rad], shape (..., 2, 2); M' - 2 V is skew-symmetric."""
    _, _, P3, *_ = _split(theta)
    v1, v2 = _split(qd)
    h = P3 * np.sin(np.asarray(q, dtype=float)[..., 1])
    return _matrix(-h * v2, -h * (v1 + v2), h * v1, 0 * h * v1)


def gravity(theta: ArrayLike, q: ArrayLike) -> Array:
    """Return G(q) [N m], shape (..., 2). The printed G lacks the factor g that P4 and P5 as defined need."""
    _, _, _, P4, P5, *_ = _split(theta)
    q1, q2 = _split(q)
    g2 = P5 * GRAVITY * np.cos(q1 + q2)
    return np.stack([P4 * GRAVITY * np.cos(q1) + g2, g2], axis=-1)


def energy(theta: ArrayLike, q: ArrayLike, qd: ArrayLike) -> Array:
    """Return the total energy [J], shape (...): 1/2 q'^T M q' + P4 g sin q1 + P5 g sin(q1 + q2)."""
    return np.asarray((energy_terms(q, qd) * np.asarray(theta, dtype=float)[..., :5]).sum(axis=-1))


def energy_terms(q: ArrayLike, qd: ArrayLike) -> Array:
    """Return what multiplies P1 .. P5 in the energy, shape (..., 5): the energy is linear in them."""
    q1, q2 = _split(q)
    v1, v2 = _split(qd)
    v12 = v1 + v2
    return np.stack(
        [v1**2 / 2, v12**2 / 2, v1 * v12 * np.cos(q2), GRAVITY * np.sin(q1), GRAVITY * np.sin(q1 + q2)],
        axis=-1,
    )


def forward_dynamics(theta: ArrayLike, q: ArrayLike, qd: ArrayLike, tau: ArrayLike) -> Array:
    """Return the accelerations q'' [rad/s^2], shape (..., 2)."""
    return np.stack(accelerations(_split(theta), *_split(q), *_split(qd), *_split(tau)), axis=-1)


def inverse_dynamics(theta: ArrayLike, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> Array:
    """Return the torques [N m] that cause the accelerations qdd, shape (..., 2)."""
    damping = np.asarray(theta, dtype=float)[..., 5:7]
    qd = np.asarray(qd, dtype=float)
    torque = mass_matrix(theta, q) @ np.asarray(qdd, dtype=float)[..., None]
    torque = torque + coriolis_matrix(theta, q, qd) @ qd[..., None]
    return np.asarray(torque[..., 0] + gravity(theta, q) + damping * qd)


def accelerations(
    theta: Any, q1: Any, q2: Any, v1: Any, v2: Any, tau1: Any, tau2: Any, lib: ModuleType = np
) -> tuple[Any, Any]:
    """Return q1'', q2'': the equations of motion solved by hand, on arrays or, with ``lib=math``, on floats.

    The one place where they are solved; floats make a real-time step ten times cheaper than arrays of length two.
    """
    P1, P2, P3, P4, P5, b1, b2 = theta
    c2, s2 = lib.cos(q2), lib.sin(q2)
    m11, m12 = P1 + P2 + 2 * P3 * c2, P2 + P3 * c2
    g2 = P5 * GRAVITY * lib.cos(q1 + q2)
    f1 = tau1 - b1 * v1 + P3 * s2 * (2 * v1 * v2 + v2 * v2) - P4 * GRAVITY * lib.cos(q1) - g2
    f2 = tau2 - b2 * v2 - P3 * s2 * v1 * v1 - g2
    determinant = m11 * P2 - m12 * m12
    return (P2 * f1 - m12 * f2) / determinant, (m11 * f2 - m12 * f1) / determinant


def _split(values: ArrayLike) -> tuple[Any, ...]:
    return tuple(np.moveaxis(np.asarray(values, dtype=float), -1, 0))


def _matrix(m11: Any, m12: Any, m21: Any, m22: Any) -> Array:
    m11, m12, m21, m22 = np.broadcast_arrays(m11, m12, m21, m22)
    return np.stack([np.stack([m11, m12], axis=-1), np.stack([m21, m22], axis=-1)], axis=-2)
