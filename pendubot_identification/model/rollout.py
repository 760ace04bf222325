"""Many short simulations at once, with their sensitivities: the inner loop of the trajectory criterion.

All that is hot lies behind :func:`roll` and :func:`sensitivities`, which the compiled kernel does where it is there,
and numpy where it is not, to about 1e-12 of the same numbers. Lanes (segments, or parameter vectors times segments) are
the last axis: both are fastest over a long last axis.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.model import kernel as compiled

from .dynamics import GRAVITY, SIGN_WIDTH, STRIBECK_SPEED, accelerations

Array = NDArray[np.float64]

#: With fewer lanes than this, floats one after the other are faster than arrays.
FEW = 20
#: Lanes times steps that are linearised together: enough for numpy, and what lies between two operations stays in a
#: processor's cache.
CHUNK = 1024


def roll(theta: Array, state: Array, tau: Array, step: float) -> Array:
    """Simulate motions side by side by classic Runge-Kutta steps.

    Args:
        theta: shape (D,), or (D, V, 1) for V parameter vectors at once.
        state: q1, q2, q1', q2' [rad, rad/s] at the start, shape (4, L).
        tau: torques [N m] of every step, shape (2, K, L).
        step: the steps' length [s].

    Returns:
        States, shape (K + 1, 4, L) or (K + 1, 4, V, L). A motion that cannot be followed becomes NaN or infinite,
        without a warning.
    """
    lanes = np.broadcast_shapes(theta.shape[1:], state.shape[1:])
    states = np.empty((tau.shape[1] + 1, 4, *lanes))
    if (kernel := compiled.library()) is not None:
        vectors = 1 if theta.ndim == 1 else theta.shape[1]
        arrays = [np.ascontiguousarray(a, dtype=float) for a in (theta, state, tau)]
        pointers = [a.ctypes.data for a in (*arrays, states)]
        kernel.pendubot_roll(compiled.threads, len(theta), vectors, state.shape[1], tau.shape[1], step, *pointers)
        return states
    states[0] = state if theta.ndim == 1 else state[:, None]
    if theta.ndim == 1 and lanes[0] < FEW:
        values = tuple(map(float, theta))
        for lane in range(lanes[0]):
            states[1:, :, lane] = _one_by_one(values, state[:, lane], tau[:, :, lane], step)
        return states
    with np.errstate(all='ignore'):
        x: tuple[Any, ...] = tuple(states[0])
        for k in range(tau.shape[1]):
            x = advance(tuple(theta), x, tau[:, k], step, np)
            states[k + 1] = x
    return states


def _one_by_one(theta: tuple[float, ...], state: Array, tau: Array, step: float) -> Array:
    states = np.full((tau.shape[1], 4), np.nan)
    x: tuple[Any, ...] = tuple(map(float, state))
    try:
        for k, torques in enumerate(tau.T.tolist()):
            states[k] = x = advance(theta, x, torques, step, math)
    except (OverflowError, ValueError, ZeroDivisionError):
        pass  # floats raise where arrays become infinite; what follows stays NaN
    return states


def advance(theta: Sequence[Any], x: Sequence[Any], tau: Any, h: float, lib: ModuleType) -> tuple[Any, ...]:
    """Return the state q1, q2, q1', q2' one classic Runge-Kutta step of h [s] after the state x, on arrays or floats.

    ``tau``: both torques [N m] during the step. ``lib``: see :func:`.dynamics.accelerations`.
    """
    q1, q2, v1, v2 = x
    t1, t2 = tau
    half, sixth = h / 2, h / 6
    k1, l1 = accelerations(theta, q1, q2, v1, v2, t1, t2, lib)
    u1, u2 = v1 + half * k1, v2 + half * l1
    k2, l2 = accelerations(theta, q1 + half * v1, q2 + half * v2, u1, u2, t1, t2, lib)
    w1, w2 = v1 + half * k2, v2 + half * l2
    k3, l3 = accelerations(theta, q1 + half * u1, q2 + half * u2, w1, w2, t1, t2, lib)
    k4, l4 = accelerations(theta, q1 + h * w1, q2 + h * w2, v1 + h * k3, v2 + h * l3, t1, t2, lib)
    return (
        q1 + h * (v1 + sixth * (k1 + k2 + k3)),
        q2 + h * (v2 + sixth * (l1 + l2 + l3)),
        v1 + sixth * (k1 + 2 * (k2 + k3) + k4),
        v2 + sixth * (l1 + 2 * (l2 + l3) + l4),
    )


def sensitivities(theta: Array, states: Array, tau: Array, step: float) -> Array:
    """Return how a simulated motion depends on its initial state and on the parameters.

    Args:
        theta: shape (D,).
        states: what :func:`roll` returned, shape (K + 1, 4, L).
        tau: shape (2, K, L).
        step: [s].

    Returns:
        Derivative of the state after each step by the initial state and theta, shape (K, 4, 4 + D, L).
    """
    _, steps, lanes = tau.shape
    size = 4 + len(theta)
    result = np.empty((steps, 4, size, lanes))
    if (kernel := compiled.library()) is not None:
        arrays = [np.ascontiguousarray(a, dtype=float) for a in (theta, states, tau)]
        pointers = [a.ctypes.data for a in (*arrays, result)]
        kernel.pendubot_sensitivities(compiled.threads, len(theta), lanes, steps, step, *pointers)
        return result
    together = max(1, CHUNK // max(lanes, 1))
    unchained = np.zeros((4, size, min(together, steps) * lanes))
    unchained[range(4), range(4)] = 1.0
    with np.errstate(all='ignore'):
        # Many steps are linearised at once, each from its own state, and then chained.
        for start in range(0, steps, together):
            part = slice(start, min(start + together, steps))
            x, torques = np.moveaxis(states[part], 1, 0).reshape(4, -1), tau[:, part].reshape(2, -1)
            single = _step_sensitivity(theta, x, torques, step, unchained[:, :, : x.shape[1]])
            result[part] = np.moveaxis(single.reshape(4, size, -1, lanes), 2, 0)
        by_state = result[:, :, :4].copy()
        result[1:, :, :4] = 0.0
        for k in range(1, steps):
            result[k] += np.matmul(by_state[k], result[k - 1], axes=[(0, 1), (0, 1), (0, 1)])
    return result


def _step_sensitivity(theta: Array, x: Array, tau: Array, h: float, before: Array) -> Array:
    """Return the derivative of the state after one step from that of the state before; (4, 4 + D, L)."""
    q, v, dq, dv = x[:2], x[2:], before[:2], before[2:]
    half = h / 2
    half_dv = half * dv
    a1, d1 = _acceleration_sensitivity(theta, q, v, tau, dq, dv)
    v2, dv2 = v + half * a1, dv + half * d1
    a2, d2 = _acceleration_sensitivity(theta, q + half * v, v2, tau, dq + half_dv, dv2)
    v3, dv3 = v + half * a2, dv + half * d2
    a3, d3 = _acceleration_sensitivity(theta, q + half * v2, v3, tau, dq + half * dv2, dv3)
    _, d4 = _acceleration_sensitivity(theta, q + h * v3, v + h * a3, tau, dq + h * dv3, dv + h * d3)
    inner = d2 + d3
    return np.concatenate([dq + h * dv + h * h / 6 * (d1 + inner), dv + h / 6 * (d1 + 2 * inner + d4)])


def _acceleration_sensitivity(
    theta: Array, q: Array, v: Array, tau: Array, dq: Array, dv: Array
) -> tuple[Array, Array]:
    """Return the accelerations, shape (2, L), and their derivative along dq, dv and theta, shape (2, 4 + D, L)."""
    P1, P2, P3, P4, P5 = theta[:5]
    size = len(theta)
    v1, v2 = v
    c2, s2 = np.cos(q[1]), np.sin(q[1])
    m11, m12, m22 = P1 + P2 + 2 * P3 * c2, P2 + P3 * c2, P2 + (theta[9] if size >= 10 else 0.0)
    inverse = 1 / (m11 * m22 - m12 * m12)
    c1, c12 = GRAVITY * np.cos(q[0]), GRAVITY * np.cos(q[0] + q[1])
    s12 = P5 * GRAVITY * np.sin(q[0] + q[1])
    brake, slope = theta[5:7, None] * v, np.broadcast_to(theta[5:7, None], v.shape)
    if size >= 9:
        sign = np.tanh(v / SIGN_WIDTH)
        dry = theta[7:9, None]
        if size >= 14:
            bell = np.exp(-((v / STRIBECK_SPEED) ** 2))
            load = np.abs(tau)
            dry = dry + theta[10:12, None] * bell + theta[12:14, None] * load
            slope = slope - theta[10:12, None] * bell * sign * v * (2 / STRIBECK_SPEED**2)
        brake, slope = brake + dry * sign, slope + dry * (1 - sign * sign) / SIGN_WIDTH
    coriolis = s2 * v2 * (2 * v1 + v2)
    h1 = tau[0] - brake[0] + P3 * coriolis - P4 * c1 - P5 * c12
    h2 = tau[1] - brake[1] - P3 * s2 * v1 * v1 - P5 * c12
    a1, a2 = (m22 * h1 - m12 * h2) * inverse, (m11 * h2 - m12 * h1) * inverse

    # M da = dh - dM a: first along the states ...
    rows = np.empty((2, *dq.shape[1:]))
    one, two = rows
    np.multiply(P4 * GRAVITY * np.sin(q[0]) + s12, dq[0], out=one)
    one += (P3 * (c2 * v2 * (2 * v1 + v2) + s2 * (2 * a1 + a2)) + s12) * dq[1]
    one += (2 * P3 * s2 * v2 - slope[0]) * dv[0]
    one += 2 * P3 * s2 * (v1 + v2) * dv[1]
    np.multiply(s12, dq[0], out=two)
    two += (P3 * (s2 * a1 - c2 * v1 * v1) + s12) * dq[1]
    two -= 2 * P3 * s2 * v1 * dv[0]
    two -= slope[1] * dv[1]
    # ... then along the parameters themselves, each by what it multiplies.
    one, two = rows[0, 4:], rows[1, 4:]
    one[0] -= a1
    one[1] -= a1 + a2
    two[1] -= a1 + a2
    one[2] += coriolis - c2 * (2 * a1 + a2)
    two[2] -= s2 * v1 * v1 + c2 * a1
    one[3] -= c1
    one[4] -= c12
    two[4] -= c12
    one[5] -= v1
    two[6] -= v2
    if size >= 9:
        one[7] -= sign[0]
        two[8] -= sign[1]
    if size >= 10:
        two[9] -= a2
    if size >= 14:
        one[10] -= bell[0] * sign[0]
        two[11] -= bell[1] * sign[1]
        one[12] -= load[0] * sign[0]
        two[13] -= load[1] * sign[1]
    result = np.empty_like(rows)
    cross = m12 * inverse
    np.multiply(m22 * inverse, rows[0], out=result[0])
    result[0] -= cross * rows[1]
    np.multiply(m11 * inverse, rows[1], out=result[1])
    result[1] -= cross * rows[0]
    return np.stack([a1, a2]), result
