# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Parallel simulation of many short motions, with sensitivities, for prediction errors.

The compiled kernel is used if it was built, otherwise numpy; their results agree to about 1e-12. The last axis of every
array holds the simulations, called lanes. The time per lane is shortest with many lanes.
"""

import math
from collections.abc import Sequence
from types import ModuleType
from typing import Any

import numpy as np

from pendubot_identification import kernel as compiled
from pendubot_identification.arrays import Array

from . import MODELS
from .dynamics import acceleration_derivatives, accelerations

#: Number of parameters in the kernel.
SIZE = MODELS['geared']


def roll(theta: Array, state: Array, tau: Array, step: float) -> Array:
    """Simulate L motions in parallel by K classic Runge-Kutta steps of ``step`` [s].

    ``theta`` has shape (D,), or (D, V, 1) for V parameter vectors at once; ``state`` q1, q2, q1', q2' [rad, rad/s] at
    the start, shape (4, L); ``tau`` the torques [N m] of every step, shape (2, K, L).

    Returns:
        States, shape (K + 1, 4, L) or (K + 1, 4, V, L). A simulation that diverges gives NaN or infinity,
        without a warning.
    """
    lanes, steps = np.broadcast_shapes(theta.shape[1:], state.shape[1:]), tau.shape[1]
    states = np.empty((steps + 1, 4, *lanes))
    if theta.ndim == 1:
        theta = theta[:, None]
    else:
        state, tau = state[:, None], tau[:, :, None]
    if (kernel := compiled.library()) is not None:
        count = math.prod(lanes)
        wide = [np.broadcast_to(_padded(theta), (SIZE, *lanes)), np.broadcast_to(state, (4, *lanes))]
        wide.append(np.broadcast_to(tau, (2, steps, *lanes)))
        arrays = [*(np.ascontiguousarray(each, dtype=float) for each in wide), states]
        pointers = (each.ctypes.data for each in arrays)
        blocks = -(-count // compiled.BLOCK)
        compiled.share(kernel.pendubot_roll, blocks, 150.0 * steps, count, steps, step, *pointers)
        return states
    states[0] = state
    with np.errstate(all='ignore'):
        x: tuple[Any, ...] = tuple(states[0])
        for k in range(steps):
            x = advance(tuple(theta), x, tau[:, k], step, np)
            states[k + 1] = x
    return states


def _padded(theta: Array) -> Array:
    """Return the parameters of the largest model, shape (14, ...)."""
    return np.concatenate([theta, np.zeros((SIZE - len(theta), *theta.shape[1:]))])


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
    if (kernel := compiled.library()) is not None:
        result = np.empty((steps // every + 1, 4, 4 + SIZE, lanes))
        arrays = [*(np.ascontiguousarray(each, dtype=float) for each in (_padded(theta), states, tau)), result]
        pointers = (each.ctypes.data for each in arrays)
        blocks = -(-lanes // compiled.BLOCK)
        compiled.share(kernel.pendubot_sensitivities, blocks, 500.0 * steps, lanes, steps, every, step, *pointers)
        return result[:, :, : 4 + len(theta)]
    result = np.zeros((steps + 1, 4, 4 + len(theta), lanes))
    result[0, range(4), range(4)] = 1.0
    with np.errstate(all='ignore'):
        for k in range(steps):
            result[k + 1] = _step_sensitivity(theta, states[k], result[k], tau[:, k], step)
    return result[::every]


def _step_sensitivity(theta: Array, x: Array, dx: Array, tau: Array, h: float) -> Array:
    """Return the derivatives of the state after a step from x, whose derivatives are dx, shape (4, 4 + D, L)."""

    def accelerated(q: Array, v: Array, dq: Array, dv: Array) -> tuple[Array, Array]:
        a, by = acceleration_derivatives(theta, q, v, tau)
        da = by[:, 0, None] * dq[0] + by[:, 1, None] * dq[1] + by[:, 2, None] * dv[0] + by[:, 3, None] * dv[1]
        da[:, 4:] += by[:, 4:]
        return a, da

    q, v, dq, dv, half = x[:2], x[2:], dx[:2], dx[2:], h / 2
    a1, d1 = accelerated(q, v, dq, dv)
    v2, dv2 = v + half * a1, dv + half * d1
    a2, d2 = accelerated(q + half * v, v2, dq + half * dv, dv2)
    v3, dv3 = v + half * a2, dv + half * d2
    a3, d3 = accelerated(q + half * v2, v3, dq + half * dv2, dv3)
    _, d4 = accelerated(q + h * v3, v + h * a3, dq + h * dv3, dv + h * d3)
    inner = d2 + d3
    return np.concatenate([dq + h * dv + h * h / 6 * (d1 + inner), dv + h / 6 * (d1 + 2 * inner + d4)])
