# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The peer of the tracker: an extended Kalman filter with theta as states, for all rigs at once.

It starts from a fit of the first 10 s, with the tracker's random walks.
"""

import numpy as np

from pendubot_identification.model.dynamics import accelerations
from test.simulated_rig import runge_kutta

#: Sampling rate [Hz], and counts per turn of the encoders.
RATE, COUNTS = 200, 4096


def kalman(t, q, tau, theta, walk):
    """Track K rigs by an extended Kalman filter of q, q' and theta; return times, theta and deviations, (M, K, 9).

    ``theta``: initial values, shape (K, 9); ``walk``: random walk as the tracker's, relative to theta, in a second,
    shape (9,). Differences give the Jacobian.
    """
    size, h, scale = len(q), 1 / RATE, np.abs(theta)
    x = np.concatenate([q[:, 0], np.zeros((size, 2)), np.ones((size, 9))], axis=1)
    noise = (2 * np.pi / COUNTS) ** 2 / 12
    P = np.zeros((size, 13, 13))
    P[:] = np.diag([noise, noise, 0.01, 0.01, *[0.02**2] * 5, *[0.3**2] * 4])
    Q = np.diag([1e-12, 1e-12, 1e-6, 1e-6, *(walk**2 * h)])
    H = np.eye(13)[:2]
    step = np.array([1e-6] * 4 + [1e-5] * 9)
    times, found, deviations = [], [], []
    for n in range(1, len(t)):
        moved = np.repeat(x[:, None], 14, axis=1)
        moved[:, 1:] += np.diag(step)
        after = _advance(moved, tau[:, n - 1, None], scale[:, None], h)
        x = after[:, 0]
        F = np.moveaxis((after[:, 1:] - after[:, :1]) / step[:, None], 1, 2)
        P = F @ P @ np.moveaxis(F, 1, 2) + Q
        S = P[:, :2, :2] + noise * np.eye(2)
        gain = P[:, :, :2] @ np.linalg.inv(S)
        x = x + (gain @ (q[:, n] - x[:, :2])[:, :, None])[:, :, 0]
        left = np.eye(13) - gain @ H
        P = left @ P @ np.moveaxis(left, 1, 2) + noise * gain @ np.moveaxis(gain, 1, 2)
        if n % RATE == 0:
            times.append(t[n])
            found.append(x[:, 4:] * scale)
            deviations.append(np.sqrt(np.diagonal(P, axis1=1, axis2=2))[:, 4:] * scale)
    return np.array(times), np.array(found), np.array(deviations)


def _advance(x, tau, scale, h):
    theta = np.moveaxis(x[..., 4:] * scale, -1, 0)

    def slope(state):
        q1, q2, v1, v2 = np.moveaxis(state, -1, 0)
        return np.stack([v1, v2, *accelerations(theta, (q1, q2, v1, v2), (tau, 0.0))], axis=-1)

    return np.concatenate([runge_kutta(slope, x[..., :4], h), x[..., 4:]], axis=-1)
