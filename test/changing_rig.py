# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A simulated rig that changes while it moves: friction, a payload, a hand, its motor, its base.

No code of the package is used.

The equations are those of test/simulated_rig.py, from the positions of the bodies, with the payload as one body more.
"""

from dataclasses import dataclass

import numpy as np

from test.simulated_rig import C1, C2, FC, GRAVITY, I1, I2, L1, M1, M2, TRUE, B, pulses

STEP = 0.0025
WIDTH = 0.05


@dataclass(frozen=True)
class Day:
    """What happens to one rig; times [s] from the recording's start, infinite for never."""

    drift: float = 0.0  # part by which all friction has grown after 600 s, in a straight line
    payload: float = 0.0  # as a part of link 2's mass
    payload_at: float = np.inf
    payload_where: float = C2  # its distance from the elbow [m]
    rests: tuple = ()  # (begin, end) without torque [s]
    pushes: tuple = ()  # (time [s], joint, torque [N m], duration [s]), half a sine each
    fades_at: float = np.inf  # the motor gives 20 % less from there on
    fade: float = 0.0  # part of its torque that the motor loses in 400 s, in a straight line
    fade_at: float = np.inf  # when that begins
    tilt: float = 0.0  # of the base in the plane of motion [rad]: the angle by which gravity turns
    tilt_at: float = np.inf
    dead_zone: float = 0.0  # torque that the driver subtracts from every torque [N m]
    dead_zone_at: float = np.inf
    strength: float = 0.35  # of the torque [N m]


def gain(day, t):
    """Return the part of the recorded torque that acts at times t [s]."""
    return np.where(t >= day.fades_at, 0.8, 1.0) * (1 - day.fade * np.clip((t - day.fade_at) / 400, 0, 1))


def truth(day, t):
    """Return the nine true parameters at times t [s], shape (N, 9): those that the recorded torque moves."""
    t = np.asarray(t, dtype=float)
    mass, d = day.payload * M2 * (t >= day.payload_at), day.payload_where
    friction = 1 + day.drift * t / 600
    links = np.array([TRUE[n] for n in ('P1', 'P2', 'P3', 'P4', 'P5')])
    more = np.array([L1**2, d**2, L1 * d, L1, d])
    moved = np.column_stack([links + mass[:, None] * more, friction[:, None] * np.array([*B, *FC])])
    return moved / gain(day, t)[:, None]


def record(seeds, days, *, seconds, rate=200.0, counts=4096):
    """Return stamps [s], shape (N,), positions [rad], (K, N, 2), and torques [N m], (K, N), of K rigs side by side."""
    samples = round(seconds * rate)
    every = max(1, round(1 / rate / STEP))
    h = 1 / rate / every
    t = np.arange(samples) / rate
    tau = np.array(
        [
            pulses(np.random.default_rng([s, 23]), samples, rate, d.strength, 0.1, 0.5)
            for s, d in zip(seeds, days, strict=True)
        ]
    )
    hands = np.zeros((2, samples, len(seeds)))
    acting = tau.copy()
    for k, day in enumerate(days):
        for begin, end in day.rests:
            tau[k, (t >= begin) & (t < end)] = acting[k, (t >= begin) & (t < end)] = 0.0
        for at, joint, torque, lasts in day.pushes:
            now = (t >= at) & (t < at + lasts)
            hands[joint, now, k] += torque * np.sin(np.pi * (t[now] - at) / lasts)
        acting[k] *= gain(day, t)
        dead = t >= day.dead_zone_at
        acting[k, dead] = np.sign(acting[k, dead]) * np.maximum(np.abs(acting[k, dead]) - day.dead_zone, 0.0)
    load = np.array([d.payload * M2 for d in days])
    put_on = np.array([d.payload_at for d in days])
    where = np.array([d.payload_where for d in days])
    drift = np.array([d.drift for d in days])
    tilt, tilt_at = np.array([d.tilt for d in days]), np.array([d.tilt_at for d in days])
    x = np.zeros((4, len(seeds)))
    x[0] = -np.pi / 2
    read = np.empty((samples, 2, len(seeds)))
    for n in range(samples):
        read[n] = x[:2]
        now = t[n]
        bodies = load * (now >= put_on), where
        worn = 1 + drift * now / 600
        down = tilt * (now >= tilt_at)
        torque = acting[:, n] + hands[0, n], hands[1, n]
        for _ in range(every):
            a = _slope(x, torque, bodies, worn, down)
            b = _slope(x + h / 2 * a, torque, bodies, worn, down)
            c = _slope(x + h / 2 * b, torque, bodies, worn, down)
            d = _slope(x + h * c, torque, bodies, worn, down)
            x = x + h / 6 * (a + 2 * b + 2 * c + d)
    unit = 2 * np.pi / counts
    return t, np.moveaxis(np.round(read / unit) * unit, 2, 0), tau


def _slope(x, torque, bodies, worn, tilt):
    q1, q2, v1, v2 = x
    mass, where = bodies
    s1, c1, s12, c12 = np.sin(q1), np.cos(q1), np.sin(q1 + q2), np.cos(q1 + q2)
    friction = worn * (np.array(B)[:, None] * x[2:] + np.array(FC)[:, None] * np.tanh(x[2:] / WIDTH))
    m11, m12, m22 = M1 * C1**2 + I1 + I2, I2, I2
    gx, gy = GRAVITY * np.sin(tilt), GRAVITY * np.cos(tilt)
    r1, r2 = torque[0] - friction[0] - M1 * C1 * (gy * c1 - gx * s1), torque[1] - friction[1]
    v12 = (v1 + v2) ** 2
    for m, d in ((M2, C2), (mass, where)):
        # Jacobian of a body on link 2, and what it accelerates by though neither joint does.
        x2, y2 = -d * s12, d * c12
        x1, y1 = x2 - L1 * s1, y2 + L1 * c1
        ax, ay = -L1 * c1 * v1**2 - d * c12 * v12, -L1 * s1 * v1**2 - d * s12 * v12
        m11 = m11 + m * (x1**2 + y1**2)
        m12 = m12 + m * (x1 * x2 + y1 * y2)
        m22 = m22 + m * (x2**2 + y2**2)
        r1 = r1 - m * (x1 * (ax + gx) + y1 * (ay + gy))
        r2 = r2 - m * (x2 * (ax + gx) + y2 * (ay + gy))
    determinant = m11 * m22 - m12**2
    return np.array([v1, v2, (m22 * r1 - m12 * r2) / determinant, (m11 * r2 - m12 * r1) / determinant])
