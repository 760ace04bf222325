# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Parallel simulation of many short motions, with sensitivities, for prediction errors.

The compiled kernel is used if it was built, otherwise numpy; their results agree to about 1e-12. The last axis of every
array holds the simulations, called lanes. The time per lane is shortest with many lanes.
"""

import math
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from pendubot_identification import kernel as compiled
from pendubot_identification.arrays import Array

from . import MODELS
from .dynamics import accelerations, linearised, padded, product, regressor, runge_kutta, stages

#: Number of parameters in the kernel.
SIZE = MODELS['geared']


def roll(theta: Array, state: Array, tau: Array, step: float, change: Array | None = None) -> Array:
    """Simulate L motions in parallel by K classic Runge-Kutta steps of ``step`` [s].

    ``theta`` has shape (D,), or (D, V, 1) for V parameter vectors at once; ``state`` q1, q2, q1', q2' [rad, rad/s] at
    the start, shape (4, L); ``tau`` the mean torques [N m] of every step, shape (2, K, L), and ``change`` half of their
    change within each step, likewise; None: they are constant.

    Returns:
        States, shape (K + 1, 4, L) or (K + 1, 4, V, L). A simulation that diverges gives NaN or infinity,
        without a warning.
    """
    lanes, steps = np.broadcast_shapes(theta.shape[1:], state.shape[1:]), tau.shape[1]
    states, change = np.empty((steps + 1, 4, *lanes)), np.zeros_like(tau) if change is None else change
    if theta.ndim == 1:
        theta = theta[:, None]
    else:
        state, tau, change = state[:, None], tau[:, :, None], change[:, :, None]
    if (kernel := compiled.library()) is not None:
        count = math.prod(lanes)
        wide = [np.broadcast_to(padded(theta), (SIZE, *lanes)), np.broadcast_to(state, (4, *lanes))]
        wide += [np.broadcast_to(each, (2, steps, *lanes)) for each in (tau, change)]
        arrays = [*(np.ascontiguousarray(each, dtype=float) for each in wide), states]
        pointers = (each.ctypes.data for each in arrays)
        blocks = -(-count // compiled.BLOCK)
        compiled.share(kernel.pendubot_roll, blocks, 150.0 * steps, count, steps, step, *pointers)
        return states
    states[0] = state
    with np.errstate(all='ignore'):
        for k in range(steps):
            torque = stages(tau[:, k], change[:, k])
            states[k + 1] = runge_kutta(partial(_accelerated, theta, torque), states[k], step)
    return states


def _accelerated(theta: Array, torque: Iterator[Array], x: Any) -> Any:
    return accelerations(theta, x, next(torque))


def sensitivities(
    theta: Array, states: Array, tau: Array, step: float, every: int = 1, change: Array | None = None
) -> Array:
    """Return the derivatives of motions by initial states and theta; ``states`` is the result of :func:`roll`.

    Returns:
        Derivatives of the state at the start and after each ``every`` steps, by the initial state and theta,
        shape (K // every + 1, 4, 4 + D, L).
    """
    (_, steps, lanes), change = tau.shape, np.zeros_like(tau) if change is None else change
    if (kernel := compiled.library()) is not None:
        result = np.empty((steps // every + 1, 4, 4 + SIZE, lanes))
        arrays = [*(np.ascontiguousarray(each, dtype=float) for each in (padded(theta), states, tau, change)), result]
        pointers = (each.ctypes.data for each in arrays)
        blocks = -(-lanes // compiled.BLOCK)
        compiled.share(kernel.pendubot_sensitivities, blocks, 500.0 * steps, lanes, steps, every, step, *pointers)
        return result[:, :, : 4 + len(theta)]
    result, parameters = np.zeros((steps + 1, 4, 4 + SIZE, lanes)), padded(theta)
    result[0, range(4), range(4)] = 1.0

    def accelerated(torque: Iterator[Array], extended: Any) -> Array:
        """Return the accelerations and their derivatives, shape (2, 1 + 18, L), of states and their derivatives."""
        tau, (x, dx) = next(torque), np.split(np.array(extended), [1], axis=1)
        point = linearised(parameters, x[:, 0], tau)
        torques = product(point.slopes, dx)
        torques[:, 4:] -= regressor(point.a, x[:, 0], tau)
        return np.concatenate([point.a[:, None], product(point.inverse, torques)], axis=1)

    with np.errstate(all='ignore'):
        for k in range(steps):
            extended = np.concatenate([states[k, :, None], result[k]], axis=1)
            torque = stages(tau[:, k], change[:, k])
            result[k + 1] = np.array(runge_kutta(partial(accelerated, torque), extended, step))[:, 1:]
    return result[::every, :, : 4 + len(theta)]
