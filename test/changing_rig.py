# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A simulated rig whose friction, payload, motor and base change during the motion, with disturbances.

It has the equations of test/simulated_rig.py and no code of the package. Payload and link 2 are one rigid body.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np

from test.simulated_rig import C2, FC, GRAVITY, I2, L1, M2, TRUE, B, accelerations, bodies, pulses, runge_kutta

STEP = 0.0025
WIDTH = 0.05


@dataclass(frozen=True)
class Day:
    """The changes of one rig; times [s] from the recording's start, infinite for never."""

    drift: float = 0.0  # relative growth of all friction in 600 s, linear
    payload: float = 0.0  # as a fraction of link 2's mass
    payload_at: float = np.inf
    payload_where: float = C2  # its distance from the elbow [m]
    rests: tuple = ()  # (begin, end) without torque [s]
    pushes: tuple = ()  # (time [s], joint, torque [N m], duration [s]), half a sine each
    fades_at: float = np.inf  # time of a loss of 20 % of the motor's torque
    fade: float = 0.0  # fraction of its torque that the motor loses in 400 s, linear
    fade_at: float = np.inf  # begin of this loss
    tilt: float = 0.0  # angle of the base in the plane of motion [rad]
    tilt_at: float = np.inf
    dead_zone: float = 0.0  # torque that the driver subtracts from every torque [N m]
    dead_zone_at: float = np.inf
    strength: float = 0.35  # of the torque [N m]


def gain(day, t):
    """Return the ratio of acting and recorded torque at times t [s]."""
    return np.where(t >= day.fades_at, 0.8, 1.0) * (1 - day.fade * np.clip((t - day.fade_at) / 400, 0, 1))


def truth(day, t):
    """Return the nine true parameters in terms of the recorded torque at times t [s], shape (N, 9)."""
    t = np.asarray(t, dtype=float)
    mass, d = day.payload * M2 * (t >= day.payload_at), day.payload_where
    friction = 1 + day.drift * t / 600
    links = np.array([TRUE[n] for n in ('P1', 'P2', 'P3', 'P4', 'P5')])
    more = np.array([L1**2, d**2, L1 * d, L1, d])
    moved = np.column_stack([links + mass[:, None] * more, friction[:, None] * np.array([*B, *FC])])
    return moved / gain(day, t)[:, None]


def record(seeds, days, *, seconds, rate=200.0, counts=4096):
    """Return timestamps [s], shape (N,), positions [rad], (K, N, 2), and torques [N m], (K, N), of K rigs."""
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
        links = loaded(load * (now >= put_on), where)
        worn = 1 + drift * now / 600
        down = tilt * (now >= tilt_at)
        torque = np.array([acting[:, n] + hands[0, n], hands[1, n]])
        for _ in range(every):
            x = runge_kutta(partial(_slope, torque=torque, links=links, worn=worn, tilt=down), x, h)
    unit = 2 * np.pi / counts
    return t, np.moveaxis(np.round(read / unit) * unit, 2, 0), tau


def loaded(mass, distance):
    """Return the bodies of rigs with a payload [kg] on link 2 at a distance from the elbow [m]."""
    links = bodies()
    total, moment = M2 + mass, M2 * C2 + mass * distance
    links.m2, links.c2 = total, moment / total
    links.i2 = I2 + M2 * C2**2 + mass * distance**2 - moment**2 / total
    return links


def _slope(x, torque, links, worn, tilt):
    q1, q2, v1, v2 = x
    friction = worn * (np.array(B)[:, None] * x[2:] + np.array(FC)[:, None] * np.tanh(x[2:] / WIDTH))
    gravity = GRAVITY * np.sin(tilt), GRAVITY * np.cos(tilt)
    return np.array([v1, v2, *accelerations(q1, q2, v1, v2, *(torque - friction), links, gravity)])
