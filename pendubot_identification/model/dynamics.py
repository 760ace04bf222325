"""Rigid-body dynamics of two links in a vertical plane: the paper's equations (1), (2) and (4), and friction.

    M(q) q'' + V(q, q') q' + G(q) = tau - friction(q', tau)

q1 is measured from the horizontal, q2 relative to link 1; on a pendubot tau2 = 0. ``theta`` is the vector P1 P2 P3
P4 P5 b1 b2, and after these, as far as the model goes, Fc1 Fc2 J2 Fs1 Fs2 k1 k2. Every function takes q, qd, tau of
shape (..., 2) and theta of shape (D,) or (..., D) to broadcast, D = 7, 9, 10 or 14 (:data:`.parameters.MODELS`).
"""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

#: Standard gravity as the paper's model needs it [m/s^2].
GRAVITY = 9.81
#: Where the smooth sign tanh(v / width) of dry friction has turned [rad/s].
SIGN_WIDTH = 0.05
#: Where the Stribeck part of dry friction has fallen to 1/e [rad/s].
STRIBECK_SPEED = 0.5


def mass_matrix(theta: ArrayLike, q: ArrayLike) -> Array:
    """Return M(q) [kg m^2], shape (..., 2, 2)."""
    parts = _split(theta)
    P1, P2, P3 = parts[:3]
    c2 = np.cos(np.asarray(q, dtype=float)[..., 1])
    m12 = P2 + P3 * c2
    return _matrix(P1 + P2 + 2 * P3 * c2, m12, m12, P2 + _rotor(parts) + 0 * c2)


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


def friction(theta: ArrayLike, qd: ArrayLike, tau: ArrayLike) -> Array:
    """Return the friction torques [N m], shape (..., 2), of the sign of the velocities, which they brake.

    Of each joint: b v + (Fc + Fs exp(-(v / 0.5)^2) + k |tau|) tanh(v / 0.05).
    """
    return np.stack(_friction(_split(theta), *_split(qd), *_split(tau)), axis=-1)


def energy(theta: ArrayLike, q: ArrayLike, qd: ArrayLike) -> Array:
    """Return the total energy [J], shape (...): 1/2 q'^T M q' + P4 g sin q1 + P5 g sin(q1 + q2), the rotor's in M."""
    values = np.asarray(theta, dtype=float)
    rotor = _rotor(_split(values)) * np.asarray(qd, dtype=float)[..., 1] ** 2 / 2
    return np.asarray((energy_terms(q, qd) * values[..., :5]).sum(axis=-1) + rotor)


def energy_terms(q: ArrayLike, qd: ArrayLike) -> Array:
    """Return what multiplies P1 .. P5 in the energy, shape (..., 5): the energy is linear in them."""
    q1, q2 = _split(q)
    v1, v2 = _split(qd)
    v12 = v1 + v2
    return np.stack(
        [v1**2 / 2, v12**2 / 2, v1 * v12 * np.cos(q2), GRAVITY * np.sin(q1), GRAVITY * np.sin(q1 + q2)],
        axis=-1,
    )


def dry_friction_terms(qd: ArrayLike, tau: ArrayLike) -> Array:
    """Return what multiplies Fc, Fs and k in the friction of each joint, shape (..., 2, 3)."""
    v = np.asarray(qd, dtype=float)
    sign = np.tanh(v / SIGN_WIDTH)
    return np.stack([sign, np.exp(-((v / STRIBECK_SPEED) ** 2)) * sign, np.abs(tau) * sign], axis=-1)


def forward_dynamics(theta: ArrayLike, q: ArrayLike, qd: ArrayLike, tau: ArrayLike) -> Array:
    """Return the accelerations q'' [rad/s^2], shape (..., 2)."""
    return np.stack(accelerations(_split(theta), *_split(q), *_split(qd), *_split(tau)), axis=-1)


def inverse_dynamics(theta: ArrayLike, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> Array:
    """Return the torques [N m] that cause the accelerations qdd, shape (..., 2); finite where k1 and k2 are below 1."""
    values, qd = np.asarray(theta, dtype=float), np.asarray(qd, dtype=float)
    torque = mass_matrix(theta, q) @ np.asarray(qdd, dtype=float)[..., None]
    torque = torque + coriolis_matrix(theta, q, qd) @ qd[..., None]
    torque = torque[..., 0] + gravity(theta, q) + friction(theta, qd, np.zeros_like(qd))
    # Friction that grows with the torque takes its part: tau - k |tau| tanh = torque, where tau has torque's sign.
    load = values[..., 12:14] * np.tanh(qd / SIGN_WIDTH) if values.shape[-1] >= 14 else 0.0
    return np.asarray(torque / (1 - load * np.sign(torque)))


def accelerations(
    theta: Sequence[Any], q1: Any, q2: Any, v1: Any, v2: Any, tau1: Any, tau2: Any, lib: ModuleType = np
) -> tuple[Any, Any]:
    """Return q1'', q2'': the equations of motion solved by hand, on arrays or, with ``lib=math``, on floats.

    The one place where they are solved; floats make a real-time step ten times cheaper than arrays of length two.
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


def _friction(theta: Sequence[Any], v1: Any, v2: Any, tau1: Any, tau2: Any, lib: ModuleType = np) -> tuple[Any, Any]:
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


def _rotor(theta: Sequence[Any]) -> Any:
    return theta[9] if len(theta) >= 10 else 0.0


def _split(values: ArrayLike) -> tuple[Any, ...]:
    return tuple(np.moveaxis(np.asarray(values, dtype=float), -1, 0))


def _matrix(m11: Any, m12: Any, m21: Any, m22: Any) -> Array:
    m11, m12, m21, m22 = np.broadcast_arrays(m11, m12, m21, m22)
    return np.stack([np.stack([m11, m12], axis=-1), np.stack([m21, m22], axis=-1)], axis=-2)
