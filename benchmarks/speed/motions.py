# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The trajectory criterion's simulations: 900 samples for 30 parameter vectors at once."""

import math

import numpy as np

from benchmarks.speed.measure import interleaved, on, table
from pendubot_identification.model.dynamics import GRAVITY
from pendubot_identification.model.parameters import PAPER
from pendubot_identification.model.rollout import roll

SAMPLES, VECTORS, INTERVAL = 900, 30, 0.01


def numbas():
    """Return the loop over the vectors that one would write with numba, compiled, of the same model and steps."""
    from numba import njit

    @njit
    def accelerations(p, q1, q2, v1, v2, tau):
        c2, s2 = math.cos(q2), math.sin(q2)
        m11, m12, m22 = p[0] + p[1] + 2 * p[2] * c2, p[1] + p[2] * c2, p[1]
        g2 = p[4] * GRAVITY * math.cos(q1 + q2)
        h1 = tau - p[5] * v1 + p[2] * s2 * (2 * v1 * v2 + v2 * v2) - p[3] * GRAVITY * math.cos(q1) - g2
        h2 = -p[6] * v2 - p[2] * s2 * v1 * v1 - g2
        determinant = m11 * m22 - m12 * m12
        return (m22 * h1 - m12 * h2) / determinant, (m11 * h2 - m12 * h1) / determinant

    @njit
    def simulate(theta, start, tau, h):
        states = np.empty((tau.size + 1, 4, theta.shape[1]))
        for vector in range(theta.shape[1]):
            p = theta[:, vector]
            q1, q2, v1, v2 = start
            for k in range(tau.size + 1):
                states[k, 0, vector], states[k, 1, vector] = q1, q2
                states[k, 2, vector], states[k, 3, vector] = v1, v2
                if k == tau.size:
                    break
                a1, b1 = accelerations(p, q1, q2, v1, v2, tau[k])
                u1, u2 = v1 + h / 2 * a1, v2 + h / 2 * b1
                a2, b2 = accelerations(p, q1 + h / 2 * v1, q2 + h / 2 * v2, u1, u2, tau[k])
                w1, w2 = v1 + h / 2 * a2, v2 + h / 2 * b2
                a3, b3 = accelerations(p, q1 + h / 2 * u1, q2 + h / 2 * u2, w1, w2, tau[k])
                a4, b4 = accelerations(p, q1 + h * w1, q2 + h * w2, v1 + h * a3, v2 + h * b3, tau[k])
                q1, q2 = q1 + h * (v1 + h / 6 * (a1 + a2 + a3)), q2 + h * (v2 + h / 6 * (b1 + b2 + b3))
                v1, v2 = v1 + h / 6 * (a1 + 2 * (a2 + a3) + a4), v2 + h / 6 * (b1 + 2 * (b2 + b3) + b4)
        return states

    return simulate


def evaluation():
    rng = np.random.default_rng(1)
    theta = PAPER.vector()[:, None] * rng.uniform(0.8, 1.2, (7, VECTORS))
    start, tau = np.array([-math.pi / 2, 0.0, 0.0, 0.0]), rng.uniform(-1, 1, (2, SAMPLES, 1)) * [[[1.0]], [[0.0]]]
    loop = numbas()
    theirs = loop(theta, start, tau[0, :, 0], INTERVAL)

    def ours():
        return roll(theta[:, :, None], start[:, None], tau, INTERVAL)

    assert np.allclose(ours()[:100, :, :, 0], theirs[:100], rtol=1e-6), 'all simulate the same'
    spent = interleaved(
        {
            'kernel': on(True, ours),
            'numpy': on(False, ours),
            'numba loop': lambda: loop(theta, start, tau[0, :, 0], INTERVAL),
        },
        repetitions=15,
    )
    return table(spent, ('kernel',))
