# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Parallel simulation of many short motions, with sensitivities, for prediction errors.

The compiled kernel is used if it was built, otherwise numpy; their results agree to about 1e-12. The last axis of every
array holds the simulations, called lanes. The time per lane is shortest with many lanes.
"""

from collections.abc import Sequence
from types import ModuleType
from typing import Any

import numpy as np

from pendubot_identification import kernel as compiled
from pendubot_identification.arrays import Array

from .dynamics import acceleration_derivatives, accelerations

#: Lanes times steps that numpy linearises together, so that the arrays fit into the cache of the processor.
CHUNK = 2048


def roll(theta: Array, state: Array, tau: Array, step: float) -> Array:
    """Simulate L motions in parallel by K classic Runge-Kutta steps of ``step`` [s].

    ``theta`` has shape (D,), or (D, V, 1) for V parameter vectors at once; ``state`` q1, q2, q1', q2' [rad, rad/s] at
    the start, shape (4, L); ``tau`` the torques [N m] of every step, shape (2, K, L).

    Returns:
        States, shape (K + 1, 4, L) or (K + 1, 4, V, L). A simulation that diverges gives NaN or infinity,
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
    with np.errstate(all='ignore'):
        x: tuple[Any, ...] = tuple(states[0])
        for k in range(tau.shape[1]):
            x = advance(tuple(theta), x, tau[:, k], step, np)
            states[k + 1] = x
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


def sensitivities(theta: Array, states: Array, tau: Array, step: float, every: int = 1) -> Array:
    """Return the derivatives of motions by initial states and theta; ``states`` is the result of :func:`roll`.

    Returns:
        Derivatives of the state at the start and after each ``every`` steps, by the initial state and theta,
        shape (K // every + 1, 4, 4 + D, L).
    """
    _, steps, lanes = tau.shape
    size = 4 + len(theta)
    if (kernel := compiled.library()) is not None:
        result = np.empty((steps // every + 1, 4, size, lanes))
        arrays = [np.ascontiguousarray(a, dtype=float) for a in (theta, states, tau)]
        pointers = [a.ctypes.data for a in (*arrays, result)]
        kernel.pendubot_sensitivities(compiled.threads, len(theta), lanes, steps, every, step, *pointers)
        return result
    result = np.zeros((steps + 1, 4, size, lanes))
    result[0, range(4), range(4)] = 1.0
    together = max(1, CHUNK // max(lanes, 1))
    with np.errstate(all='ignore'):
        # First the derivative of every single step by the state before it and theta, for many steps at once ...
        for start in range(0, steps, together):
            part = slice(start, min(start + together, steps))
            x, torques = np.moveaxis(states[part], 1, 0).reshape(4, -1), tau[:, part].reshape(2, -1)
            single = _step_sensitivity(theta, x, torques, step)
            result[1:][part] = np.moveaxis(single.reshape(4, size, -1, lanes), 2, 0)
        # ... then the chain rule, from step to step.
        by_state = result[:, :, :4].copy()
        result[2:, :, :4] = 0.0
        for k in range(2, steps + 1):
            result[k] += np.matmul(by_state[k], result[k - 1], axes=[(0, 1), (0, 1), (0, 1)])
    return result[::every]


def _step_sensitivity(theta: Array, x: Array, tau: Array, h: float) -> Array:
    """Return the derivative of the state after one step by the state before it and theta, shape (4, 4 + D, L)."""

    def accelerated(q: Array, v: Array, dq: Array, dv: Array) -> tuple[Array, Array]:
        a, by = acceleration_derivatives(theta, q, v, tau)
        da = by[:, 0, None] * dq[0]
        da += by[:, 1, None] * dq[1]
        da += by[:, 2, None] * dv[0]
        da += by[:, 3, None] * dv[1]
        da[:, 4:] += by[:, 4:]
        return a, da

    q, v, half = x[:2], x[2:], h / 2
    dq, dv = np.split(np.eye(4, 4 + len(theta))[:, :, None], 2)
    a1, d1 = acceleration_derivatives(theta, q, v, tau)
    v2, dv2 = v + half * a1, dv + half * d1
    a2, d2 = accelerated(q + half * v, v2, dq + half * dv, dv2)
    v3, dv3 = v + half * a2, dv + half * d2
    a3, d3 = accelerated(q + half * v2, v3, dq + half * dv2, dv3)
    _, d4 = accelerated(q + h * v3, v + h * a3, dq + h * dv3, dv + h * d3)
    inner = d2 + d3
    return np.concatenate([dq + h * dv + h * h / 6 * (d1 + inner), dv + h / 6 * (d1 + 2 * inner + d4)])
