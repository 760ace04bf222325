# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A simulated rig that changes while it moves: friction, payload, disturbances, motor and base.

It uses the equations of test/simulated_rig.py and no code of the package; payload and link 2 are one rigid body.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np

from test.simulated_rig import (
    C1,
    C2,
    FC,
    GRAVITY,
    HANGING,
    I1,
    I2,
    L1,
    M1,
    M2,
    TRUE,
    B,
    accelerations,
    linked,
    pulses,
    runge_kutta,
)

STEP = 0.0025
WIDTH = 0.05


@dataclass(frozen=True)
class Day:
    """Changes of one rig; times are from the start of the recording [s], infinite for never."""

    drift: float = 0.0  # linear growth of all friction in 600 s, as a fraction
    payload: float = 0.0  # as a fraction of link 2's mass
    payload_at: float = np.inf
    payload_where: float = C2  # distance of the payload from the elbow [m]
    rests: tuple = ()  # (begin, end) of pauses of the torque [s]
    pushes: tuple = ()  # half sines: (time [s], joint, torque [N m], duration [s])
    fades_at: float = np.inf  # time of a loss of 20 % of the torque
    fade: float = 0.0  # linear loss of torque in 400 s, as a fraction
    fade_at: float = np.inf  # begin of the linear loss
    tilt: float = 0.0  # of the base in the plane of motion [rad]
    tilt_at: float = np.inf
    dead_zone: float = 0.0  # torque that the driver subtracts from every torque [N m]
    dead_zone_at: float = np.inf
    strength: float = 0.35  # largest recorded torque [N m]


def gain(day, t):
    """Return the fraction of the recorded torque that acts at times t [s]."""
    return np.where(t >= day.fades_at, 0.8, 1.0) * (1 - day.fade * np.clip((t - day.fade_at) / 400, 0, 1))


def truth(day, t):
    """Return the nine true parameters with respect to the recorded torque at times t [s], shape (N, 9)."""
    t = np.asarray(t, dtype=float)
    mass, d = day.payload * M2 * (t >= day.payload_at), day.payload_where
    friction = 1 + day.drift * t / 600
    links = np.array([TRUE[n] for n in ('P1', 'P2', 'P3', 'P4', 'P5')])
    more = np.array([L1**2, d**2, L1 * d, L1, d])
    moved = np.column_stack([links + mass[:, None] * more, friction[:, None] * np.array([*B, *FC])])
    return moved / gain(day, t)[:, None]


def record(seeds, days, *, seconds, rate=200.0, counts=4096):
    """Return stamps [s], shape (N,), positions [rad], (K, N, 2), and torques [N m], (K, N), of K rigs."""
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
    load, put_on, where = np.array([(d.payload * M2, d.payload_at, d.payload_where) for d in days]).T
    drift, tilt, tilt_at = np.array([(d.drift, d.tilt, d.tilt_at) for d in days]).T
    # Of each sample and rig.
    times = t[:, None]
    torques = np.array([acting.T + hands[0], hands[1]])
    worn, down = 1 + drift * times / 600, tilt * (times >= tilt_at)
    viscous, dry = (np.multiply.outer(coefficients, worn) for coefficients in (B, FC))
    gravity = GRAVITY * np.array([np.sin(down), np.cos(down)])
    loads = load * (times >= put_on)
    links = loaded(loads[0], where)
    x = np.zeros((4, len(seeds)))
    x[:2] = HANGING
    read = np.empty((samples, 2, len(seeds)))
    for n in range(samples):
        read[n] = x[:2]
        if (loads[n] != loads[n - 1]).any():
            links = loaded(loads[n], where)
        slope = partial(
            _slope, torque=torques[:, n], links=links, viscous=viscous[:, n], dry=dry[:, n], gravity=gravity[:, n]
        )
        for _ in range(every):
            x = runge_kutta(slope, x, h)
    unit = 2 * np.pi / counts
    return t, np.moveaxis(np.round(read / unit) * unit, 2, 0), tau


def loaded(mass, distance):
    """Return the constants of rigs with a payload [kg] fixed to link 2 at a distance from the elbow [m]."""
    together, moment = M2 + mass, M2 * C2 + mass * distance
    inertia = I2 + M2 * C2**2 + mass * distance**2 - moment**2 / together
    return linked(L1, M1, C1, I1, together, moment / together, inertia)


def _slope(x, torque, links, viscous, dry, gravity):
    q, v = x[:2], x[2:]
    friction = viscous * v + dry * np.tanh(v / WIDTH)
    return np.array([*v, *accelerations(q, v, torque - friction, links, gravity)])
